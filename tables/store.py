"""Parquet on disk: schema enforced on the way in and verified on the way out, published atomically with a sidecar (see sidecar.py)."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from tables.columns import Column, SchemaError, TableSchema
from tables.encodings import COMPRESSION, COMPRESSION_LEVEL, ROW_GROUP_ROWS, encodings_of
from tables.files import file_sha256, published_file, remove, write_bytes_atomically, write_text_atomically
from tables.schemas import SCHEMA_VERSION
from tables.sidecar import (
    Missing,
    Sidecar,
    StoreError,
    check_belongs,
    check_sha256,
    find_published,
    read_sidecar,
    sidecar_path,
    write_sidecar,
)

__all__ = [
    "Missing",
    "Sidecar",
    "StoreError",
    "check_table",
    "content_hash",
    "file_sha256",
    "find_published",
    "join_tables",
    "read_parquet",
    "read_sidecar",
    "read_table",
    "read_tables",
    "sidecar_path",
    "table_from_columns",
    "table_from_rows",
    "write_bytes_atomically",
    "write_parquet",
    "write_table",
    "write_text_atomically",
]


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
        _check_numbers(f"{schema.name}.{column.name}", values)
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


def write_table(
    schema: TableSchema,
    table: pa.Table,
    path: Path,
    made_from: Mapping[str, str] | None = None,
    *,
    of: str = "",
    stated: Mapping[str, str] | None = None,
) -> Sidecar:
    """Check a table, publish it atomically at `path`, then publish its sidecar; what lay there before is replaced.

    Args:
        made_from: hashes that identify the inputs (recipe, code version, upstream tables).
        of: whose table it is, for example a shard or a tier; "" where there is only one.
        stated: metadata of the file itself, which a copy without sidecar keeps; a part of its bytes, not of its content.

    Raises:
        SchemaError: a table that is not what its schema says; what lay at `path` before stays.
    """
    check_table(schema, table)
    remove(sidecar_path(path))
    _publish(table.replace_schema_metadata(stated) if stated else table, path)
    sidecar = Sidecar(schema.name, table.num_rows, file_sha256(path), content_hash(table), SCHEMA_VERSION, of, dict(made_from or {}))
    write_sidecar(path, sidecar)
    return sidecar


def write_parquet(schema: TableSchema, table: pa.Table, path: Path, *, described: bool) -> None:
    """Check a table and publish it without a sidecar, in a folder whose manifest says what one would; raises SchemaError.

    Args:
        described: fields carry their meaning and unit as metadata, which are then a part of the file's bytes.
    """
    check_table(schema, table)
    _publish(table.cast(schema.described) if described else table, path)


def read_table(schema: TableSchema, path: Path, *, of: str | None = None, verify: bool = False) -> pa.Table:
    """Read a published table.

    Args:
        of: whose table it has to be; None accepts every owner's.
        verify: also compare the SHA-256 and check every value.

    Raises:
        StoreError: file or sidecar missing or damaged, another table's or another owner's, a changed file, or with `verify` a value
            that the schema does not allow.
    """
    sidecar = read_sidecar(path)
    try:
        check_belongs(sidecar, schema, of)
        if verify:
            check_sha256(sidecar, path)
        table = read_parquet(schema, path)
        if table.num_rows != sidecar.rows:
            raise StoreError(f"has {table.num_rows} rows, sidecar says {sidecar.rows}")
        if verify:
            check_table(schema, table)
        return table
    except (StoreError, SchemaError) as error:
        raise StoreError(f"{path}: {error}") from error
    except pa.ArrowException as error:
        raise StoreError(f"{path}: {_unreadable(error)}") from error


def read_parquet(schema: TableSchema, path: Path) -> pa.Table:
    """The table in a Parquet file of exactly this schema, its values unchecked; raises StoreError without the path."""
    try:
        # The reader fills a column that is not there with nulls and leaves out one that is unknown, so the file's own schema comes first.
        found = pq.read_schema(path)
        if not found.equals(schema.arrow):
            raise StoreError(f"holds {_schema_difference(found, schema.arrow)}")
        return pq.read_table(path, schema=schema.arrow, partitioning=None)
    except (pa.ArrowException, OSError) as error:
        raise StoreError(_unreadable(error)) from error


def read_tables(schema: TableSchema, paths: Sequence[Path], *, of: Sequence[str] | None = None) -> pa.Table:
    """Concatenate an explicit list of tables in key order; every one must exist, and belong to its owner in `of` where that is given."""
    owners = [None] * len(paths) if of is None else of
    return join_tables(schema, [read_table(schema, path, of=owner) for path, owner in zip(paths, owners, strict=True)])


def join_tables(schema: TableSchema, tables: Sequence[pa.Table]) -> pa.Table:
    """Concatenate tables of one schema in key order; raises SchemaError where a key repeats."""
    joined = pa.concat_tables([t.cast(_undictionaried(schema)) for t in tables])
    return table_from_columns(schema, {name: joined[name] for name in schema.names})


def _publish(table: pa.Table, path: Path) -> None:
    with published_file(path) as handle:
        _write_parquet(table, handle)


def _write_parquet(table: pa.Table, handle: IO[bytes]) -> None:
    encodings = encodings_of(table)
    pq.write_table(
        table,
        handle,
        compression=COMPRESSION,
        compression_level=COMPRESSION_LEVEL,
        use_dictionary=list(encodings.with_dictionary),
        column_encoding=encodings.others,
        row_group_size=ROW_GROUP_ROWS,
        write_page_index=True,
        store_schema=True,
    )


def _unreadable(error: Exception) -> str:
    return f"cannot be read as Parquet: {' '.join(str(error).split())}"


def _schema_difference(found: pa.Schema, expected: pa.Schema) -> str:
    """The first difference of two schemas in one line."""
    if found.names != expected.names:
        return f"columns {found.names}, expected {expected.names}"
    for column, wanted in zip(found, expected, strict=True):
        if not column.equals(wanted):
            return f"column {column}, expected {wanted}"
    return "another schema"


def _check_numbers(name: str, values: pa.Array | pa.ChunkedArray, where: str = "") -> None:
    """Raise SchemaError where a number is not finite, or where a list holds a null: a list is a null itself, or whole."""
    if _is_list(values.type):
        inside = pc.list_flatten(values)  # of a slice the slice's own, and nothing of what lies under a null
        if inside.null_count:
            raise SchemaError(f"{name}: {inside.null_count} nulls inside lists, must be 0")
        _check_numbers(name, inside, " inside lists")
    elif pa.types.is_floating(values.type) and len(values):
        n_bad = len(values) - values.null_count - (pc.sum(pc.is_finite(values)).as_py() or 0)
        if n_bad:
            raise SchemaError(f"{name}: {n_bad} values{where} that are not finite, must be 0")


def _is_list(dtype: pa.DataType) -> bool:
    return bool(pa.types.is_list(dtype) or pa.types.is_large_list(dtype) or pa.types.is_fixed_size_list(dtype))


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
