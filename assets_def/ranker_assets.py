"""Trained rankers, one a tier, variant and seed, and what they say of every candidate; the work is model's."""

import json
import shutil
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
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

from assets_def.checks import consistency_check, schema_check, schema_check_spec
from assets_def.inputs import release_hashes
from assets_def.metadata import markdown_table
from assets_def.partitions import (
    RankerKey,
    parse_ranker_key,
    ranker_partitions,
    rankers_of_tier,
    rankers_to_tiers,
    tier_partitions,
    tiers_to_rankers,
)
from assets_def.products import FilesProduct, TableProduct
from assets_def.ranker_training import SHIPPED, folder_name, settings_of
from assets_def.resources import Benchmark
from assets_def.steps import Step
from model.checkpoint import identity_of, input_errors, is_checkpoint_of, load_checkpoint
from model.inputs import contract_hash
from model.scoring import decision_times, score, timing_machine
from model.settings import Variant, settings_to_dict
from model.training import train
from reports.policies import LEARNED
from reports.ranking import MACHINE, ranker_timing_rows
from tables.schemas import PREDICTIONS, TIMINGS
from tables.store import StoreError, file_sha256, join_tables, table_from_rows

MODEL_CODE_VERSION = "2"
# Changes whenever what the same weights say may be stored otherwise.
SCORING_CODE_VERSION = "2"
_TIMED = {policy.variant for policy in LEARNED if policy.group_stage}


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
def ranker(context: AssetExecutionContext, benchmark: Benchmark) -> Iterator[MaterializeResult[None] | AssetCheckResult]:
    key = parse_ranker_key(context.partition_key)
    out_dir = _checkpoint(benchmark, key)
    (product,) = _ranker_products(benchmark, str(key))
    record, is_reused = product.publish(lambda: _train(benchmark, key))
    facts = {name: value for name, value in record.facts.items() if name != "history"}
    shown: dict[str, Any] = {
        "path": MetadataValue.path(str(out_dir)),
        **facts,
        "history": MetadataValue.md(markdown_table(pl.DataFrame(record.facts["history"], infer_schema_length=None))),
        "reused": is_reused,
    }
    yield MaterializeResult("ranker", metadata=shown, data_version=DataVersion(_weights_sha256(benchmark, key)))
    yield from _ranker_checks(benchmark, str(key))


def _ranker_checks(benchmark: Benchmark, partition: str) -> Iterator[AssetCheckResult]:
    yield consistency_check("ranker", lambda: input_errors(_checkpoint(benchmark, parse_ranker_key(partition))))


def _train(benchmark: Benchmark, key: RankerKey) -> tuple[list[Path], dict[str, Any]]:
    """Train a ranker, or take over the one that is shipped if it is of this very training."""
    release_dir, out_dir = benchmark.root.release(key.tier), _checkpoint(benchmark, key)
    settings = settings_of(key)
    shipped = SHIPPED / key.tier / folder_name(key)
    is_shipped = is_checkpoint_of(shipped, identity_of(release_dir, key.variant, key.seed, settings))
    if is_shipped:
        shutil.copytree(shipped, out_dir, dirs_exist_ok=True)
    else:
        train(release_dir, key.variant, key.seed, settings, out_dir, resume=True)
    ranker, _, progress = load_checkpoint(out_dir)
    facts = {
        "settings": settings.name,
        "shipped": is_shipped,
        "best_epoch": progress.best_epoch,
        "selected_by": progress.selected_by,
        "parameters": sum(parameter.numel() for parameter in ranker.parameters()),
        "history": list(progress.history),
    }
    return [path for path in out_dir.iterdir() if path.is_file() and not path.name.startswith(".")], facts


def _ranker_products(benchmark: Benchmark, partition: str) -> tuple[FilesProduct]:
    """A checkpoint and what decides a training: its identity but for the manifest, which also names what no training reads."""
    key = parse_ranker_key(partition)
    settings = settings_of(key)
    identity = identity_of(benchmark.root.release(key.tier), key.variant, key.seed, settings)
    made_from = {
        "code": MODEL_CODE_VERSION,
        "contract": contract_hash(),
        "variant": key.variant.value,
        "seed": str(key.seed),
        "settings": json.dumps(settings_to_dict(settings), sort_keys=True),
        "release.tables": identity.release_sha256,
        "engine.torch": metadata.version("torch"),
    }
    return (FilesProduct(_checkpoint(benchmark, key) / "made_from.json", made_from),)


@multi_asset(
    name="score_candidates",
    specs=[
        AssetSpec(
            "predictions",
            deps=[AssetDep("ranker", partition_mapping=rankers_to_tiers), "release"],
            description=f"Scores every candidate of a tier with every trained ranker. Rows: {PREDICTIONS.meaning}.",
            group_name="ranker",
            code_version=SCORING_CODE_VERSION,
            kinds={"parquet"},
        ),
        AssetSpec(
            "decision_times",
            deps=[AssetDep("ranker", partition_mapping=rankers_to_tiers), "release"],
            description="Times how long a ranker of each kind takes to order each group of the first scenes of the test split.",
            group_name="ranker",
            code_version=SCORING_CODE_VERSION,
            kinds={"parquet"},
        ),
    ],
    check_specs=[schema_check_spec(PREDICTIONS), schema_check_spec(TIMINGS, "decision_times")],
    partitions_def=tier_partitions,
)
def predictions(context: AssetExecutionContext, benchmark: Benchmark) -> Iterator[MaterializeResult[None] | AssetCheckResult]:
    tier = context.partition_key
    release_dir = benchmark.root.release(tier)
    scores, times = _predictions_products(benchmark, tier)
    checkpoints = [_checkpoint(benchmark, key) for key in rankers_of_tier(tier)]
    yield from scores.publish(lambda: join_tables(PREDICTIONS, [score(release_dir, checkpoint) for checkpoint in checkpoints]))
    yield from times.publish(
        lambda: table_from_rows(
            TIMINGS,
            [
                row
                for key in _timed_rankers(tier)
                for row in ranker_timing_rows(decision_times(release_dir, _checkpoint(benchmark, key)), key.variant.value)
            ],
        )
    )
    yield from _predictions_checks(benchmark, tier)


def _predictions_products(benchmark: Benchmark, tier: str) -> tuple[TableProduct, TableProduct]:
    weights = {key: {f"ranker.{key.variant.value}.{key.seed}": _weights_sha256(benchmark, key)} for key in rankers_of_tier(tier)}
    made_from = {"code": SCORING_CODE_VERSION, "contract": contract_hash(), **release_hashes(benchmark, tier)}
    timed = {name: sha256 for key in _timed_rankers(tier) for name, sha256 in weights[key].items()} | {MACHINE: timing_machine()}
    all_weights = {name: sha256 for own in weights.values() for name, sha256 in own.items()}
    return (
        TableProduct(PREDICTIONS, benchmark.root.tier_table(tier, "predictions"), made_from | all_weights, tier),
        TableProduct(TIMINGS, benchmark.root.tier_table(tier, "decision_times"), made_from | timed, tier, "decision_times"),
    )


def _predictions_checks(benchmark: Benchmark, tier: str) -> Iterator[AssetCheckResult]:
    yield schema_check(PREDICTIONS, benchmark.root.tier_table(tier, "predictions"))
    yield schema_check(TIMINGS, benchmark.root.tier_table(tier, "decision_times"), "decision_times")


def _timed_rankers(tier: str) -> list[RankerKey]:
    """The first training of each kind of network that is a policy."""
    first: dict[Variant, RankerKey] = {}
    for key in rankers_of_tier(tier):
        if key.variant.value in _TIMED:
            first.setdefault(key.variant, key)
    return list(first.values())


def _checkpoint(benchmark: Benchmark, key: RankerKey) -> Path:
    return benchmark.root.checkpoint(key.tier, key.variant.value, key.seed)


def _weights_sha256(benchmark: Benchmark, key: RankerKey) -> str:
    """Identity of a trained ranker; raises StoreError where it is not trained."""
    weights = sorted(_checkpoint(benchmark, key).glob("ranker.safetensors"))
    if not weights:
        raise StoreError(f"{_checkpoint(benchmark, key)}: no trained ranker; materialize ranker, partition {key}")
    return file_sha256(weights[0])


ranker_assets = [ranker, predictions]
ranker_step = Step("ranker", ranker, _ranker_products, _ranker_checks)
predictions_step = Step("predictions and decision times", predictions, _predictions_products, _predictions_checks)
