"""A release to read: opened and checked once, each table read once. `verify_release` in release.py asks whether the labels make sense.

```python
release = Release.open("data/release/mini")
release.manifest.version
release.table("targets")
release.candidates.filter(pl.col("split") == "test")
```
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path

import polars as pl
import pyarrow as pa

from pipelines.decoded import Decoded
from pipelines.frames import frame_of
from pipelines.values import Candidate, Scene
from splits.errors import ReleaseError
from splits.manifest import Manifest, read_manifest
from splits.provenance import is_own
from splits.release_folder import check_files, left_out, left_out_error, read_released_table


class Release:
    """The tables of one release folder; whatever was read stays in memory as long as this object."""

    def __init__(self, directory: Path, manifest: Manifest, *, is_verified: bool) -> None:
        """Call `Release.open`, which checks the folder."""
        self.directory = directory
        self.manifest = manifest
        self._is_verified = is_verified
        self._tables: dict[str, pa.Table] = {}

    @classmethod
    def open(cls, directory: Path | str, *, verify: bool = False) -> Release:
        """Open a release folder.

        Always checked are the manifest with its own hash and versions, and that every listed file is there in its size; tables
        must have their columns and number of rows when they are read. Other files in the folder do not matter. A light release opens
        too: what it leaves out is in `left_out`, and asking for it says how to make it again.

        Args:
            verify: also compare the SHA-256 of every listed file now, and check every value of a table when it is read.

        Raises:
            ReleaseError: names the first file or field that is wrong, what was found and what it must be.
        """
        directory = Path(directory)
        manifest = read_manifest(directory)
        check_files(directory, manifest, hashes=verify, without=left_out(directory, manifest))
        return cls(directory, manifest, is_verified=verify)

    def table(self, name: str) -> pa.Table:
        """One table; raises ReleaseError where the release has none of that name, leaves it out, or holds it otherwise than listed."""
        if name not in self._tables:
            if name in self.left_out:
                raise left_out_error(self.directory, name)
            self._tables[name] = read_released_table(self.directory, self.manifest, name, verify=self._is_verified)
        return self._tables[name]

    def tables(self, *names: str) -> dict[str, pa.Table]:
        """Some tables by name, or without names all that are there; raises as `table` does."""
        return {name: self.table(name) for name in names or sorted(self.manifest.tables.keys() - set(self.left_out))}

    @property
    def left_out(self) -> tuple[str, ...]:
        """Heavy tables that the manifest lists and the folder does not hold; empty for a whole release."""
        return left_out(self.directory, self.manifest)

    @cached_property
    def candidates(self) -> pl.DataFrame:
        """Table `candidates` in its order, with strings for dictionaries and the columns of `splits`: `split`, `split_object` and on.

        Raises:
            ReleaseError: a candidate whose scene is in no split or in several.
        """
        splits = frame_of(self.table("splits"))
        frame = frame_of(self.table("candidates"))
        joined = frame.join(splits, on="scene_id", how="left", maintain_order="left")
        lost = joined.filter(pl.col("split").is_null())
        if not lost.is_empty() or joined.height != frame.height:
            found = f"scene {lost['scene_id'][0]} is in none" if not lost.is_empty() else f"{joined.height - frame.height} rows too many"
            raise ReleaseError(f"splits: every scene of candidates must be in 1 split; {found}")
        return joined

    @cached_property
    def values(self) -> Decoded:
        """Candidates with labels and plans, scenes and object models by id; tables are read when they are asked for."""
        return Decoded(_TablesOf(self))

    def candidate(self, candidate_id: str) -> Candidate:
        """A candidate; raises IdentityError where the release has none of that id."""
        self.values.labels(candidate_id)
        return self.values.candidate(candidate_id)

    def scene(self, scene_id: str) -> Scene:
        """A scene; raises IdentityError where the release has none of that id."""
        return self.values.scene(scene_id)


def report_folder(release: Release) -> Path:
    """Where reports of a release go: `reports/out/TIER`, or of a dataset of one's own `reports/TIER` in its data folder."""
    tier = release.manifest.tier
    if not is_own(release.manifest.provenance):
        return Path("reports/out") / tier
    return release.directory.resolve().parent.parent / "reports" / tier


class _TablesOf(Mapping[str, pa.Table]):
    """The tables of a release by name, each read when it is asked for."""

    def __init__(self, release: Release) -> None:
        self._release = release

    def __getitem__(self, name: str) -> pa.Table:
        return self._release.table(name)

    def __iter__(self) -> Iterator[str]:
        return iter(sorted(self._release.manifest.tables))

    def __len__(self) -> int:
        return len(self._release.manifest.tables)
