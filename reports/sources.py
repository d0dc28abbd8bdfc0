"""What reports are rendered from: a release, and a folder of tables that were made about it; what each report reads is in kinds.py."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

from pipelines.recipe import DEFAULT_RECIPE, Recipe, load_recipe
from pipelines.running.data_root import DataRoot
from reports.report import ReportError
from splits.release_folder import left_out_error
from splits.release_reader import Release
from tables.columns import TableSchema
from tables.identity import family_of_tier
from tables.schemas import ATTEMPTS, AUDITS, PREDICTIONS, TEST_REPLICATES, TIMINGS
from tables.store import read_sidecar, read_table

# Made from a release, so after it and beside it: names of the files, and their tables. `attempts` may be in the release too; those of the
# folder are the newer ones.
BESIDE: dict[str, TableSchema] = {
    "predictions": PREDICTIONS,
    "decision_times": TIMINGS,
    "tree_predictions": PREDICTIONS,
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
    """

    release: Release
    beside: Path
    recipe_path: Path = DEFAULT_RECIPE

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
            ReportError: it is not the one that made the release.
        """
        recipe, stated = load_recipe(family_of_tier(self.tier), self.recipe_path), self.release.manifest.provenance["recipe_hash"]
        if recipe.hash_of() != stated:
            raise ReportError(f"the release is of recipe {stated[:12]}, must be this code's {recipe.hash_of()[:12]}")
        return recipe

    def table(self, name: str) -> pa.Table:
        """A table of the release or about it.

        Raises:
            ReleaseError: a table that the release does not have, leaves out, or holds otherwise than listed.
            StoreError: a file of the folder that is missing or damaged.
            ReportError: a table about another release.
        """
        if name not in BESIDE or (not self.path(name).exists() and self._is_released(name)):
            return self.release.table(name)
        path = self.path(name)
        of = read_sidecar(path).made_from.get("release")
        if of not in (None, self.release.manifest.release_hash):
            raise ReportError(f"{path}: about release {str(of)[:12]}, must be about {self.release.manifest.release_hash[:12]}")
        return read_table(BESIDE[name], path, verify=True)

    def tables(self, names: Iterable[str]) -> dict[str, pa.Table]:
        """Some tables by name; raises as `table` does."""
        return {name: self.table(name) for name in names}

    def there(self, names: Iterable[str]) -> list[str]:
        """Those of some tables that there are."""
        return [name for name in names if self._is_released(name) or (name in BESIDE and self.path(name).exists())]

    def missing(self, name: str) -> str:
        """Why a table is not there, naming its file and the command that makes it again where there is one."""
        if name in BESIDE:
            return f"{self.path(name)} is missing"
        path = self.release.directory / f"{name}.parquet"
        if name in self.release.left_out:
            return f"{path} is missing: {left_out_error(self.release.directory, name)}"
        return f"{path} is missing: the release has no such table"

    def path(self, name: str) -> Path:
        """Where a table about the release lies."""
        return self.beside / f"{name}.parquet"

    def _is_released(self, name: str) -> bool:
        return name in self.release.manifest.tables and name not in self.release.left_out


def folder_beside(directory: Path, tier: str) -> Path:
    """Where the tables about a release of a data folder lie: those shipped with it if there are any, else those of the last build."""
    root = DataRoot(directory.resolve().parent.parent)
    shipped, built = root.predictions(tier), root.tier_table(tier, "predictions").parent
    return built if built.is_dir() and not shipped.is_dir() else shipped
