"""From shards to a release: joined tables, scene-group splits, the checked release folder; one partition a tier."""

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
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

from assets_def.checks import consistency_check, schema_check, schema_check_spec
from assets_def.inputs import attempts_hash, object_hashes, shard_hashes, tier_hashes, timings_hash
from assets_def.partitions import shards_to_tiers, tier_partitions
from assets_def.products import FilesProduct, TableProduct
from assets_def.resources import Benchmark
from assets_def.steps import Step
from objects.catalogue import catalogue_hash, catalogue_order, load_catalogue
from pipelines.recipe import Recipe
from pipelines.running.join import join_candidates, join_grasps
from pipelines.running.shard_runner import read_timings
from pipelines.stages import STAGES
from splits.citation import CITATION_FILE
from splits.leakage import find_leaks
from splits.manifest import DATA_VERSION, MANIFEST, read_manifest
from splits.provenance import git_commit, own_provenance
from splits.release import release_errors, write_release
from splits.release_laws import broken_laws
from splits.scene_groups import SplitParams
from splits.schemes import catalogue_sizes, empty_parts, not_applying, parts_of_catalogue, split_table
from tables.columns import TableSchema
from tables.identity import family_of_tier
from tables.schemas import ALL_SCHEMAS, CANDIDATES, GRASPS, OBJECT_TABLES, SCHEMA_VERSION, SPLITS
from tables.store import file_sha256, read_table, read_tables
from tables.vocabulary import Allocation

RELEASE_CODE_VERSION = "1"  # of the joined tables
SPLITS_CODE_VERSION = "2"
FOLDER_CODE_VERSION = "5"  # of what stands around the tables in a release folder

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
def joined_tables(context: AssetExecutionContext, benchmark: Benchmark) -> Iterator[MaterializeResult[None] | AssetCheckResult]:
    tier = context.partition_key
    candidates, grasps = _joined_products(benchmark, tier)
    yield from candidates.publish(lambda: join_candidates(*_joined_from(benchmark, tier, CANDIDATES)))
    yield from grasps.publish(lambda: join_grasps(*_joined_from(benchmark, tier, GRASPS), benchmark.root.read_objects()["grasp_pool"]))
    yield from _joined_checks(benchmark, tier)


def _joined_products(benchmark: Benchmark, tier: str) -> tuple[TableProduct, TableProduct]:
    code = {"code": RELEASE_CODE_VERSION}
    from_candidates, from_grasps = (shard_hashes(benchmark, tier, _JOINED_FROM[schema.name]) for schema in (CANDIDATES, GRASPS))
    return (
        TableProduct(CANDIDATES, benchmark.root.tier_table(tier, "candidates"), code | from_candidates, tier),
        TableProduct(
            GRASPS, benchmark.root.tier_table(tier, "grasps"), code | from_grasps | object_hashes(benchmark, ["grasp_pool"]), tier
        ),
    )


def _joined_checks(benchmark: Benchmark, tier: str) -> Iterator[AssetCheckResult]:
    for schema in (CANDIDATES, GRASPS):
        yield schema_check(schema, benchmark.root.tier_table(tier, schema.name))

    def errors() -> list[str]:
        tables = {name: _over_shards(benchmark, tier, name) for name in _SHARD_TABLES} | _of_tier(benchmark, tier, "candidates", "grasps")
        return broken_laws(tables, benchmark.recipe_of_tier(tier).execution.tolerances)

    yield consistency_check("candidates", errors)


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
            description="Assigns whole scene groups to train, validation and test by a hash of their id, stratified; and again by object,"
            " by category and by layout.",
            group_name="release",
            code_version=SPLITS_CODE_VERSION,
            kinds={"parquet"},
        )
    ],
    check_specs=[
        schema_check_spec(SPLITS),
        AssetCheckSpec(
            "consistent",
            asset="splits",
            blocking=True,
            description="No scene group, candidate or geometry is in two splits of a scheme; what a scheme holds out is in test alone.",
        ),
    ],
    partitions_def=tier_partitions,
)
def splits_table(context: AssetExecutionContext, benchmark: Benchmark) -> Iterator[MaterializeResult[None] | AssetCheckResult]:
    tier = context.partition_key
    (splits,) = _splits_products(benchmark, tier)
    scene_ids = benchmark.layout.scenes_of_tier(tier)
    universe, seed = benchmark.universe(family_of_tier(tier)), benchmark.recipe_of_tier(tier).seed
    yield from splits.publish(lambda: split_table(scene_ids, universe, benchmark.catalogue, SplitParams(), seed))
    without = not_applying(dict(catalogue_order(benchmark.catalogue).objects))
    for scheme, reason in without.items():
        context.log.info(f"scheme {scheme} is of no use: {reason}")
    for scheme, split in empty_parts(_of_tier(benchmark, tier, "splits")["splits"]):
        if scheme not in without:
            context.log.warning(f"{tier} has no scene in {split} of scheme {scheme}: it can be used on a larger tier only")
    yield from _splits_checks(benchmark, tier)


def _splits_products(benchmark: Benchmark, tier: str) -> tuple[TableProduct]:
    seed, is_appended = benchmark.recipe_of_tier(tier).seed, catalogue_order(benchmark.catalogue).allocation is Allocation.APPENDED
    parameters = {
        "universe": [asdict(allocation) for allocation in benchmark.universe(family_of_tier(tier))],
        "params": asdict(SplitParams()),
        **({"parts": parts_of_catalogue(benchmark.catalogue, seed)} if is_appended else {"sizes": catalogue_sizes(benchmark.catalogue)}),
        "seed": seed,
    }
    parameters_sha256 = hashlib.sha256(json.dumps(parameters, sort_keys=True).encode()).hexdigest()
    made_from = {"code": SPLITS_CODE_VERSION, "tier": tier, "parameters": parameters_sha256}
    return (TableProduct(SPLITS, benchmark.root.tier_table(tier, "splits"), made_from, tier),)


def _splits_checks(benchmark: Benchmark, tier: str) -> Iterator[AssetCheckResult]:
    yield schema_check(SPLITS, benchmark.root.tier_table(tier, "splits"))

    def errors() -> list[str]:
        tables = {name: _over_shards(benchmark, tier, name) for name in ("scenes", "obstacles", "targets")}
        objects = {"objects": benchmark.root.read_objects()["objects"]}
        return [str(leak) for leak in find_leaks(tables | objects | _of_tier(benchmark, tier, "candidates", "splits"))]

    yield consistency_check("splits", errors)


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
            description="Writes the release folder of a tier: Parquet tables, data card, datasheet, Croissant metadata, last the manifest"
            " with every checksum. Attempts, which are made from it, are in it from its next materialization on.",
            group_name="release",
            code_version=FOLDER_CODE_VERSION,
            kinds={"parquet"},
        )
    ],
    check_specs=[AssetCheckSpec("consistent", asset="release", blocking=True, description="The folder verifies against its own manifest.")],
    partitions_def=tier_partitions,
)
def release(context: AssetExecutionContext, benchmark: Benchmark) -> Iterator[MaterializeResult[None] | AssetCheckResult]:
    tier = context.partition_key
    directory = benchmark.root.release(tier)
    (product,) = _release_products(benchmark, tier)
    _, is_reused = product.publish(lambda: (_write_release(benchmark, tier, directory), {}))
    manifest = read_manifest(directory)
    metadata: dict[str, Any] = {
        "path": MetadataValue.path(str(directory)),
        "version": manifest.version,
        "release_hash": manifest.release_hash,
        "rows": {name: entry.rows for name, entry in manifest.tables.items()},
        "data_card": MetadataValue.md((directory / "README.md").read_text(encoding="utf-8")),
        "reused": is_reused,
    }
    yield MaterializeResult("release", metadata=metadata, data_version=DataVersion(manifest.release_hash))
    yield from _release_checks(benchmark, tier)


def _write_release(benchmark: Benchmark, tier: str, directory: Path) -> list[Path]:
    tables = {
        **benchmark.root.read_objects(),
        **{name: _over_shards(benchmark, tier, name) for name in _SHARD_TABLES},
        **_of_tier(benchmark, tier, "candidates", "grasps", "splits"),
        "timings": read_timings(benchmark.root, benchmark.layout.shards_of_tier(tier), STAGES),
    }
    if attempts_hash(benchmark, tier):
        tables |= _of_tier(benchmark, tier, "attempts")
    recipe = benchmark.recipe_of_tier(tier)
    provenance = {**_provenance(benchmark, recipe), "git_commit": git_commit()}
    manifest = write_release(tables, directory, tier, DATA_VERSION, provenance, recipe.execution.tolerances)
    return [directory / name for name in (MANIFEST, *manifest.files)]


def _release_products(benchmark: Benchmark, tier: str) -> tuple[FilesProduct]:
    recipe = benchmark.recipe_of_tier(tier)
    made_from = {
        "code": FOLDER_CODE_VERSION,
        "data_version": DATA_VERSION,
        "schema_version": SCHEMA_VERSION,
        "citation": file_sha256(CITATION_FILE),
        **object_hashes(benchmark, OBJECT_TABLES),
        **shard_hashes(benchmark, tier, _SHARD_TABLES),
        **tier_hashes(benchmark, tier, ("candidates", "grasps", "splits")),
        **attempts_hash(benchmark, tier),
        "timings": timings_hash(benchmark, tier),
        **{f"tolerances.{name}": str(value) for name, value in asdict(recipe.execution.tolerances).items()},
        **_provenance(benchmark, recipe),
    }
    return (FilesProduct(benchmark.root.tier_table(tier, "release").with_suffix(".made_from.json"), made_from),)


def _release_checks(benchmark: Benchmark, tier: str) -> Iterator[AssetCheckResult]:
    yield consistency_check("release", lambda: release_errors(benchmark.root.release(tier)))


release_assets = [joined_tables, splits_table, release]
release_step = Step("release", release, _release_products, _release_checks)
release_steps = (
    Step("candidates and grasps", joined_tables, _joined_products, _joined_checks),
    Step("splits", splits_table, _splits_products, _splits_checks),
    release_step,
)


def _over_shards(benchmark: Benchmark, tier: str, name: str) -> pa.Table:
    """A table over an explicit list of shards: a glob would hide a missing one."""
    return read_tables(ALL_SCHEMAS[name], [benchmark.root.shard_table(shard, name) for shard in benchmark.layout.shards_of_tier(tier)])


def _joined_from(benchmark: Benchmark, tier: str, schema: TableSchema) -> tuple[pa.Table, pa.Table, pa.Table]:
    first, second, third = (_over_shards(benchmark, tier, name) for name in _JOINED_FROM[schema.name])
    return first, second, third


def _of_tier(benchmark: Benchmark, tier: str, *names: str) -> dict[str, pa.Table]:
    return {name: read_table(ALL_SCHEMAS[name], benchmark.root.tier_table(tier, name)) for name in names}


def _provenance(benchmark: Benchmark, recipe: Recipe) -> dict[str, str]:
    """What identifies the making of a release; the commit, which says no more about the tables, is added when it is written."""
    hashes = {"recipe_hash": recipe.hash_of(), "catalogue_hash": catalogue_hash(load_catalogue(benchmark.catalogue))}
    if benchmark.is_own:
        allocation = catalogue_order(benchmark.catalogue).allocation
        hashes |= own_provenance(benchmark.catalogue.name, benchmark.recipe_file.name, allocation)
    return {**hashes, "recipe_seed": str(recipe.seed), **_code_versions()}


def _code_versions() -> Mapping[str, str]:
    return {f"code.{stage.name}": stage.code_version for stage in STAGES}
