"""What changed between two releases, table by table, and the version step that the difference asks for.

`python -m splits.release diff A B`, written out in diff_text.py. Releases of older schemas can be compared too: tables are read as they lie
on disk, and only the columns that both have are compared by value. What a light release leaves out is compared by the hashes in the
manifests, which tell equal from different and no more.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from splits.diff_tables import RowDiff, compare_tables
from splits.errors import ReleaseError
from splits.fields import check_version
from splits.manifest import MANIFEST, MEASUREMENTS, read_manifest_fields
from tables.schemas import ALL_SCHEMAS
from tables.store import file_sha256


class Step(IntEnum):
    """What a difference asks of the version, by the rule at the top of CHANGELOG.md."""

    NONE = 0
    PATCH = 1  # re-serialised
    MINOR = 2  # rows or columns added
    MAJOR = 3  # rows changed or moved across splits


class State(StrEnum):
    """How a table of A and the table of that name in B differ."""

    SAME = "equal"
    REWRITTEN = "equal values in other bytes"
    CHANGED = "different"
    ADDED = "only in B"
    REMOVED = "only in A"
    UNREAD = "different by hash"  # not in one of the folders, or of no schema that this code knows


@dataclass(frozen=True, slots=True)
class TableDiff:
    """One table in both releases; rows are None where a release has no such table, `lacking` names the folders that do not hold it."""

    name: str
    state: State
    rows_a: int | None
    rows_b: int | None
    lacking: tuple[str, ...] = ()
    content: RowDiff | None = None

    def reasons(self) -> list[tuple[Step, str]]:
        """What the table asks of the version, and why."""
        if self.state is State.SAME:
            return []
        if self.state is State.REWRITTEN:
            return [(Step.PATCH, f"{self.name}: written anew")]
        if self.name in MEASUREMENTS:
            return [(Step.PATCH, f"{self.name}: measured anew")]
        if self.state is State.ADDED:
            return [(Step.MINOR, f"{self.name}: new table")]
        if self.state is State.REMOVED:
            return [(Step.MAJOR, f"{self.name}: table removed")]
        content = self.content
        if content is None:
            return [(Step.MINOR, f"{self.name}: different by hash; at least this, more where a row changed")]
        found = (
            (Step.MINOR, len(content.new_columns), "column", "added"),
            (Step.MINOR, content.added, "row", "added"),
            (Step.MAJOR, len(content.lost_columns), "column", "removed"),
            (Step.MAJOR, len(content.retyped_columns), "column", "of another type"),
            (Step.MAJOR, content.removed, "row", "removed"),
            (Step.MAJOR, content.changed, "row", "moved across splits" if self.name == "splits" else "changed"),
        )
        # Equal rows under another hash: another order of columns or rows.
        reasons = [(step, f"{self.name}: {n:,} {what}{'s' if n > 1 else ''} {how}") for step, n, what, how in found if n]
        return reasons or [(Step.PATCH, f"{self.name}: written anew")]


@dataclass(frozen=True, slots=True)
class ReleaseDiff:
    """Two releases compared.

    Attributes:
        facts: (name, value in A, value in B) of everything in the manifests that differs, None where one does not say.
        texts_differ: whether a file that is no table, such as the card, has other bytes.
    """

    a: str
    b: str
    version_a: str
    version_b: str
    facts: tuple[tuple[str, str | None, str | None], ...]
    tables: tuple[TableDiff, ...]
    texts_differ: bool

    def reasons(self) -> list[tuple[Step, str]]:
        """What the difference asks of the version and why, the largest step first."""
        found = [reason for table in self.tables for reason in table.reasons()]
        if any(name.startswith("tolerances.") for name, _, _ in self.facts):
            found.append((Step.MAJOR, "tolerances: labels are judged by others"))
        if self.texts_differ:
            found.append((Step.PATCH, "files beside the tables: written anew"))
        return sorted(found, key=lambda reason: -reason[0])

    @property
    def asked(self) -> Step:
        """The version step that the difference asks for; below MINOR the releases are equal in content."""
        return max((step for step, _ in self.reasons()), default=Step.NONE)

    @property
    def least_version(self) -> str:
        """The smallest version that B may have after A; before 1.0 a MINOR number stands for a MAJOR step."""
        major, minor, patch = check_version("version", self.version_a)
        if self.asked is Step.MAJOR and major > 0:
            return f"{major + 1}.0.0"
        if self.asked >= Step.MINOR:
            return f"{major}.{minor + 1}.0"
        return f"{major}.{minor}.{patch + (self.asked is Step.PATCH)}"

    @property
    def version_fits(self) -> bool:
        """Whether B's version says at least what changed since A."""
        return check_version("version", self.version_b) >= check_version("version", self.least_version)


@dataclass(frozen=True, slots=True)
class _Listed:
    """A table as its manifest lists it: rows, hash of its values, and SHA-256 of each of its files by name."""

    rows: int
    content_hash: str
    files: dict[str, str]


@dataclass(frozen=True, slots=True)
class _Side:
    """One of the two releases."""

    name: str
    directory: Path
    version: str
    facts: dict[str, str]
    tables: dict[str, _Listed]
    texts: dict[str, str]

    def holds(self, table: str) -> bool:
        return table in self.tables and any((self.directory / file).exists() for file in self.tables[table].files)


def diff_releases(a: Path, b: Path) -> ReleaseDiff:
    """Compare two release folders, whole or light, of any version that is not of a newer major.

    Raises:
        ReleaseError: no release, a manifest or a file that was changed, or a key that repeats.
    """
    sides = _side("A", a), _side("B", b)
    names = dict.fromkeys(name for side in sides for name in side.facts)
    pairs = [(name, sides[0].facts.get(name), sides[1].facts.get(name)) for name in names]
    tables = sorted(sides[0].tables.keys() | sides[1].tables.keys())
    return ReleaseDiff(
        str(a),
        str(b),
        sides[0].version,
        sides[1].version,
        tuple((name, old, new) for name, old, new in pairs if old != new),
        tuple(_table_diff(name, *sides) for name in tables),
        sides[0].texts != sides[1].texts,
    )


def _side(name: str, directory: Path) -> _Side:
    fields = read_manifest_fields(directory)
    try:
        facts = {key: str(fields[key]) for key in ("version", "schema_version", "tier", "licence", "release_hash")}
        for group in ("tolerances", "provenance", "libraries"):
            # Releases before data 0.4.0 state two tolerances as fields of their own.
            facts |= {f"{group}.{key}": str(value) for key, value in fields.get(group, {}).items()}
        sha256 = {file: str(entry["sha256"]) for file, entry in fields["files"].items()}
        tables = {key: _listed(entry, sha256) for key, entry in fields["tables"].items()}
    except (KeyError, TypeError, AttributeError) as error:
        raise ReleaseError(f"{directory / MANIFEST}: lacks what a comparison needs: {type(error).__name__} {error}") from error
    of_tables = {file for entry in tables.values() for file in entry.files}
    texts = {file: digest for file, digest in sha256.items() if file not in of_tables and not file.endswith(".parquet.json")}
    return _Side(name, directory, facts["version"], facts, tables, texts)


def _listed(entry: Mapping[str, Any], sha256: Mapping[str, str]) -> _Listed:
    files: Sequence[str] = entry["files"] if "files" in entry else [entry["file"]]
    return _Listed(int(entry["rows"]), str(entry["content_hash"]), {file: sha256[file] for file in files})


def _table_diff(name: str, a: _Side, b: _Side) -> TableDiff:
    old, new = a.tables.get(name), b.tables.get(name)
    lacking = tuple(side.name for side in (a, b) if name in side.tables and not side.holds(name))
    if old is None or new is None:
        state = State.ADDED if old is None else State.REMOVED
        return TableDiff(name, state, old.rows if old else None, new.rows if new else None, lacking)
    if old.content_hash == new.content_hash:
        return TableDiff(name, State.SAME if old.files == new.files else State.REWRITTEN, old.rows, new.rows, lacking)
    if lacking or name not in ALL_SCHEMAS:
        return TableDiff(name, State.UNREAD, old.rows, new.rows, lacking)
    return TableDiff(name, State.CHANGED, old.rows, new.rows, (), compare_tables(name, _read(a, name), _read(b, name)))


def _read(side: _Side, name: str) -> pa.Table:
    """A table as it lies on disk, whatever its columns."""
    parts = []
    for file, sha256 in side.tables[name].files.items():
        try:
            found = file_sha256(side.directory / file)
            if found != sha256:
                raise ReleaseError(f"{side.directory / file}: SHA-256 {found[:12]}, manifest says {sha256[:12]}")
            parts.append(pq.ParquetFile(side.directory / file).read())  # read_table would take columns from names of folders
        except (OSError, pa.ArrowException) as error:
            raise ReleaseError(f"{side.directory / file}: cannot be read: {error}") from error
    return pa.concat_tables(parts).unify_dictionaries()
