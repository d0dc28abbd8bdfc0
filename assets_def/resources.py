"""What every asset shares: where the data lies, the recipe, the objects, the number of workers."""

from __future__ import annotations

import os
from pathlib import Path

from dagster import ConfigurableResource

from objects.catalogue import load_catalogue
from objects.kit import ObjectKit, kits_from_tables
from pipelines.data_root import OBJECT_TABLES, DataRoot
from pipelines.layout import SceneLayout, family_layout, scene_layout
from pipelines.recipe import DEFAULT_RECIPE, Recipe, load_recipe
from pipelines.shard_runner import ShardInputs
from tables.identity import parse_scene_id, scenes_of_shard
from tables.store import read_sidecar

REPOSITORY = Path(__file__).resolve().parent.parent


class Benchmark(ConfigurableResource):
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

    def recipe_of_shard(self, shard: str) -> Recipe:
        return self.recipe(family_of_shard(shard))

    def recipe_of_tier(self, tier: str) -> Recipe:
        return self.recipe(family_of_tier(tier))

    def kits(self) -> dict[str, ObjectKit]:
        tables = self.root.read_objects()
        return kits_from_tables(**tables)

    def universe(self, family: str) -> tuple[SceneLayout, ...]:
        """Layouts of every scene of a family, built or not."""
        return family_layout(family, catalogue_order())

    def shard_inputs(self, shard: str) -> ShardInputs:
        layouts = [scene_layout(scene_id, catalogue_order()) for scene_id in scenes_of_shard(shard)]
        hashes = [read_sidecar(self.root.object_table(name)).content_hash for name in OBJECT_TABLES]
        return ShardInputs(self.recipe_of_shard(shard), self.kits(), layouts, "-".join(h[:16] for h in hashes))


def catalogue_order() -> list[tuple[str, str]]:
    """(object id, category) in catalogue order."""
    return [(spec.object_id, str(spec.category)) for spec in load_catalogue()]


def family_of_tier(tier: str) -> str:
    return "mini" if tier == "mini" else "full"


def family_of_shard(shard: str) -> str:
    return parse_scene_id(scenes_of_shard(shard)[0])[0]
