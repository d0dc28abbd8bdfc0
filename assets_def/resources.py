"""What every asset shares: where the data lies, the recipe, the objects, the number of workers."""

from __future__ import annotations

import os
from pathlib import Path

from dagster import ConfigurableResource

from objects.catalogue import catalogue_order
from pipelines.recipe import DEFAULT_RECIPE, Recipe, load_recipe
from pipelines.running.data_root import DataRoot
from pipelines.running.shard_runner import ShardInputs, load_shard_inputs
from pipelines.scenes.allocation import family_allocation
from pipelines.values import SceneAllocation
from tables.identity import family_of_shard, family_of_tier

REPOSITORY = Path(__file__).resolve().parent.parent


class Benchmark(ConfigurableResource[None]):
    """Folders and recipe of this checkout; relative paths are below the repository."""

    data_dir: str = "data"
    reports_dir: str = "reports/out"
    recipe_path: str = str(DEFAULT_RECIPE)
    n_workers: int = os.cpu_count() or 1

    @property
    def root(self) -> DataRoot:
        return DataRoot(REPOSITORY / self.data_dir)

    def report_dir(self, tier: str) -> Path:
        return REPOSITORY / self.reports_dir / tier

    def recipe(self, family: str) -> Recipe:
        return load_recipe(family, Path(self.recipe_path))

    def recipe_of_tier(self, tier: str) -> Recipe:
        return self.recipe(family_of_tier(tier))

    def universe(self, family: str) -> tuple[SceneAllocation, ...]:
        """Layouts of every scene of a family, built or not."""
        return family_allocation(family, catalogue_order())

    def shard_inputs(self, shard: str) -> ShardInputs:
        return load_shard_inputs(self.root, shard, self.recipe(family_of_shard(shard)))
