"""The files of a release folder compared with its manifest: which there are, their sizes, checksums and columns.

manifest.py checks what the manifest says, release.py what the tables say.
"""

from __future__ import annotations

import json
from collections.abc import Collection
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from splits.errors import ReleaseError, shown
from splits.manifest import CARD, MANIFEST, Manifest, files_of_table
from tables.columns import SchemaError, TableSchema
from tables.schemas import ALL_SCHEMAS, HEAVY_TABLES
from tables.store import Sidecar, StoreError, check_table, content_hash, file_sha256, read_table


def check_nothing_else(directory: Path, manifest: Manifest) -> None:
    """Raise ReleaseError where the folder holds a file or folder that the manifest does not list."""
    try:
        names = sorted(path.name for path in directory.iterdir())
    except OSError as error:
        raise ReleaseError(f"{directory}: cannot be read: {error.strerror}") from error
    strangers = [name for name in names if name not in {MANIFEST, *manifest.files}]
    if strangers:
        raise ReleaseError(
            f"{strangers[0]}: not in the manifest, which lists {len(manifest.files)} files ({len(strangers)} are not, must be 0)"
        )


def left_out(directory: Path, manifest: Manifest) -> tuple[str, ...]:
    """Heavy tables of which the folder holds neither file: what makes a release a light one, empty for a whole one."""
    heavy = (name for name in sorted(manifest.tables) if name in HEAVY_TABLES)
    return tuple(name for name in heavy if not any((directory / file).exists() for file in files_of_table(name)))


def left_out_error(directory: Path, name: str) -> ReleaseError:
    """Why a table that a light release leaves out cannot be read, and what to do about it."""
    target = HEAVY_TABLES[name]
    remedy = (
        "it was measured once and cannot be made again: take it from the whole release"
        if target is None
        else f"`python -m splits.rebuild {directory} {target}` makes it again"
    )
    return ReleaseError(f"table {name!r} is left out of this light release; {remedy}")


def check_files(directory: Path, manifest: Manifest, *, hashes: bool, without: Collection[str] = ()) -> None:
    """Raise ReleaseError where a listed file is missing, is not a file, has another size, or (with `hashes`) another SHA-256.

    Args:
        without: tables whose files need not be there.
    """
    excused = {file for table in without for file in files_of_table(table)}
    for name, entry in sorted(manifest.files.items()):
        if name in excused:
            continue
        path = directory / name
        try:
            if not path.exists():
                raise ReleaseError(f"{name}: missing")
            if not path.is_file():
                raise ReleaseError(f"{name}: not a file")
            found_bytes = path.stat().st_size
            found_sha256 = file_sha256(path) if hashes and found_bytes == entry.bytes else None
        except OSError as error:
            raise ReleaseError(f"{name}: cannot be read: {error.strerror}") from error
        if found_bytes != entry.bytes:
            raise ReleaseError(f"{name}: {found_bytes:,} bytes, manifest says {entry.bytes:,}")
        if found_sha256 not in (None, entry.sha256):
            raise ReleaseError(f"{name}: SHA-256 {str(found_sha256)[:12]}, manifest says {entry.sha256[:12]}")


def read_released_table(directory: Path, manifest: Manifest, name: str, *, verify: bool) -> pa.Table:
    """One table, whose sidecar, schema and number of rows are what the manifest says.

    Args:
        verify: also check every value against the schema, and the hash of all values.

    Raises:
        ReleaseError: the release or this code knows no such table, or its file or sidecar is not what the manifest or the schema says.
    """
    if name not in manifest.tables:
        raise ReleaseError(f"table {shown(name)} is not in this release, must be one of {sorted(manifest.tables)}")
    if name not in ALL_SCHEMAS:
        raise ReleaseError(f"{MANIFEST}: table {name!r} is unknown to this code")
    schema, entry = ALL_SCHEMAS[name], manifest.tables[name]
    file, sidecar_file = files_of_table(name)
    sidecar = Sidecar(
        name, entry.rows, manifest.files[file].sha256, entry.content_hash, manifest.schema_version, manifest.tier, manifest.provenance
    )
    _check_sidecar(directory / sidecar_file, asdict(sidecar))
    try:
        _check_columns(pq.read_schema(directory / file), schema)
        table = read_table(schema, directory / file)
        if table.num_rows != entry.rows:
            raise ReleaseError(f"{file}: {table.num_rows} rows, manifest says {entry.rows}")
        if verify:
            table.validate(full=True)
            check_table(schema, table)
            found = content_hash(table)
            if found != entry.content_hash:
                raise ReleaseError(f"{file}: content hash {found[:12]}, manifest says {entry.content_hash[:12]}")
    except (StoreError, pa.ArrowException, OSError, ValueError) as error:  # SchemaError, and names that are not UTF-8, are ValueErrors
        raise ReleaseError(f"{file}: {error}") from error
    return table


def clear_folder(directory: Path, tables: Collection[str]) -> None:
    """Make an existing folder ready for a release of these tables: files of an older release go, anything else is refused.

    The manifest goes first, so that the folder is no release from then on.

    Raises:
        ReleaseError: a file or folder that no release writes; nothing was removed then.
    """
    wanted = {MANIFEST, CARD, *(file for name in tables for file in files_of_table(name))}
    stale = []
    for path in sorted(directory.iterdir()):
        is_ours = path.name in wanted or path.name.endswith((".parquet", ".parquet.json")) or _is_unfinished(path.name)
        if not is_ours or not path.is_file():
            raise ReleaseError(f"{path}: not a file of a release; a release has its folder for itself")
        if path.name not in wanted:
            stale.append(path)
    (directory / MANIFEST).unlink(missing_ok=True)
    for path in stale:
        path.unlink()


def _is_unfinished(name: str) -> bool:
    """Whether this is the temporary file of a write that was killed (see `tables.store.write_table`)."""
    return name.startswith(".") and any(part in name for part in (".parquet.", f".{CARD}.", f".{MANIFEST}."))


def _check_sidecar(path: Path, expected: dict[str, Any]) -> None:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ReleaseError(f"{path.name}: cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise ReleaseError(f"{path.name}: cannot be read as a sidecar: {error}") from error
    if not isinstance(found, dict):
        raise ReleaseError(f"{path.name}: {shown(found)}, must be an object with {sorted(expected)}")
    if found.keys() != expected.keys():
        missing, unknown = sorted(expected.keys() - found.keys()), sorted(found.keys() - expected.keys())
        raise ReleaseError(f"{path.name}: missing {missing}, unknown {shown(unknown)}, must both be empty")
    for name, value in expected.items():
        # True equals 1 and 1.0, but only one of them is a number of rows.
        if type(found[name]) is not type(value) or found[name] != value:
            raise ReleaseError(f"{path.name}: {name} {shown(found[name])}, manifest says {shown(value)}")


def _check_columns(found: pa.Schema, schema: TableSchema) -> None:
    """The columns of the file itself: reading with a schema would cast, fill and drop columns until they fit."""
    expected = schema.arrow
    for name in [*expected.names, *found.names]:
        if name not in found.names:
            raise SchemaError(f"column {name} is missing, must be one of {len(expected)}")
        if name not in expected.names:
            raise SchemaError(f"column {shown(name)} is unknown, must be none beside the {len(expected)} of the schema")
        if found.names.count(name) > 1:
            raise SchemaError(f"column {name} is there {found.names.count(name)} times, must be once")
        if not found.field(name).equals(expected.field(name)):
            raise SchemaError(f"column {name} is {_described(found.field(name))}, must be {_described(expected.field(name))}")
    if found.names != expected.names:
        raise SchemaError(f"columns in another order, must be {', '.join(expected.names)}")


def _described(field: pa.Field) -> str:
    return f"{field.type}{'' if field.nullable else ' not null'}"
