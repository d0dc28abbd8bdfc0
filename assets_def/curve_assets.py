"""The learning curve of a tier: rankers of some of its training scenes, and what they say of its validation split."""

from collections.abc import Iterator

from dagster import AssetCheckResult, AssetDep, AssetExecutionContext, AssetSpec, MaterializeResult, multi_asset

from assets_def.checks import schema_check, schema_check_spec
from assets_def.inputs import release_hashes
from assets_def.learning_curve import SizedRanker, curve_keys, curve_of, curve_table, made_from
from assets_def.partitions import rankers_to_tiers, tier_partitions
from assets_def.products import TableProduct
from assets_def.ranker_assets import SCORING_CODE_VERSION
from assets_def.rankers import Place
from assets_def.resources import Benchmark
from assets_def.steps import Step
from tables.schemas import LEARNING_CURVE
from tables.vocabulary import SplitScheme


@multi_asset(
    name="train_curve",
    specs=[
        AssetSpec(
            LEARNING_CURVE.name,
            deps=[AssetDep("ranker", partition_mapping=rankers_to_tiers), "release"],
            description=f"Trains rankers on some of the training scenes. Rows: {LEARNING_CURVE.meaning}.",
            group_name="ranker",
            code_version=SCORING_CODE_VERSION,
            kinds={"parquet", "pytorch"},
        )
    ],
    check_specs=[schema_check_spec(LEARNING_CURVE)],
    partitions_def=tier_partitions,
)
def learning_curve(context: AssetExecutionContext, benchmark: Benchmark) -> Iterator[MaterializeResult[None] | AssetCheckResult]:
    tier = context.partition_key
    (product,) = _products(benchmark, tier)
    yield from product.publish(lambda: curve_table(_curve(benchmark, tier), benchmark.n_workers, context.log.info, tells_epochs=False))
    yield from _checks(benchmark, tier)


def _curve(benchmark: Benchmark, tier: str) -> list[SizedRanker]:
    return curve_of(Place.of(benchmark, tier, SplitScheme.SCENE), curve_keys(tier))


def _products(benchmark: Benchmark, tier: str) -> tuple[TableProduct]:
    release_hashes(benchmark, tier)  # the release is there, or it is named
    path = benchmark.root.tier_table(tier, LEARNING_CURVE.name)
    return (TableProduct(LEARNING_CURVE, path, made_from(_curve(benchmark, tier)), tier),)


def _checks(benchmark: Benchmark, tier: str) -> Iterator[AssetCheckResult]:
    yield schema_check(LEARNING_CURVE, benchmark.root.tier_table(tier, LEARNING_CURVE.name))


curve_assets = [learning_curve]
curve_step = Step("learning curve", learning_curve, _products, _checks)
