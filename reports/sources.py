"""What reports are rendered from: a release, and a folder of tables that were made about it; what each report reads is in kinds.py."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pyarrow as pa

from pipelines.recipe import DEFAULT_RECIPE, Recipe
from pipelines.running.data_root import DataRoot
from reports.load import Task
from reports.predictions import check_scheme, seeds_of_variants
from reports.report import ReportError
from splits.origin import recipe_of
from splits.release_folder import left_out_error
from splits.release_reader import Release
from tables.columns import TableSchema
from tables.schemas import ATTEMPTS, AUDITS, LEARNING_CURVE, PLANNER_COSTS, PREDICTIONS, TEST_REPLICATES, TIMINGS
from tables.store import join_tables, read_sidecar, read_table
from tables.vocabulary import SplitScheme


def scores_of(scheme: SplitScheme) -> list[str]:
    """Names of the tables of what networks and trees say, of rankers of a scheme: in a folder of its name where it is not the paper's."""
    folder = "" if scheme is SplitScheme.SCENE else f"{scheme.value}/"
    return [f"{folder}{name}" for name in ("predictions", "tree_predictions")]


# Made from a release, so after it and beside it: names of the files, and their tables. `attempts` may be in the release too; those of the
# folder are the newer ones.
BESIDE: dict[str, TableSchema] = {
    **{name: PREDICTIONS for scheme in SplitScheme for name in scores_of(scheme)},
    "decision_times": TIMINGS,
    "tree_decision_times": TIMINGS,
    "planner_costs": PLANNER_COSTS,
    "learning_curve": LEARNING_CURVE,
    "attempts": ATTEMPTS,
    "audits": AUDITS,
    "test_replicates": TEST_REPLICATES,
}

_DEFAULT_SEED = "42"  # of releases whose provenance does not name the seed of the recipe


@dataclass(frozen=True, slots=True, eq=False)
class Sources:
    """A release, and the folder of the tables about it (`BESIDE`), each with its sidecar.

    Attributes:
        recipe_path: the recipe of this checkout; films need the one that made the release.
        scheme: by what scenes are dealt to the splits; predictions must be of rankers that were trained under it.
    """

    release: Release
    beside: Path
    recipe_path: Path = DEFAULT_RECIPE
    scheme: SplitScheme = SplitScheme.SCENE
    # Several reports read predictions, which are large and checked value by value.
    _read: dict[str, pa.Table] = field(default_factory=dict, init=False, repr=False)

    @property
    def tier(self) -> str:
        return self.release.manifest.tier

    @property
    def seed(self) -> int:
        """Seed of the recipe that made the release: of the hash order and of every resampling."""
        return int(self.release.manifest.provenance.get("recipe_seed", _DEFAULT_SEED))

    def recipe(self) -> Recipe:
        """The recipe of this checkout for the release's family.

        Raises:
            ReleaseError: it is not the one that made the release.
        """
        return recipe_of(self.release.manifest, self.recipe_path)

    def table(self, name: str) -> pa.Table:
        """A table of the release or about it.

        Raises:
            ReleaseError: a table that the release does not have, leaves out, or holds otherwise than listed.
            StoreError: a file of the folder that is missing or damaged.
            ReportError: a table about another release, or predictions of rankers that were trained under another split.
        """
        if name not in BESIDE or (not self.path(name).exists() and self._is_released(name)):
            return self.release.table(name)
        if name not in self._read:
            self._read[name] = self._read_beside(name)
        return self._read[name]

    def _read_beside(self, name: str) -> pa.Table:
        path = self.path(name)
        made_from = read_sidecar(path).made_from
        of = made_from.get("release")
        if of not in (None, self.release.manifest.release_hash):
            raise ReportError(f"{path}: about release {str(of)[:12]}, must be about {self.release.manifest.release_hash[:12]}")
        if BESIDE[name] is PREDICTIONS:
            scheme, _, _ = name.rpartition("/")
            check_scheme(path, made_from, SplitScheme(scheme) if scheme else self.scheme)
        return read_table(BESIDE[name], path, verify=True)

    def origin(self, name: str, what: str) -> str:
        """What the sidecar of a table about the release says of its making, such as the machine; "" where it says nothing."""
        return read_sidecar(self.path(name)).made_from.get(what, "")

    def scores(self, scheme: SplitScheme = SplitScheme.SCENE) -> pa.Table | None:
        """What networks and trees say, as far as they are there; None where neither are, raises as `table`.

        Args:
            scheme: what they were trained under; with the paper's, the tables of the folder itself, which are of `self.scheme`.
        """
        there = self.tables(self.there(scores_of(scheme)))
        return join_tables(PREDICTIONS, list(there.values())) if there else None

    def tables(self, names: Iterable[str]) -> dict[str, pa.Table]:
        """Some tables by name; raises as `table` does."""
        return {name: self.table(name) for name in names}

    def there(self, names: Iterable[str]) -> list[str]:
        """Those of some tables that there are."""
        return [name for name in names if self._is_released(name) or (name in BESIDE and self.path(name).exists())]

    def missing(self, name: str, parts: Sequence[str] = ()) -> str:
        """What is not there of a table, naming its file and the command that makes it again where there is one; "" where all is.

        Args:
            parts: what the table must hold: tasks of `decision_times`; variants of `predictions` and `tree_predictions`, all of the same
                seeds, or one training of a variant, as `trees.42`.

        Raises:
            StoreError, ReportError: the table is there, but `table` does not take it.
        """
        if self.there([name]):
            lacking = self._lacking(name, parts) if parts else []
            return f"{self.path(name)} is there without {', '.join(lacking)}" if lacking else ""
        if name in BESIDE:
            return f"{self.path(name)} is missing"
        path = self.release.directory / f"{name}.parquet"
        if name in self.release.left_out:
            return f"{path} is missing: {left_out_error(self.release.directory, name)}"
        return f"{path} is missing: the release has no such table"

    def _lacking(self, name: str, parts: Sequence[str]) -> list[str]:
        """Parts that a table has no row of; of rankers also the seeds that one has not and another has."""
        table = self.table(name)
        if BESIDE[name] is not PREDICTIONS:
            found = {Task.FIXED if "-t" in item else Task.JOINT for item in table["item_id"].to_pylist()}
            return [f"task {part}" for part in parts if Task(part) not in found]
        known = seeds_of_variants(table)
        every = sorted({seed for part in parts for seed in known.get(part, ())})
        lacking = []
        for part in parts:
            variant, _, one = part.partition(".")
            wanted = [int(one)] if one else every
            if variant not in known:
                lacking.append(variant)
            elif own := [str(seed) for seed in wanted if seed not in known[variant]]:
                lacking.append(f"{variant} of seed {', '.join(own)}")
        return lacking

    def path(self, name: str) -> Path:
        """Where a table about the release lies."""
        return self.beside / f"{name}.parquet"

    def _is_released(self, name: str) -> bool:
        return name in self.release.manifest.tables and name not in self.release.left_out


def folder_beside(directory: Path, tier: str, scheme: SplitScheme = SplitScheme.SCENE) -> Path:
    """Where the tables about a release of a data folder lie: those shipped with it if there are any, else those of the last build.

    Those of another split than the paper's lie in a folder of its name below them.
    """
    root = DataRoot(directory.resolve().parent.parent)
    shipped, built = root.predictions(tier), root.tier_table(tier, "predictions").parent
    folder = built if built.is_dir() and not shipped.is_dir() else shipped
    return folder if scheme is SplitScheme.SCENE else folder / scheme.value
