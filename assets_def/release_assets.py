"""From shards to a release: joined tables, scene-group splits, the checked release folder; one partition a tier."""

from collections.abc import Iterator, Mapping
from typing import Any

import pyarrow as pa
from dagster import (
    AssetCheckResult,
    AssetCheckSpec,
    AssetDep,
    AssetExecutionContext,
    AssetSpec,
    DataVersion,
    MaterializeResult,
    MetadataValue,
    multi_asset,
)

from assets_def.checks import consistency_result, schema_check_spec
from assets_def.partitions import shards_to_tiers, tier_partitions
from assets_def.resources import Benchmark
from assets_def.tier_tables import publish_tier_table
from objects.catalogue import catalogue_hash, load_catalogue
from pipelines.recipe import Recipe
from pipelines.running.join import join_candidates, join_grasps
from pipelines.running.shard_runner import read_timings
from pipelines.stages import STAGES
from splits.leakage import find_leaks
from splits.manifest import DATA_VERSION
from splits.provenance import git_commit
from splits.release import release_errors, write_release
from splits.release_laws import broken_laws
from splits.scene_groups import SplitParams, split_rows
from tables.identity import family_of_tier, scenes_of_shard, shards_of_tier
from tables.schemas import ALL_SCHEMAS, CANDIDATES, GRASPS, OBJECT_TABLES, SPLITS
from tables.store import read_table, read_tables, table_from_rows

RELEASE_CODE_VERSION = "1"  # of the joined tables and the splits
FOLDER_CODE_VERSION = "2"  # of what stands around the tables in a release folder

# Released as they are; `candidates` and `grasps` replace the four tables they are joined from.
_SHARD_TABLES = ("scenes", "scene_attempts", "obstacles", "targets", "scene_points", "plans", "policy_features")
_JOINED_FROM = {
    "candidates": ("candidate_pairs", "planning_labels", "execution_labels"),
    "grasps": ("grasp_admission", "pick_lift", "scenes"),
}


@multi_asset(
    name="join_shards",
    specs=[
        AssetSpec(
            schema.name,
            deps=[
                *(AssetDep(name, partition_mapping=shards_to_tiers) for name in _JOINED_FROM[schema.name]),
                *(["grasp_pool"] if schema is GRASPS else []),
            ],
            description=f"Joins the shards of a tier. Rows: {schema.meaning}.",
            group_name="release",
            code_version=RELEASE_CODE_VERSION,
            kinds={"parquet"},
        )
        for schema in (CANDIDATES, GRASPS)
    ],
    check_specs=[
        schema_check_spec(CANDIDATES),
        schema_check_spec(GRASPS),
        AssetCheckSpec(
            "consistent", asset="candidates", blocking=True, description="No label contradicts another, no candidate is missing."
        ),
    ],
    partitions_def=tier_partitions,
)
def joined_tables(context: AssetExecutionContext, benchmark: Benchmark) -> Iterator[MaterializeResult | AssetCheckResult]:
    tier = context.partition_key
    shard = {name: _over_shards(benchmark, tier, name) for names in _JOINED_FROM.values() for name in names}
    grasp_pool = benchmark.root.read_objects()["grasp_pool"]
    tables = {
        CANDIDATES.name: join_candidates(*(shard[name] for name in _JOINED_FROM["candidates"])),
        GRASPS.name: join_grasps(shard["grasp_admission"], shard["pick_lift"], shard["scenes"], grasp_pool),
    }
    for schema in (CANDIDATES, GRASPS):
        yield from publish_tier_table(benchmark, tier, schema, tables[schema.name])
    others = {name: _over_shards(benchmark, tier, name) for name in _SHARD_TABLES}
    yield consistency_result("candidates", broken_laws({**tables, **others}, **_tolerances(benchmark.recipe_of_tier(tier))))


@multi_asset(
    name="make_splits",
    specs=[
        AssetSpec(
            "splits",
            deps=[
                "candidates",
                *(AssetDep(name, partition_mapping=shards_to_tiers) for name in ("scenes", "obstacles", "targets")),
                "objects",
            ],
            description="Assigns whole scene groups to train, validation and test by a hash of their id, stratified.",
            group_name="release",
            code_version=RELEASE_CODE_VERSION,
            kinds={"parquet"},
        )
    ],
    check_specs=[
        schema_check_spec(SPLITS),
        AssetCheckSpec("consistent", asset="splits", blocking=True, description="No scene group, candidate or geometry is in two splits."),
    ],
    partitions_def=tier_partitions,
)
def splits_table(context: AssetExecutionContext, benchmark: Benchmark) -> Iterator[MaterializeResult | AssetCheckResult]:
    tier = context.partition_key
    family = family_of_tier(tier)
    universe = [(allocation.scene_id, allocation.category, allocation.n_obstacles) for allocation in benchmark.universe(family)]
    scene_ids = [scene_id for shard in shards_of_tier(tier) for scene_id in scenes_of_shard(shard)]
    splits = table_from_rows(SPLITS, split_rows(scene_ids, universe, SplitParams(), benchmark.recipe(family).seed))
    yield from publish_tier_table(benchmark, tier, SPLITS, splits)
    tables = {name: _over_shards(benchmark, tier, name) for name in ("scenes", "obstacles", "targets")}
    candidates = read_table(CANDIDATES, benchmark.root.tier_table(tier, "candidates"))
    objects = benchmark.root.read_objects()["objects"]
    leaks = find_leaks({**tables, "objects": objects, "candidates": candidates, "splits": splits})
    yield consistency_result("splits", [str(leak) for leak in leaks])


@multi_asset(
    name="make_release",
    specs=[
        AssetSpec(
            "release",
            deps=[
                "splits",
                "candidates",
                "grasps",
                *OBJECT_TABLES,
                *(AssetDep(name, partition_mapping=shards_to_tiers) for name in _SHARD_TABLES),
            ],
            description="Writes the release folder of a tier: Parquet tables, data card, and last the manifest with every checksum.",
            group_name="release",
            code_version=FOLDER_CODE_VERSION,
            kinds={"parquet"},
        )
    ],
    check_specs=[AssetCheckSpec("consistent", asset="release", blocking=True, description="The folder verifies against its own manifest.")],
    partitions_def=tier_partitions,
)
def release(context: AssetExecutionContext, benchmark: Benchmark) -> Iterator[MaterializeResult | AssetCheckResult]:
    tier = context.partition_key
    tables = {
        **benchmark.root.read_objects(),
        **{name: _over_shards(benchmark, tier, name) for name in _SHARD_TABLES},
        **{s.name: read_table(s, benchmark.root.tier_table(tier, s.name)) for s in (CANDIDATES, GRASPS, SPLITS)},
        "timings": read_timings(benchmark.root, shards_of_tier(tier), STAGES),
    }
    directory = benchmark.root.release(tier)
    recipe = benchmark.recipe_of_tier(tier)
    provenance = {
        "recipe_hash": recipe.hash_of(),
        "recipe_seed": str(recipe.seed),
        "catalogue_hash": catalogue_hash(load_catalogue()),
        "git_commit": git_commit(),
        **_code_versions(),
    }
    manifest = write_release(tables, directory, tier, DATA_VERSION, provenance, **_tolerances(recipe))
    metadata: dict[str, Any] = {
        "path": MetadataValue.path(str(directory)),
        "version": manifest.version,
        "release_hash": manifest.release_hash,
        "rows": {name: entry.rows for name, entry in manifest.tables.items()},
        "data_card": MetadataValue.md((directory / "README.md").read_text(encoding="utf-8")),
    }
    yield MaterializeResult("release", metadata=metadata, data_version=DataVersion(manifest.release_hash))
    yield consistency_result("release", release_errors(directory))


release_assets = [joined_tables, splits_table, release]


def _over_shards(benchmark: Benchmark, tier: str, name: str) -> pa.Table:
    """A table over an explicit list of shards: a glob would hide a missing one."""
    return read_tables(ALL_SCHEMAS[name], [benchmark.root.shard_table(shard, name) for shard in shards_of_tier(tier)])


def _tolerances(recipe: Recipe) -> dict[str, float]:
    execution = recipe.execution
    return {"position_tolerance_m": execution.position_tolerance_m, "rotation_tolerance_rad": execution.rotation_tolerance_rad}


def _code_versions() -> Mapping[str, str]:
    return {f"code.{stage.name}": stage.code_version for stage in STAGES}
