"""Trained rankers, one a tier, variant and seed, and what they say of every candidate; the work is model's."""

from collections.abc import Iterator
from typing import Any

import polars as pl
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
from assets_def.metadata import markdown_table, table_metadata
from assets_def.partitions import (
    parse_ranker_key,
    ranker_partitions,
    rankers_of_tier,
    rankers_to_tiers,
    tier_partitions,
    tiers_to_rankers,
)
from assets_def.resources import Benchmark
from assets_def.tier_tables import publish_tier_table
from model.checkpoint import input_errors
from model.scoring import decision_times, score
from model.settings import Variant, settings_named
from model.training import train
from reports.ranking import ranker_timing_rows
from tables.schemas import PREDICTIONS, TIMINGS
from tables.store import file_sha256, join_tables, table_from_rows, write_table

MODEL_CODE_VERSION = "1"
SETTING_OF_TIER = {"mini": "light", "pilot": "light", "full": "full"}


@multi_asset(
    name="train_ranker",
    specs=[
        AssetSpec(
            "ranker",
            deps=[AssetDep("release", partition_mapping=tiers_to_rankers)],
            description="Trains one ranker on the train split of a release; the best epoch is chosen on validation, test is never read.",
            group_name="ranker",
            code_version=MODEL_CODE_VERSION,
            kinds={"pytorch"},
        )
    ],
    check_specs=[
        AssetCheckSpec(
            "consistent",
            asset="ranker",
            blocking=True,
            description="The columns recorded in the checkpoint are the five inputs and their keys: none is known only after planning.",
        )
    ],
    partitions_def=ranker_partitions,
)
def ranker(context: AssetExecutionContext, benchmark: Benchmark) -> Iterator[MaterializeResult | AssetCheckResult]:
    key = parse_ranker_key(context.partition_key)
    settings = settings_named(SETTING_OF_TIER[key.tier])
    out_dir = benchmark.root.checkpoint(key.tier, key.variant.value, key.seed)
    result = train(benchmark.root.release(key.tier), key.variant, key.seed, settings, out_dir, resume=True)
    metadata: dict[str, Any] = {
        "path": MetadataValue.path(str(out_dir)),
        "settings": settings.name,
        "best_epoch": result.best_epoch,
        "selected_by": result.selected_by,
        "parameters": result.n_parameters,
        "train_candidates": result.n_train_candidates,
        "validation_candidates": result.n_validation_candidates,
        "history": MetadataValue.md(markdown_table(pl.DataFrame(result.history, infer_schema_length=None))),
    }
    weights = next(out_dir.glob("*.safetensors"))
    yield MaterializeResult("ranker", metadata=metadata, data_version=DataVersion(file_sha256(weights)))
    yield consistency_result("ranker", input_errors(out_dir))


@multi_asset(
    name="score_candidates",
    specs=[
        AssetSpec(
            "predictions",
            deps=[AssetDep("ranker", partition_mapping=rankers_to_tiers), "release"],
            description=f"Scores every candidate of a tier with every trained ranker. Rows: {PREDICTIONS.meaning}.",
            group_name="ranker",
            code_version=MODEL_CODE_VERSION,
            kinds={"parquet"},
        ),
        AssetSpec(
            "decision_times",
            deps=[AssetDep("ranker", partition_mapping=rankers_to_tiers), "release"],
            description="Times how long the full ranker takes to order each group of the test split, from points and poses in memory.",
            group_name="ranker",
            code_version=MODEL_CODE_VERSION,
            kinds={"parquet"},
        ),
    ],
    check_specs=[schema_check_spec(PREDICTIONS)],
    partitions_def=tier_partitions,
)
def predictions(context: AssetExecutionContext, benchmark: Benchmark) -> Iterator[MaterializeResult | AssetCheckResult]:
    tier = context.partition_key
    release_dir = benchmark.root.release(tier)
    keys = rankers_of_tier(tier)
    tables = [score(release_dir, benchmark.root.checkpoint(tier, key.variant.value, key.seed)) for key in keys]
    yield from publish_tier_table(benchmark, tier, PREDICTIONS, join_tables(PREDICTIONS, tables))

    full = next(key for key in keys if key.variant is Variant.FULL)
    times = decision_times(release_dir, benchmark.root.checkpoint(tier, full.variant.value, full.seed))
    rows = ranker_timing_rows(times)
    path = benchmark.root.tier_table(tier, "decision_times")
    sidecar = write_table(TIMINGS, table_from_rows(TIMINGS, rows), path)
    yield MaterializeResult("decision_times", metadata=table_metadata(TIMINGS, path, sidecar))


ranker_assets = [ranker, predictions]
