"""Ways in which a published table goes bad on a disk, each a function of the table's path."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from tables.store import sidecar_path

Damage = Callable[[Path], None]


def _content(content: bytes) -> Damage:
    return lambda path: _replace(sidecar_path(path), content)


def _changed(**changes: Any) -> Damage:
    """Other values in the sidecar; `...` takes a key away."""

    def damage(path: Path) -> None:
        content = json.loads(sidecar_path(path).read_text()) | changes
        _replace(sidecar_path(path), json.dumps({name: value for name, value in content.items() if value is not ...}).encode())

    return damage


def _replace(path: Path, content: bytes) -> None:
    path.write_bytes(content)


def _folder(path: Path) -> None:
    path.unlink()
    (path / "inside").mkdir(parents=True)
    (path / "inside" / "note.txt").write_text("not a table")


def _other_schema(path: Path) -> None:
    pq.write_table(pa.table({"scene_id": ["mini-0000"], "weight": [1.0]}), path)


def _other_type(path: Path) -> None:
    table = pq.read_table(path)
    pq.write_table(table.set_column(1, "x_m", pa.array(range(table.num_rows), pa.float32())), path)


SIDECAR_DAMAGE: dict[str, Damage] = {
    "garbage": _content(b"garbage\n"),
    "empty": _content(b""),
    "list": _content(b"[1, 2]"),
    "text": _content(b'"sidecar"'),
    "number": _content(b"NaN"),
    "half": lambda path: _replace(sidecar_path(path), sidecar_path(path).read_bytes()[:100]),
    "not UTF-8": _content(b'{"table": "\xff\xfe"}'),
    "zeros": _content(b"\0" * 400),
    "deep": _content(b"[" * 100_000),
    "long number": _content(b"1" * 10_000),
    "lacks a key": _changed(content_hash=...),
    "lacks of": _changed(of=...),
    "extra key": _changed(colour="red"),
    "rows is text": _changed(rows="12"),
    "rows is true": _changed(rows=True),
    "rows is negative": _changed(rows=-1),
    "table is null": _changed(table=None),
    "hash is a number": _changed(sha256=12),
    "made_from is a list": _changed(made_from=[]),
    "made_from holds numbers": _changed(made_from={"code": 1}),
    "folder": lambda path: _folder(sidecar_path(path)),
}
TABLE_DAMAGE: dict[str, Damage] = {
    "truncated": lambda path: _replace(path, path.read_bytes()[:-20]),
    "half": lambda path: _replace(path, path.read_bytes()[: path.stat().st_size // 2]),
    "empty": lambda path: _replace(path, b""),
    "garbage": lambda path: _replace(path, b"garbage\n"),
    "zeros": lambda path: _replace(path, b"\0" * path.stat().st_size),
    "another schema": _other_schema,
    "another type": _other_type,
    "folder": _folder,
}
