"""What every asset shares: where the data lies, the catalogue, the recipe, the number of workers.

A catalogue or a recipe of one's own comes as an argument, or by the environment variables below, and has a data folder of its own, so that
nothing of the benchmark is overwritten.
"""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path

from dagster import ConfigurableResource, InitResourceContext

from objects.catalogue import PACKAGED_CATALOGUE, catalogue_order
from pipelines.recipe import DEFAULT_RECIPE, Recipe, load_recipe
from pipelines.running.data_root import DataRoot
from pipelines.running.dataset_record import DatasetError, check_dataset, is_packaged
from pipelines.running.shard_runner import ShardInputs, load_shard_inputs
from pipelines.scenes.allocation import family_allocation
from pipelines.values import SceneAllocation
from tables.identity import family_of_shard, family_of_tier
from tables.layout import Layout

REPOSITORY = Path(__file__).resolve().parent.parent
# Read once, when the graph is loaded: its partitions are the shards of one catalogue.
CATALOGUE_VARIABLE, RECIPE_VARIABLE, DATA_VARIABLE = "PLACEBENCH_CATALOGUE", "PLACEBENCH_RECIPE", "PLACEBENCH_DATA"


class Benchmark(ConfigurableResource[None]):
    """Folders, catalogue and recipe; relative paths are below the repository.

    Without `data_dir` the folder is `data`, or `data/own/<name of the catalogue or the recipe>` where one of them is not the benchmark's.
    Without `reports_dir` reports lie in `reports/out`, or in `reports` below another data folder.
    """

    data_dir: str = os.environ.get(DATA_VARIABLE, "")
    reports_dir: str = ""
    catalogue_path: str = os.environ.get(CATALOGUE_VARIABLE) or str(PACKAGED_CATALOGUE)
    recipe_path: str = os.environ.get(RECIPE_VARIABLE) or str(DEFAULT_RECIPE)
    n_workers: int = os.cpu_count() or 1

    def setup_for_execution(self, context: InitResourceContext) -> None:
        """Refuse a run that would mix two datasets; raises as `check`."""
        self.check()

    def check(self) -> None:
        """Raise where the graph or the data folder is of another catalogue.

        Raises:
            CatalogueError: the catalogue is not what it should be.
            DatasetError: the folder holds another dataset, or the graph was loaded with other shards.
        """
        check_dataset(self.root, self.catalogue)
        if self.layout != layout_of_graph():
            raise DatasetError(
                f"{self.catalogue}: its shards are others than those of the graph, which was loaded with"
                f" {CATALOGUE_VARIABLE}={os.environ.get(CATALOGUE_VARIABLE, '')}: load it with this catalogue"
            )

    @property
    def catalogue(self) -> Path:
        return REPOSITORY / self.catalogue_path

    @property
    def recipe_file(self) -> Path:
        return REPOSITORY / self.recipe_path

    @property
    def is_own(self) -> bool:
        """Whether this is another dataset than the benchmark."""
        return not is_packaged(self.catalogue) or self.recipe_file.resolve() != DEFAULT_RECIPE

    @property
    def root(self) -> DataRoot:
        own = Path("data", "own", (self.recipe_file if is_packaged(self.catalogue) else self.catalogue).stem)
        return DataRoot(REPOSITORY / (self.data_dir or (own if self.is_own else "data")))

    @property
    def reports(self) -> Path:
        """Folder of all reports."""
        if self.reports_dir:
            return REPOSITORY / self.reports_dir
        return REPOSITORY / "reports" / "out" if self.root.path == REPOSITORY / "data" else self.root.path / "reports"

    def report_dir(self, tier: str) -> Path:
        return self.reports / tier

    def recipe(self, family: str) -> Recipe:
        return load_recipe(family, self.recipe_file)

    def recipe_of_tier(self, tier: str) -> Recipe:
        return self.recipe(family_of_tier(tier))

    @property
    def layout(self) -> Layout:
        """Scenes, shards and tiers of a dataset of the catalogue."""
        return catalogue_order(self.catalogue).layout

    def universe(self, family: str) -> tuple[SceneAllocation, ...]:
        """Layouts of every scene of a family, built or not."""
        return family_allocation(family, catalogue_order(self.catalogue))

    def shard_inputs(self, shard: str) -> ShardInputs:
        return load_shard_inputs(self.root, shard, self.recipe(family_of_shard(shard)), self.catalogue)


@cache
def layout_of_graph() -> Layout:
    """The layout whose shards are the partitions of the graph in this process: that of the catalogue in the environment."""
    return Benchmark().layout
