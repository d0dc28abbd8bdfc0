"""The manifest of a release: what it says, how it proves itself, how it is read; release_folder.py checks the files that it lists.

`manifest.json` states the SHA-256 of its own content (see `content_sha256`), so that an edit of any field is found before anything
that the field says is believed. Checks run in this order: JSON, own hash, versions, keys, types and values, the exact text.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, cast

from splits.errors import ReleaseError, shown
from splits.fields import check_count, check_equal, check_sha256, check_texts, check_version
from splits.provenance import layout_of_release
from tables.identity import IdentityError, family_of_tier
from tables.layout import Layout
from tables.schemas import ALL_SCHEMAS, SCHEMA_VERSION
from tables.sidecar import is_table_of_today
from tables.tolerances import Tolerances, TolerancesError
from tables.vocabulary import Split

MANIFEST = "manifest.json"
CARD = "README.md"
CROISSANT = "croissant.json"
DATASHEET = "DATASHEET.md"
TEXTS = (CARD, CROISSANT, DATASHEET)  # rendered from the tables
NAME = "placebench"
LICENCE = "CC-BY-4.0"

# Version of the data that this code makes: PATCH re-serialised, MINOR rows or columns added, MAJOR rows changed or moved across splits.
DATA_VERSION = "1.0.0"

# Measured once, different on every machine: shipped and checksummed, but no part of what the release hash identifies.
MEASUREMENTS = ("timings",)
# Made from a release, so after it: what repeats said about its labels. No part of the release hash either.
ABOUT_THE_RELEASE = ("attempts",)

# Tables that lie in one file a split, in folders `split=train` and so on: whoever reads the folder gets the split as a column.
BY_SPLIT = ("candidates",)

_MAX_DIGITS = 18  # of a whole number, so that it fits into 64 bits
_OWN_HASH = "manifest_sha256"
_TABLE_NAME = re.compile(r"[a-z][a-z0-9_]*")


@dataclass(frozen=True, slots=True)
class FileEntry:
    """One file of a release other than the manifest: its size in bytes and its SHA-256."""

    bytes: int
    sha256: str

    def __post_init__(self) -> None:
        check_count("bytes", self.bytes)
        check_sha256("sha256", self.sha256)


@dataclass(frozen=True, slots=True)
class TableEntry:
    """One table of a release; `content_hash` identifies its values, whatever bytes hold them."""

    files: list[str]
    rows: int
    content_hash: str

    def __post_init__(self) -> None:
        check_count("rows", self.rows)
        check_sha256("content_hash", self.content_hash)


@dataclass(frozen=True, slots=True)
class Manifest:
    """What a release is; `release_hash` identifies the values of its tables and nothing else.

    `files` lists every file of the folder but the manifest: the texts and the files of the tables, by their paths in it.
    """

    name: str
    tier: str
    version: str
    licence: str
    schema_version: str
    release_hash: str
    tolerances: Tolerances
    tables: dict[str, TableEntry]
    files: dict[str, FileEntry]
    provenance: dict[str, str]
    libraries: dict[str, str]

    def __post_init__(self) -> None:
        check_equal("name", self.name, NAME)
        check_tier(self.tier)
        check_version("version", self.version)
        check_version("schema_version", self.schema_version)
        check_equal("licence", self.licence, LICENCE)
        check_texts("provenance", self.provenance)
        check_texts("libraries", self.libraries)
        for name, entry in self.tables.items():
            if not _TABLE_NAME.fullmatch(name):
                raise ReleaseError(f"tables: name {shown(name)}, must match {_TABLE_NAME.pattern}")
            check_equal(f"tables.{name}: files", entry.files, list(files_of_table(name)))
            if name in ALL_SCHEMAS and not is_table_of_today(ALL_SCHEMAS[name], self.schema_version):
                since = ALL_SCHEMAS[name].since
                raise ReleaseError(f"schema_version {self.schema_version}: table {name!r} is another since {since}, as this code reads it")
        listed = {*TEXTS, *(file for name in self.tables for file in files_of_table(name))}
        if listed != self.files.keys():
            missing, unknown = sorted(listed - self.files.keys()), sorted(self.files.keys() - listed)
            raise ReleaseError(f"files: missing {shown(missing)}, unknown {shown(unknown)}, must be {', '.join(TEXTS)} and the tables")
        check_equal("release_hash", self.release_hash, release_hash_of(self.tables))

    @property
    def layout(self) -> Layout:
        """Scenes, shards and tiers of the dataset that the release is of; raises ReleaseError where it states an impossible one."""
        return layout_of_release(self.provenance, self.tables["objects"].rows if "objects" in self.tables else 0)

    def to_text(self) -> str:
        """The content of `manifest.json`: sorted keys, two spaces of indentation, its own hash among the fields."""
        content = asdict(self)
        return json.dumps({**content, _OWN_HASH: content_sha256(content)}, indent=2, sort_keys=True, allow_nan=False) + "\n"


def read_manifest(directory: Path) -> Manifest:
    """The manifest of a release folder, checked by its own hash and field by field; the other files are not looked at.

    Raises:
        ReleaseError: no folder, no manifest, a manifest that was changed, or one of a version that this code does not know.
    """
    text = _text_of(directory)
    try:
        content = _signed(text)
        check_versions(content.get("schema_version"), content.get("version"))
        manifest = _manifest_of(content)
    except ReleaseError as error:
        raise ReleaseError(f"{MANIFEST}: {error}") from error
    except RecursionError as error:
        raise ReleaseError(f"{MANIFEST}: cannot be read as a manifest: nested too deeply") from error
    if manifest.to_text() != text:
        raise ReleaseError(f"{MANIFEST}: other white space, order or escapes than were written, must be the same byte for byte")
    return manifest


def read_manifest_fields(directory: Path) -> dict[str, Any]:
    """The fields of a manifest of any version that is not of a newer major, held against its own hash and nothing else.

    For whoever compares releases of several versions; `read_manifest` also knows that every field is there and what it may be.

    Raises:
        ReleaseError: no folder, no manifest, a manifest that was changed, or one of a newer major version.
    """
    text = _text_of(directory)
    try:
        content = _signed(text)
        check_major_versions(content.get("schema_version"), content.get("version"))
    except ReleaseError as error:
        raise ReleaseError(f"{MANIFEST}: {error}") from error
    except RecursionError as error:
        raise ReleaseError(f"{MANIFEST}: cannot be read as a manifest: nested too deeply") from error
    return content


def content_sha256(content: Mapping[str, Any]) -> str:
    """SHA-256 of the canonical JSON of a manifest without its own hash: sorted keys, no white space, everything in ASCII."""
    without = {name: value for name, value in content.items() if name != _OWN_HASH}
    canonical = json.dumps(without, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return hashlib.sha256(canonical.encode()).hexdigest()


def release_hash_of(entries: Mapping[str, TableEntry]) -> str:
    """SHA-256 over the content hashes of the tables, without measurements and what was said about the release later."""
    beside = {*MEASUREMENTS, *ABOUT_THE_RELEASE}
    lines = [f"{name} {entry.content_hash}\n" for name, entry in sorted(entries.items()) if name not in beside]
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def files_of_table(name: str) -> tuple[str, ...]:
    """Paths of a table's files in the release folder: one, or of a table of `BY_SPLIT` one a split, in the order of `Split`.

    No sidecar lies beside them: the manifest says all that one would, and nothing that looks for data can take it for data.
    """
    if name in BY_SPLIT:
        return tuple(f"{name}/split={split.value}/part-0.parquet" for split in Split)
    return (f"{name}.parquet",)


def check_tier(tier: object) -> None:
    """Raise ReleaseError where there is no such tier."""
    try:
        if not isinstance(tier, str):
            raise IdentityError(f"{shown(tier)} is not a text")
        family_of_tier(tier)
    except IdentityError as error:
        raise ReleaseError(f"tier: {error}") from error


def check_versions(schema_version: object, version: object) -> None:
    """Raise ReleaseError where a version is malformed, of a newer major than this code knows, or of a schema that it does not read.

    It reads earlier schemas of its own major as far as their tables are those of today.
    """
    check_major_versions(schema_version, version)
    found, own = check_version("schema_version", schema_version), check_version("schema_version", SCHEMA_VERSION)
    if found[0] != own[0] or found > own:
        raise ReleaseError(f"schema_version {schema_version}, this code reads {own[0]}.0.0 to {SCHEMA_VERSION}")


def check_major_versions(schema_version: object, version: object) -> None:
    """Raise ReleaseError where a version is malformed or of a newer major than this code knows."""
    for name, found, known in (("schema_version", schema_version, SCHEMA_VERSION), ("version", version, DATA_VERSION)):
        if check_version(name, found)[0] > check_version(name, known)[0]:
            raise ReleaseError(f"{name} {found} is of a newer major version than this code knows ({known}): use a newer PlaceBench")


def _text_of(directory: Path) -> str:
    path = directory / MANIFEST
    try:
        if not directory.exists():
            raise ReleaseError(f"{directory}: no such folder")
        if not directory.is_dir():
            raise ReleaseError(f"{directory}: not a folder")
        if not path.exists():
            raise ReleaseError(f"{path}: missing, so this is no complete release")
        return path.read_bytes().decode("utf-8")
    except OSError as error:
        raise ReleaseError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ReleaseError(f"{path}: not UTF-8: byte {error.start} is 0x{error.object[error.start]:02x}") from error


def _signed(text: str) -> dict[str, Any]:
    """The fields of a manifest that has the hash it states."""
    content = _parsed(text)
    _check_own_hash(content)
    return content


def _parsed(text: str) -> dict[str, Any]:
    try:
        content = json.loads(text, object_pairs_hook=_without_repeats, parse_float=_finite, parse_constant=_finite, parse_int=_whole)
    except ValueError as error:
        raise ReleaseError(f"cannot be read as a manifest: {error}") from error
    if not isinstance(content, dict):
        raise ReleaseError(f"cannot be read as a manifest: it is {shown(content)}, must be an object")
    return content


def _without_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"key {shown(next(name for name in names if names.count(name) > 1))} is repeated")
    return content


def _finite(text: str) -> float:
    """A JSON number; Python would also take `NaN` and `Infinity`, which no other reader knows, and `1e999` as infinity."""
    if not math.isfinite(float(text)):
        raise ValueError(f"number {shown(text)}, must be finite")
    return float(text)


def _whole(text: str) -> int:
    if len(text) > _MAX_DIGITS:
        raise ValueError(f"number of {len(text)} digits, must have at most {_MAX_DIGITS}")
    return int(text)


def _check_own_hash(content: Mapping[str, Any]) -> None:
    if _OWN_HASH not in content:
        raise ReleaseError(f"{_OWN_HASH} is missing, must be the SHA-256 of all other fields")
    found = content_sha256(content)
    check_sha256(_OWN_HASH, content[_OWN_HASH])
    if content[_OWN_HASH] != found:
        raise ReleaseError(f"its fields have SHA-256 {found[:12]}, {_OWN_HASH} says {content[_OWN_HASH][:12]}, must be the same")


def _manifest_of(content: Mapping[str, Any]) -> Manifest:
    """The manifest of a JSON object that has exactly its fields, types and values."""
    values = {name: value for name, value in content.items() if name != _OWN_HASH}
    _check_keys("fields", values, Manifest)
    tables, files = _entries("tables", values, TableEntry), _entries("files", values, FileEntry)
    return Manifest(**{**values, "tolerances": _tolerances(values["tolerances"]), "tables": tables, "files": files})


def _tolerances(content: object) -> Tolerances:
    _check_keys("tolerances", content, Tolerances)
    try:
        return Tolerances(**cast(dict[str, Any], content))
    except TolerancesError as error:
        raise ReleaseError(f"tolerances: {error}") from error


def _entries(name: str, values: Mapping[str, Any], entry_type: type[TableEntry] | type[FileEntry]) -> dict[str, Any]:
    if not isinstance(values[name], dict):
        raise ReleaseError(f"{name} {shown(values[name])}, must be an object of entries by name")
    entries = {}
    for key, entry in values[name].items():
        _check_keys(f"{name}.{key}", entry, entry_type)
        try:
            entries[key] = entry_type(**entry)
        except ReleaseError as error:
            raise ReleaseError(f"{name}.{key}: {error}") from error
    return entries


def _check_keys(where: str, content: object, of: type[Any]) -> None:
    names = {field.name for field in fields(of)}
    if not isinstance(content, dict):
        raise ReleaseError(f"{where} {shown(content)}, must be an object with {sorted(names)}")
    missing, unknown = sorted(names - content.keys()), sorted(content.keys() - names)
    if missing or unknown:
        raise ReleaseError(f"{where}: missing {missing}, unknown {shown(unknown)}, must both be empty")
