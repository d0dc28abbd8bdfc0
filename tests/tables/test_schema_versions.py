"""A table is kept under every schema version in which it was what it is now, and made again under every other."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from pathlib import Path

import pytest

from tables.columns import TableSchema, plain
from tables.schemas import ALL_SCHEMAS, SCHEMA_VERSION
from tables.sidecar import Missing, Sidecar, find_published
from tables.store import read_sidecar, sidecar_path, table_from_rows, write_table


def numbers(version: str) -> tuple[int, ...]:
    return tuple(map(int, version.split(".")))


# SHA-256 over keys, names and types of the columns of all tables that a schema version changed last. A table that changes makes a new
# version its `since`: its line leaves one hash and enters another. A change that leaves `since` alone would keep old files for new.
FROZEN = {
    "2.0.0": "11d79f94c1813ba4",
    "2.1.0": "75f4d8b35cda1cbe",
    "2.2.0": "0158f15a4412fc23",
    "2.3.0": "3855347d8d2bf48c",
    "2.4.0": "6366061b18748106",
}


def test_a_table_that_changed_says_since_when() -> None:
    lines: dict[str, list[str]] = {}
    for schema in ALL_SCHEMAS.values():
        columns = [f"{c.name}:{c.dtype}:{c.nullable}" for c in schema.columns]
        lines.setdefault(schema.since, []).append(f"{schema.name} {schema.key} {' '.join(columns)}")
    assert {since: hashlib.sha256("\n".join(sorted(own)).encode()).hexdigest()[:16] for since, own in lines.items()} == FROZEN
    assert max(lines, key=numbers) == SCHEMA_VERSION


@pytest.mark.parametrize(
    ("written_under", "is_kept"),
    [
        *((version, False) for version in ("2.0.0", "2.0.9", "2.4.1", "3.0.0", "02.1.0", "2.1", "")),
        *((version, True) for version in ("2.1.0", "2.2.0", "2.3.0", "2.4.0")),
    ],
)
def test_a_table_of_another_version_is_made_again(written_under: str, is_kept: bool, tmp_path: Path) -> None:
    schema = TableSchema("marks", "rows for tests", ("id",), (plain("id", "key"),), since="2.1.0")
    assert isinstance(found_under(schema, written_under, tmp_path / "marks.parquet"), Sidecar if is_kept else Missing)


@pytest.mark.parametrize("written_under", ["2.0.0", "2.1.0"])
def test_a_table_that_did_not_change_is_kept(written_under: str, tmp_path: Path) -> None:
    schema = TableSchema("marks", "rows for tests", ("id",), (plain("id", "key"),), since="2.0.0")
    assert isinstance(found_under(schema, written_under, tmp_path / "marks.parquet"), Sidecar)


def found_under(schema: TableSchema, version: str, path: Path) -> Sidecar | Missing:
    """What is found of a table that was written under a schema version."""
    write_table(schema, table_from_rows(schema, [{"id": "a"}]), path)
    sidecar_path(path).write_text(json.dumps(asdict(read_sidecar(path)) | {"schema_version": version}))
    found = find_published(schema, path, {}, "")
    if isinstance(found, Missing):
        assert not found.is_damaged
        assert f"schema version {version!r}, must be from" in str(found)
    return found
