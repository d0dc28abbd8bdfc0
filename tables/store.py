"""Parquet on disk: schema enforced on the way in and verified on the way out, published atomically with a sidecar.

A table `x.parquet` is real when its sidecar `x.parquet.json` exists and names its SHA-256; the sidecar is written last.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from tables.columns import Column, SchemaError, TableSchema
from tables.schemas import SCHEMA_VERSION

ROW_GROUP_ROWS = 16_384


class StoreError(RuntimeError):
    """A file that is missing, changed or not what its sidecar says."""


@dataclass(frozen=True, slots=True)
class Sidecar:
    """What is known about one table file: identity of its content and of what made it."""

    table: str
    rows: int
    sha256: str
    content_hash: str
    schema_version: str
    made_from: dict[str, str] = field(default_factory=dict)


def table_from_rows(schema: TableSchema, rows: Iterable[Mapping[str, Any]]) -> pa.Table:
    """Arrow table of dict rows, sorted by the key and checked.

    Raises:
        SchemaError: an unknown or missing column, a null or value that the schema does not allow, a repeated key.
    """
    rows = list(rows)
    known = set(schema.names)
    for row in rows:
        unknown = row.keys() - known
        missing = known - row.keys()
        if unknown or missing:
            raise SchemaError(f"{schema.name}: unknown columns {sorted(unknown)}, missing columns {sorted(missing)}")
    return table_from_columns(schema, {name: [_plain(row[name]) for row in rows] for name in schema.names})


def table_from_columns(schema: TableSchema, columns: Mapping[str, Sequence[Any] | np.ndarray | pa.Array | pa.ChunkedArray]) -> pa.Table:
    """Arrow table of column arrays, sorted by the key and checked; raises SchemaError as `table_from_rows` does."""
    if set(columns) != set(schema.names):
        raise SchemaError(f"{schema.name}: columns {sorted(set(columns) ^ set(schema.names))} are unknown or missing")
    arrays = [_array(schema.name, column, columns[column.name]) for column in schema.columns]
    table = pa.Table.from_arrays(arrays, schema=schema.arrow)
    keys = pa.table({name: _decoded(table[name]) for name in schema.key})
    table = table.take(pc.sort_indices(keys, sort_keys=[(name, "ascending") for name in schema.key]))
    check_table(schema, table)
    return _canonical(schema, table)


def check_table(schema: TableSchema, table: pa.Table) -> None:
    """Verify types, nulls, closed enums, finite numbers and unique keys; raises SchemaError naming what is wrong."""
    if not table.schema.equals(schema.arrow):
        raise SchemaError(f"{schema.name}: schema differs from version {SCHEMA_VERSION}:\n{table.schema}\nexpected:\n{schema.arrow}")
    for column in schema.columns:
        values = table[column.name]
        if values.null_count and not column.nullable:
            raise SchemaError(f"{schema.name}.{column.name}: {values.null_count} nulls, must be 0")
        if column.values:
            strange = sorted(set(_decoded(values).unique().to_pylist()) - {*column.values, None})
            if strange:
                raise SchemaError(f"{schema.name}.{column.name}: {strange[0]!r}, must be one of {list(column.values)}")
        if pa.types.is_floating(column.dtype) and len(values):
            n_bad = len(values) - values.null_count - (pc.sum(pc.is_finite(values)).as_py() or 0)
            if n_bad:
                raise SchemaError(f"{schema.name}.{column.name}: {n_bad} values that are not finite, must be 0")
    keys = pa.table({name: _decoded(table[name]) for name in schema.key})
    n_distinct = keys.group_by(list(schema.key)).aggregate([]).num_rows
    if n_distinct != table.num_rows:
        raise SchemaError(f"{schema.name}: {table.num_rows - n_distinct} repeated keys {schema.key}, must be 0")


def content_hash(table: pa.Table) -> str:
    """SHA-256 of the values, independent of chunks, dictionary order and what lies under a null."""
    digest = hashlib.sha256()
    for name in table.column_names:
        values = _decoded(table[name])
        # Parquet renames the field inside a list type, so the type's own text would differ after a round trip.
        kind = f"list<{values.type.value_type}>" if pa.types.is_list(values.type) else str(values.type)
        digest.update(f"{name}:{kind}:{len(values)}\n".encode())
        digest.update(np.packbits(np.asarray(values.is_null())).tobytes())
        if pa.types.is_list(values.type):
            digest.update(np.asarray(pc.list_value_length(values).fill_null(0), dtype=np.int64).tobytes())
            values = pc.list_flatten(values)
        if pa.types.is_string(values.type):
            digest.update("\x1f".join(v or "" for v in values.to_pylist()).encode())
        else:
            zero = False if pa.types.is_boolean(values.type) else pa.scalar(0, values.type)
            digest.update(np.ascontiguousarray(values.fill_null(zero).to_numpy(zero_copy_only=False)).tobytes())
    return digest.hexdigest()


def write_table(schema: TableSchema, table: pa.Table, path: Path, made_from: Mapping[str, str] | None = None) -> Sidecar:
    """Check a table, publish it atomically at `path`, then publish its sidecar.

    Args:
        made_from: hashes that identify the inputs (recipe, code version, upstream tables).
    """
    check_table(schema, table)
    path.parent.mkdir(parents=True, exist_ok=True)
    sidecar_path(path).unlink(missing_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, prefix=f".{path.name}.", delete=False) as handle:
        pq.write_table(table, handle, compression="zstd", row_group_size=ROW_GROUP_ROWS, write_page_index=True, store_schema=True)
        handle.flush()
        os.fsync(handle.fileno())
    os.chmod(handle.name, 0o644)
    os.replace(handle.name, path)
    sidecar = Sidecar(schema.name, table.num_rows, file_sha256(path), content_hash(table), SCHEMA_VERSION, dict(made_from or {}))
    write_text_atomically(sidecar_path(path), json.dumps(asdict(sidecar), indent=2, sort_keys=True) + "\n")
    return sidecar


def read_table(schema: TableSchema, path: Path, *, verify: bool = False) -> pa.Table:
    """Read a published table; with `verify`, also compare the SHA-256 and check every value.

    Raises:
        StoreError: file or sidecar missing, or the hash differs.
        SchemaError: with `verify`, a value that the schema does not allow.
    """
    sidecar = read_sidecar(path)
    if sidecar.table != schema.name:
        raise StoreError(f"{path}: holds table {sidecar.table!r}, expected {schema.name!r}")
    if verify and file_sha256(path) != sidecar.sha256:
        raise StoreError(f"{path}: SHA-256 {file_sha256(path)[:12]}, sidecar says {sidecar.sha256[:12]}")
    table = pq.read_table(path, schema=schema.arrow)
    if verify:
        check_table(schema, table)
    return table


def read_tables(schema: TableSchema, paths: Sequence[Path]) -> pa.Table:
    """Concatenate an explicit list of tables in key order; every one must exist."""
    return join_tables(schema, [read_table(schema, path) for path in paths])


def join_tables(schema: TableSchema, tables: Sequence[pa.Table]) -> pa.Table:
    """Concatenate tables of one schema in key order; raises SchemaError where a key repeats."""
    joined = pa.concat_tables([t.cast(_undictionaried(schema)) for t in tables])
    return table_from_columns(schema, {name: joined[name] for name in schema.names})


def read_sidecar(path: Path) -> Sidecar:
    """Sidecar of a table; raises StoreError where table or sidecar is missing."""
    if not path.exists() or not sidecar_path(path).exists():
        raise StoreError(f"{path}: not published (table or sidecar missing)")
    return Sidecar(**json.loads(sidecar_path(path).read_text()))


def sidecar_path(path: Path) -> Path:
    return path.with_name(path.name + ".json")


def write_text_atomically(path: Path, content: str) -> None:
    """Publish a text file: temporary file, fsync, rename."""
    write_bytes_atomically(path, content.encode("utf-8"))


def write_bytes_atomically(path: Path, content: bytes) -> None:
    """Publish a file: temporary file, fsync, rename."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, prefix=f".{path.name}.", delete=False) as handle:
        handle.write(content)
        handle.flush()
        os.fsync(handle.fileno())
    os.chmod(handle.name, 0o644)
    os.replace(handle.name, path)


def file_sha256(path: Path) -> str:
    with path.open("rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()


def _decoded(values: pa.ChunkedArray) -> pa.Array:
    if pa.types.is_dictionary(values.type):
        values = values.cast(pa.string())
    return values.combine_chunks() if isinstance(values, pa.ChunkedArray) else values


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value


def _undictionaried(schema: TableSchema) -> pa.Schema:
    return pa.schema([pa.field(f.name, pa.string() if pa.types.is_dictionary(f.type) else f.type, f.nullable) for f in schema.arrow])


def _array(table: str, column: Column, values: Any) -> pa.Array:
    try:
        if isinstance(values, (pa.Array, pa.ChunkedArray)):
            array = _decoded(values)
        else:
            array = pa.array(values, type=pa.string() if pa.types.is_dictionary(column.dtype) else column.dtype)
        if pa.types.is_dictionary(column.dtype):
            return array.cast(pa.string()).dictionary_encode().cast(column.dtype)
        return array.cast(column.dtype)
    except (pa.ArrowInvalid, pa.ArrowTypeError) as error:
        raise SchemaError(f"{table}.{column.name}: {error}") from error


def _canonical(schema: TableSchema, table: pa.Table) -> pa.Table:
    """Dictionaries in sorted order, one chunk a column: equal values give equal bytes."""
    arrays = []
    for column in schema.columns:
        values = _decoded(table[column.name])
        if pa.types.is_dictionary(column.dtype):
            entries = sorted(v for v in values.unique().to_pylist() if v is not None)
            indices = pc.index_in(values, pa.array(entries, pa.string())).cast(pa.int16())
            values = pa.DictionaryArray.from_arrays(indices, pa.array(entries, pa.string()))
        arrays.append(values)
    return pa.Table.from_arrays(arrays, schema=schema.arrow)
