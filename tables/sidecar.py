"""What is known about a table file, beside it as `x.parquet.json`: what it holds, whose it is and what it was made from.

The sidecar is written last, so a table is real when its sidecar is there and names its SHA-256. Nothing on disk is trusted: a sidecar
that cannot be read is a StoreError to whoever needs the table, and a table to be made again to whoever can make it.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from tables.columns import TableSchema
from tables.errors import PlaceBenchError
from tables.files import file_sha256, write_text_atomically
from tables.schemas import SCHEMA_VERSION

_NUMBER = "(?:0|[1-9][0-9]{0,5})"
_VERSION = re.compile(rf"{_NUMBER}\.{_NUMBER}\.{_NUMBER}")


class StoreError(PlaceBenchError, RuntimeError):
    """A file that is missing, changed or not what its sidecar says; one line that names the path and what is wrong."""


@dataclass(frozen=True, slots=True)
class Sidecar:
    """What is known about one table file: identity of its content, of its owner and of what made it.

    `of` is whose table it is: a shard such as "mini-000", a tier such as "pilot", a scene; "" where there is only one.
    """

    table: str
    rows: int
    sha256: str
    content_hash: str
    schema_version: str
    of: str
    made_from: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("table", "sha256", "content_hash", "schema_version", "of"):
            if not isinstance(getattr(self, name), str):
                raise StoreError(f"{name} is {getattr(self, name)!r}, must be a string")
        if type(self.rows) is not int or self.rows < 0:
            raise StoreError(f"rows is {self.rows!r}, must be a whole number >= 0")
        if not isinstance(self.made_from, dict) or not all(isinstance(text, str) for pair in self.made_from.items() for text in pair):
            raise StoreError(f"made_from is {self.made_from!r}, must be strings by name")


@dataclass(frozen=True, slots=True)
class Missing:
    """Why a table counts as missing; as text one line for a log, such as "targets of mini-000: sidecar is not JSON".

    Attributes:
        is_damaged: something lies there that no build leaves behind. False for a table that was never finished, or that was made from
            other inputs.
    """

    table: str
    of: str
    reason: str
    is_damaged: bool

    def __str__(self) -> str:
        return f"{self.table}{f' of {self.of}' if self.of else ''}: {self.reason}"


def find_published(schema: TableSchema, path: Path, made_from: Mapping[str, str], of: str) -> Sidecar | Missing:
    """The sidecar of a table that is on disk, unchanged, and what would be made today; otherwise why it has to be made again.

    Args:
        made_from: what the table would be made from today.
        of: whose table it has to be.
    """
    if not os.path.lexists(path) and not os.path.lexists(sidecar_path(path)):
        return Missing(schema.name, of, "not there", is_damaged=False)
    if not os.path.lexists(sidecar_path(path)):
        return Missing(schema.name, of, "has no sidecar, so it was never finished", is_damaged=False)
    try:
        sidecar = _load(path)
        check_belongs(sidecar, schema, of)
        reason = _difference(sidecar, schema, made_from)
        if reason is not None:
            return Missing(schema.name, of, reason, is_damaged=False)
        check_sha256(sidecar, path)
    except StoreError as error:
        return Missing(schema.name, of, str(error), is_damaged=True)
    return sidecar


def read_sidecar(path: Path) -> Sidecar:
    """Sidecar of a table; raises StoreError where table or sidecar is missing or the sidecar cannot be read."""
    if not os.path.lexists(path) or not os.path.lexists(sidecar_path(path)):
        raise StoreError(f"{path}: not published (table or sidecar missing)")
    try:
        return _load(path)
    except StoreError as error:
        raise StoreError(f"{path}: {error}") from error


def write_sidecar(path: Path, sidecar: Sidecar) -> None:
    """Publish the sidecar of the table at `path`."""
    write_text_atomically(sidecar_path(path), json.dumps(asdict(sidecar), indent=2, sort_keys=True) + "\n")


def sidecar_path(path: Path) -> Path:
    """Where the sidecar of a table lies."""
    return path.with_name(path.name + ".json")


def check_belongs(sidecar: Sidecar, schema: TableSchema, of: str | None) -> None:
    """Raise StoreError, without the path, where a sidecar is another table's or another owner's; `None` accepts every owner."""
    if sidecar.table != schema.name:
        raise StoreError(f"holds table {sidecar.table!r}, expected {schema.name!r}")
    if of is not None and sidecar.of != of:
        raise StoreError(f"is of {sidecar.of!r}, expected {of!r}")


def is_table_of_today(schema: TableSchema, written_under: str) -> bool:
    """Whether a schema version is one in which a table was what it is now: from `schema.since` to today's."""
    found = _VERSION.fullmatch(written_under)
    return found is not None and _numbers(schema.since) <= _numbers(written_under) <= _numbers(SCHEMA_VERSION)


def check_sha256(sidecar: Sidecar, path: Path) -> None:
    """Raise StoreError, without the path, where a table file is not the one that its sidecar names."""
    try:
        found = file_sha256(path)
    except OSError as error:
        raise StoreError(f"cannot be read: {error.strerror}") from error
    if found != sidecar.sha256:
        raise StoreError(f"SHA-256 {found[:12]}, sidecar says {sidecar.sha256[:12]}")


def _load(path: Path) -> Sidecar:
    """The sidecar of the table at `path`; raises StoreError, without the path, whatever lies there instead."""
    try:
        content: Any = json.loads(sidecar_path(path).read_bytes().decode("utf-8"))
    except OSError as error:
        raise StoreError(f"sidecar cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:  # not UTF-8 is a ValueError too
        raise StoreError(f"sidecar is not JSON: {error}") from error
    if not isinstance(content, dict):
        raise StoreError(f"sidecar holds a {type(content).__name__}, must be an object")
    names = {f.name for f in fields(Sidecar)}
    if content.keys() != names:
        raise StoreError(f"sidecar lacks {sorted(names - content.keys())} and has unknown {sorted(content.keys() - names)}")
    try:
        return Sidecar(**content)
    except StoreError as error:
        raise StoreError(f"sidecar: {error}") from error


def _difference(sidecar: Sidecar, schema: TableSchema, made_from: Mapping[str, str]) -> str | None:
    """What a table was made from that would be different today."""
    if not is_table_of_today(schema, sidecar.schema_version):
        return f"schema version {sidecar.schema_version!r}, must be from {schema.since!r} to {SCHEMA_VERSION!r}"
    names = sorted(name for name in sidecar.made_from.keys() | made_from.keys() if sidecar.made_from.get(name) != made_from.get(name))
    return f"made from other inputs: {', '.join(names)}" if names else None


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(map(int, version.split(".")))
