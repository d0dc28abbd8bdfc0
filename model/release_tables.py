"""Columns of a release table, checked value by value on the way in; which columns are inputs is decided in inputs.py."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from jaxtyping import Bool

from model.errors import InputError, one_line
from tables.columns import Column
from tables.schemas import ALL_SCHEMAS, HEAVY_TABLES
from tables.store import file_sha256, sidecar_path

FURTHEST_M = 1000.0  # no arm reaches it, and float32, which the network computes in, still tells 0.1 mm apart there

_MANIFEST = "manifest.json"
_SHA256 = re.compile("[0-9a-f]{64}")


def read_table_columns(release_dir: Path, table: str, columns: Sequence[str]) -> pa.Table:
    """Named columns of a release table, dictionaries decoded, types, nulls, closed enums, numbers and keys checked.

    A table is one file, or a folder with one file a split, whose rows then come in the order of their candidates.
    The files are read as they are. Whether they are those that were published is the question of `published_sha256`, asked afterwards: of a
    table with an impossible value, the row and the value say more than a hash does.

    Raises:
        InputError: the table or a column does not exist or cannot be read, or a value that the schema does not allow.
    """
    path, files = release_dir / f"{table}.parquet", _table_files(release_dir, table)
    schema = {column.name: column for column in ALL_SCHEMAS[table].columns}
    rows = pa.concat_tables([_read_file(file, schema, columns) for file in files])
    if len(files) > 1 and "candidate_id" in columns:
        rows = rows.sort_by("candidate_id")
    for name in columns:
        _check_values(path, schema[name], rows)
    _check_keys(path, rows)
    return rows


def row_error(path: Path, rows: pa.Table, row: int, problem: str) -> InputError:
    """The error of one row, which is named by its key columns."""
    wanted = ("candidate_id",) if "candidate_id" in rows.column_names else ALL_SCHEMAS[path.stem].key
    named = [f"{name} {rows[name][row].as_py()}" for name in wanted if name in rows.column_names]
    return InputError(f"{path}: {', '.join(named) or f'row {row}'}: {problem}")


def published_sha256(release_dir: Path, tables: Iterable[str]) -> dict[str, str]:
    """SHA-256 of tables, the file of each equal to what its sidecar and the manifest of the release say, where there are any.

    A table of several files has the SHA-256 of their names and hashes.

    Raises:
        InputError: a table is missing, differs from its sidecar or from the manifest, or one of the two cannot be read.
    """
    manifest = release_dir / _MANIFEST
    listed = _json_object(manifest).get("files") if manifest.exists() else None
    found = {}
    for table in tables:
        hashes = {path.relative_to(release_dir).as_posix(): _file_sha256(path) for path in _table_files(release_dir, table)}
        for name, sha256 in hashes.items():
            path = release_dir / name
            if sidecar_path(path).exists():
                _check_sha256(path, sha256, sidecar_path(path), _json_object(sidecar_path(path)))
            if manifest.exists():
                entry = listed.get(name) if isinstance(listed, dict) else None
                if not isinstance(entry, dict):
                    raise InputError(f"{manifest}: does not list table {table}, which the ranker reads")
                _check_sha256(path, sha256, manifest, entry)
        lost = sorted(name for name in listed or () if name.startswith(f"{table}/") and name not in hashes)
        if lost:
            raise InputError(f"{release_dir / lost[0]}: missing, must be a file of table {table}")
        found[table] = hashes.popitem()[1] if len(hashes) == 1 else hashlib.sha256(json.dumps(hashes).encode()).hexdigest()
    return found


def is_left_out(release_dir: Path, table: str) -> bool:
    """Whether a release, which has a manifest, lacks a table: light ones lack what can be made again."""
    is_there = (release_dir / f"{table}.parquet").exists() or any(release_dir.glob(f"{table}/split=*/*.parquet"))
    return (release_dir / _MANIFEST).is_file() and not is_there


def manifest_sha256(release_dir: Path) -> str | None:
    """SHA-256 of the manifest of a release; None for a folder without one."""
    path = release_dir / _MANIFEST
    return _file_sha256(path) if path.exists() else None


def release_hash(release_dir: Path) -> str | None:
    """What identifies a release by the values of its tables, as its manifest says; None for a folder without one.

    Raises:
        InputError: the manifest cannot be read or does not say it.
    """
    path = release_dir / _MANIFEST
    if not path.exists():
        return None
    found = str(_json_object(path).get("release_hash"))
    if not _SHA256.fullmatch(found):
        raise InputError(f"{path}: release_hash is {found[:64]!r}, must be a SHA-256 in hexadecimal")
    return found


def _table_files(release_dir: Path, table: str) -> list[Path]:
    """The file of a table, or its file of every split, sorted by name."""
    path = release_dir / f"{table}.parquet"
    try:
        parts = [] if path.exists() else sorted(release_dir.glob(f"{table}/split=*/*.parquet"))
        if parts:
            return parts
        if not release_dir.is_dir():
            raise InputError(f"{release_dir}: {'not a folder' if release_dir.exists() else 'missing'}, must be the folder of a release")
        target = HEAVY_TABLES.get(table)
        if target is not None and is_left_out(release_dir, table):
            again = f"`python -m splits.rebuild {release_dir} {target}` makes it again"
            raise InputError(f"{path}: missing, as from a light release; {again}")
        if not path.is_file():
            raise InputError(f"{path}: {'not a file' if path.exists() else 'missing'}, must be a Parquet table of the release")
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    return [path]


def _read_file(path: Path, schema: Mapping[str, Column], columns: Sequence[str]) -> pa.Table:
    try:
        with pq.ParquetFile(path) as file:
            missing = [name for name in columns if name not in file.schema_arrow.names]
            if missing:
                raise InputError(f"{path}: column {missing[0]} is missing")
            stored = file.read(columns=list(columns))
        stored.validate(full=True)
        return pa.table({name: _decoded(path, schema[name], stored[name]) for name in columns})
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as a table ({one_line(error)})") from error


def _decoded(path: Path, column: Column, values: pa.ChunkedArray) -> pa.ChunkedArray:
    found = values.type.value_type if pa.types.is_dictionary(values.type) else values.type
    expected = pa.string() if pa.types.is_dictionary(column.dtype) else column.dtype
    if _kind(found) != _kind(expected):
        raise InputError(f"{path}: column {column.name} has type {found}, must be {expected}")
    return values.cast(expected)


def _kind(dtype: pa.DataType) -> str:
    """Types of one kind hold the same values: other writers choose another width."""
    if pa.types.is_integer(dtype):
        return "integer"
    if pa.types.is_floating(dtype):
        return "real"
    return "string" if pa.types.is_large_string(dtype) else str(dtype)


def _check_values(path: Path, column: Column, rows: pa.Table) -> None:
    values = rows[column.name]
    if values.null_count and not column.nullable:
        raise row_error(path, rows, _first(values.is_null()), f"{column.name} is null, must have a value")
    if column.values:
        row = _first(pc.invert(pc.is_in(values, pa.array([*column.values, None], pa.string()))))
        if row >= 0:
            raise row_error(path, rows, row, f"{column.name} is {values[row].as_py()!r}, must be one of {list(column.values)}")
    if pa.types.is_floating(column.dtype):
        numbers = values.fill_null(0.0).to_numpy()
        row = _first(~np.isfinite(numbers))
        if row >= 0:
            raise row_error(path, rows, row, f"{column.name} is {numbers[row]:g}, must be finite")
        row = _first(np.abs(numbers) > FURTHEST_M) if column.unit == "m" else -1
        if row >= 0:
            raise row_error(path, rows, row, f"{column.name} is {numbers[row]:g} m, must be within {FURTHEST_M:g} m of 0")


def _first(is_bad: Bool[np.ndarray, "n"] | pa.ChunkedArray) -> int:
    """The first row that is bad, or -1."""
    bad = np.flatnonzero(np.asarray(is_bad))
    return int(bad[0]) if len(bad) else -1


def _check_keys(path: Path, rows: pa.Table) -> None:
    """A repeated key would leave it to the order of rows which of two poses or labels a candidate has."""
    for key in (ALL_SCHEMAS[path.stem].key, ("candidate_id",)):
        if not set(key) <= set(rows.column_names) or rows.group_by(list(key)).aggregate([]).num_rows == rows.num_rows:
            continue
        seen: set[tuple[Any, ...]] = set()
        for values in zip(*(rows[name].to_pylist() for name in key), strict=True):
            if values in seen:
                named = ", ".join(f"{name} {value}" for name, value in zip(key, values, strict=True))
                raise InputError(f"{path}: {named} has 2 rows or more, must have 1")
            seen.add(values)


def _check_sha256(path: Path, found: str, source: Path, entry: dict[str, Any]) -> None:
    expected = str(entry.get("sha256"))
    if found != expected:
        raise InputError(f"{path}: SHA-256 {found[:12]}, {source.name} says {expected[:12]}; the table was changed after it was published")


def _file_sha256(path: Path) -> str:
    try:
        return file_sha256(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({one_line(error)})") from error


def _json_object(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: cannot be read as JSON ({one_line(error)})") from error
    if not isinstance(content, dict):
        raise InputError(f"{path}: holds a JSON {type(content).__name__}, must be an object")
    return content
