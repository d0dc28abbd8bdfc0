"""Releases and checkpoints with one thing wrong, each made from a whole one; what is said of them is tested elsewhere."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import safetensors.torch
import torch

from tables.store import sidecar_path


def copy_of(folder: Path, copy: Path) -> Path:
    return Path(shutil.copytree(folder, copy))


def rewrite(path: Path, table: pa.Table) -> None:
    """Write a table as its owner would who does not publish it: without a sidecar."""
    pq.write_table(table, path)
    sidecar_path(path).unlink(missing_ok=True)


def set_values(release: Path, table: str, row: int, values: Mapping[str, Any], **types: pa.DataType) -> None:
    """Put values into one row of a release table; `types` changes the type of a column on the way."""
    path = release / f"{table}.parquet"
    rows = pq.read_table(path)
    for column, value in values.items():
        field = rows.schema.field(column)
        dtype = types.get(column, pa.string() if pa.types.is_dictionary(field.type) else field.type)
        items = rows[column].to_pylist()
        items[row] = value
        rows = rows.set_column(rows.column_names.index(column), column, pa.array(items, dtype))
    rewrite(path, rows)


def cut(path: Path, share: float) -> None:
    """Leave the first share of the bytes of a file."""
    content = path.read_bytes()
    path.write_bytes(content[: int(len(content) * share)])


def edit_json(path: Path, edit: Callable[[dict[str, Any]], None]) -> None:
    content = json.loads(path.read_text())
    edit(content)
    path.write_text(json.dumps(content))


def edit_weights(checkpoint: Path, edit: Callable[[dict[str, torch.Tensor]], Any]) -> None:
    """Change weights and the hash that names them."""
    path = checkpoint / "ranker.safetensors"
    weights = safetensors.torch.load_file(path)
    edit(weights)
    path.write_bytes(safetensors.torch.save(weights))
    name_weights(checkpoint)


def name_weights(checkpoint: Path) -> None:
    """Make the description name the weights that are there."""
    found = hashlib.sha256((checkpoint / "ranker.safetensors").read_bytes()).hexdigest()
    edit_json(checkpoint / "ranker.json", lambda described: described.update(weights_sha256=found))


def write_manifest(release: Path) -> None:
    """A manifest of what is there, as far as the ranker reads one."""
    files = {path.name: {"sha256": hashlib.sha256(path.read_bytes()).hexdigest()} for path in release.glob("*.parquet")}
    (release / "manifest.json").write_text(json.dumps({"name": "placebench", "files": files}))
