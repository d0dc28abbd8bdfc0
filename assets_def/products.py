"""What the assets above the shards publish: made where what it is made from has changed, kept where it has not.

A table has its record in its sidecar; other files (a release, a checkpoint, a report) have a small JSON file of the same meaning. A
shard's own tables are kept or made by pipelines.running.shard_runner.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Protocol

import pyarrow as pa
from dagster import DataVersion, MaterializeResult

from assets_def.metadata import table_metadata
from pipelines.running.lock import locked
from tables.columns import TableSchema
from tables.files import file_sha256, write_text_atomically
from tables.sidecar import Sidecar, find_published
from tables.store import write_table


class Product(Protocol):
    """Something published, with a record of what it was made from."""

    def is_current(self) -> bool:
        """Whether it is on disk, unchanged, and made from what it would be made from today."""


@dataclass(frozen=True, slots=True)
class TableProduct:
    """A table of a tier.

    Attributes:
        made_from: what identifies its inputs: content hashes, code version, parameters.
        of: whose table it is: the tier.
        asset: the asset's name, where it is not the table's.
    """

    schema: TableSchema
    path: Path
    made_from: Mapping[str, str]
    of: str
    asset: str = ""

    def current(self) -> Sidecar | None:
        """The sidecar of the table on disk, None where it has to be made."""
        found = find_published(self.schema, self.path, self.made_from, self.of)
        return found if isinstance(found, Sidecar) else None

    def is_current(self) -> bool:
        return self.current() is not None

    def publish(self, make: Callable[[], pa.Table]) -> Iterator[MaterializeResult[None]]:
        """Write what `make` returns, or keep what is there; then the materialization."""
        sidecar = self.current()
        is_reused = sidecar is not None
        if sidecar is None:
            with locked(self.path.with_name(f".{self.path.name}.lock"), f"{self.schema.name} of {self.of}"):
                sidecar = write_table(self.schema, make(), self.path, self.made_from, of=self.of)
        metadata = table_metadata(self.schema, self.path, sidecar) | {"reused": is_reused}
        yield MaterializeResult(self.asset or self.schema.name, metadata=metadata, data_version=DataVersion(sidecar.content_hash))


@dataclass(frozen=True, slots=True)
class Record:
    """What files were made from, the SHA-256 of each by its path from the record's folder, and facts about them worth showing."""

    made_from: dict[str, str]
    files: dict[str, str]
    facts: dict[str, Any] = field(default_factory=dict)

    @property
    def content_hash(self) -> str:
        """SHA-256 over names and hashes of the files."""
        return hashlib.sha256(json.dumps(self.files, sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True, slots=True)
class FilesProduct:
    """Files that are made together.

    Attributes:
        path: of the record, written last.
        made_from: what identifies their inputs.
    """

    path: Path
    made_from: Mapping[str, str]

    def current(self) -> Record | None:
        """The record on disk, None where the files have to be made."""
        try:
            record = Record(**json.loads(self.path.read_text(encoding="utf-8")))
            is_unchanged = all(file_sha256(self.path.parent / name) == sha256 for name, sha256 in record.files.items())
        except (OSError, ValueError, TypeError):  # a record or a file that is missing, or no record
            return None
        return record if record.made_from == self.made_from and is_unchanged else None

    def is_current(self) -> bool:
        return self.current() is not None

    def publish(self, make: Callable[[], tuple[Iterable[Path], dict[str, Any]]]) -> tuple[Record, bool]:
        """The record, and whether what was there is kept; otherwise `make` writes the files and returns them with the facts."""
        record = self.current()
        if record is not None:
            return record, True
        with locked(self.path.with_name(f".{self.path.name}.lock"), str(self.path)):
            self.path.unlink(missing_ok=True)
            files, facts = make()
            hashes = {os.path.relpath(file, self.path.parent): file_sha256(file) for file in sorted(files)}
            record = Record(dict(self.made_from), hashes, facts)
            write_text_atomically(self.path, json.dumps(asdict(record), indent=1, sort_keys=True) + "\n")
        return record, False
