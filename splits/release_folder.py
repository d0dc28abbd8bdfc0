"""The files of a release folder compared with its manifest: which there are, their sizes, checksums and columns.

manifest.py checks what the manifest says, release.py what the tables say.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path, PurePosixPath

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from splits.errors import ReleaseError, shown
from splits.manifest import BY_SPLIT, MANIFEST, TEXTS, Manifest, files_of_table
from tables.columns import SchemaError, TableSchema
from tables.schemas import ALL_SCHEMAS, HEAVY_TABLES
from tables.store import StoreError, check_table, content_hash, file_sha256, join_tables, read_parquet, table_from_columns
from tables.vocabulary import Split


def check_nothing_else(directory: Path, manifest: Manifest) -> None:
    """Raise ReleaseError where the folder holds a file or folder that the manifest does not list."""
    try:
        names = _paths_in(directory)
    except OSError as error:
        raise ReleaseError(f"{directory}: cannot be read: {error.strerror}") from error
    listed = {MANIFEST, *manifest.files}
    strangers = [name for name in names if name not in listed | _folders_of(listed)]
    if strangers:
        raise ReleaseError(
            f"{strangers[0]}: not in the manifest, which lists {len(manifest.files)} files ({len(strangers)} are not, must be 0)"
        )


def left_out(directory: Path, manifest: Manifest) -> tuple[str, ...]:
    """Heavy tables that the folder does not hold: what makes a release a light one, empty for a whole one."""
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
    """One table, whose schema and number of rows are what the manifest says.

    Args:
        verify: also check every value against the schema, and the hash of all values.

    Raises:
        ReleaseError: the release or this code knows no such table, or a file of it is not what the manifest or the schema says.
    """
    if name not in manifest.tables:
        raise ReleaseError(f"table {shown(name)} is not in this release, must be one of {sorted(manifest.tables)}")
    if name not in ALL_SCHEMAS:
        raise ReleaseError(f"{MANIFEST}: table {name!r} is unknown to this code")
    schema, entry, files = ALL_SCHEMAS[name], manifest.tables[name], files_of_table(name)
    parts = [_read_file(directory, file, schema, verify=verify) for file in files]
    place = files[0] if len(files) == 1 else name
    try:
        table = parts[0] if len(parts) == 1 else join_tables(schema, parts)
    except (pa.ArrowException, ValueError) as error:
        raise ReleaseError(f"{place}: {error}") from error
    if table.num_rows != entry.rows:
        raise ReleaseError(f"{place}: {table.num_rows} rows, manifest says {entry.rows}")
    found = content_hash(table) if verify else entry.content_hash
    if found != entry.content_hash:
        raise ReleaseError(f"{place}: content hash {found[:12]}, manifest says {entry.content_hash[:12]}")
    return table


def parts_of_table(name: str, tables: Mapping[str, pa.Table]) -> tuple[pa.Table, ...]:
    """A table as it lies in each of its files.

    Args:
        tables: the table and `splits`, in which each of its scenes has one split.
    """
    if name not in BY_SPLIT:
        return (tables[name],)
    table, split_of = tables[name], _split_of_scene(tables)
    own = pa.array([split_of[scene_id] for scene_id in table["scene_id"].to_pylist()], pa.string())
    parts = (table.filter(pc.equal(own, split.value)) for split in Split)
    return tuple(table_from_columns(ALL_SCHEMAS[name], {column: part[column] for column in part.column_names}) for part in parts)


def check_parts(directory: Path, tables: Mapping[str, pa.Table]) -> None:
    """Raise ReleaseError where a file of a split holds a scene of another one."""
    split_of = _split_of_scene(tables)
    for file, split in ((file, split) for name in BY_SPLIT for file, split in zip(files_of_table(name), Split, strict=True)):
        scene_ids = pq.read_table(directory / file, columns=["scene_id"], partitioning=None)["scene_id"].unique().to_pylist()
        strange = sorted(scene_id for scene_id in scene_ids if split_of[scene_id] != split.value)
        if strange:
            raise ReleaseError(f"{file}: scene {strange[0]} is in split {split_of[strange[0]]}, must be in {split.value}")


def clear_folder(directory: Path, tables: Collection[str]) -> None:
    """Make an existing folder ready for a release of these tables: files of an older release go, anything else is refused.

    The manifest goes first, so that the folder is no release from then on.

    Raises:
        ReleaseError: a file or folder that no release writes; nothing was removed then.
    """
    wanted = {MANIFEST, *TEXTS, *(file for name in tables for file in files_of_table(name))}
    folders = _folders_of(wanted)
    stale = []
    for name in _paths_in(directory):
        path = directory / name
        is_ours = name in wanted or path.name.endswith((".parquet", ".parquet.json")) or _is_unfinished(path.name)
        if (not path.is_dir() or name not in folders) and not (is_ours and path.is_file()):
            raise ReleaseError(f"{path}: not a file of a release; a release has its folder for itself")
        if path.is_file() and name not in wanted:
            stale.append(path)
    (directory / MANIFEST).unlink(missing_ok=True)
    for path in stale:
        path.unlink()


def _is_unfinished(name: str) -> bool:
    """Whether this is the temporary file of a write that was killed (see `tables.files`)."""
    return name.startswith(".") and any(part in name for part in (".parquet.", *(f".{text}." for text in (*TEXTS, MANIFEST))))


def _paths_in(directory: Path) -> list[str]:
    """Every file and folder below a folder, by its path in it; folders before what they hold."""
    return sorted(path.relative_to(directory).as_posix() for path in directory.rglob("*"))


def _folders_of(files: Collection[str]) -> set[str]:
    return {parent.as_posix() for file in files for parent in PurePosixPath(file).parents} - {"."}


def _split_of_scene(tables: Mapping[str, pa.Table]) -> dict[str, str]:
    return {row["scene_id"]: row["split"] for row in tables["splits"].to_pylist()}


def _read_file(directory: Path, file: str, schema: TableSchema, *, verify: bool) -> pa.Table:
    """The rows in one file of a table; raises ReleaseError where it cannot be read, has other columns, or holds what they do not allow."""
    try:
        _check_columns(pq.read_schema(directory / file), schema)
        table = read_parquet(schema, directory / file)
        if verify:
            table.validate(full=True)
            check_table(schema, table)
    except (StoreError, pa.ArrowException, OSError, ValueError) as error:  # SchemaError, and names that are not UTF-8, are ValueErrors
        raise ReleaseError(f"{file}: {error}") from error
    return table


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
