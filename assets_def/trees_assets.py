"""The trees probe of a tier: derived geometry of every candidate and what trees on it say; the work is model's, the report reports'."""

from collections.abc import Iterator, Sequence
from functools import cache
from importlib import metadata

from dagster import AssetCheckResult, AssetExecutionContext, AssetSpec, MaterializeResult, multi_asset

from assets_def.checks import schema_check, schema_check_spec
from assets_def.inputs import release_hashes, source_version
from assets_def.partitions import tier_partitions
from assets_def.products import TableProduct
from assets_def.resources import Benchmark
from assets_def.steps import Step
from model.decision_times import machine_name
from model.features import CANDIDATE_GEOMETRY
from model.geometry import geometry_table
from model.inputs import contract_hash
from model.tree_times import tree_decision_times
from model.trees import TreeData, Trees, TreeVariant, predicted, read_tree_data, split_trees
from reports.ranking import MACHINE, ranker_timing_rows
from tables.schemas import PREDICTIONS, TIMINGS
from tables.store import join_tables, table_from_rows

_MODULES = ("distances", "features", "geometry", "hand", "inputs", "predictions", "trees")
# Minutes at most: any change of geometry or trees makes both tables anew.
TREES_CODE_VERSION = source_version(*(f"model/{name}.py" for name in _MODULES))
TREES_SEED = 42
# Trees on derived geometry stand beside networks of three seeds; raw poses are a probe of the paper's split.
TRAININGS = (*((TreeVariant.GEOMETRY, seed) for seed in (TREES_SEED, 43, 44)), (TreeVariant.POSES, TREES_SEED))
TREE_PREDICTIONS = "tree_predictions"
TREE_TIMES = "tree_decision_times"


@multi_asset(
    name="train_trees",
    specs=[
        AssetSpec(
            CANDIDATE_GEOMETRY.name,
            deps=["release"],
            description=f"Derives geometry from the five inputs of every candidate. Rows: {CANDIDATE_GEOMETRY.meaning}.",
            group_name="ranker",
            code_version=TREES_CODE_VERSION,
            kinds={"parquet"},
        ),
        AssetSpec(
            TREE_PREDICTIONS,
            deps=["release"],
            description="Scores every candidate with gradient-boosted trees on that geometry, and on raw poses, of the train split alone.",
            group_name="ranker",
            code_version=TREES_CODE_VERSION,
            kinds={"parquet", "scikitlearn"},
        ),
        AssetSpec(
            TREE_TIMES,
            deps=["release"],
            description="Times how long the trees on derived geometry take to order each group of the first scenes of the test split.",
            group_name="ranker",
            code_version=TREES_CODE_VERSION,
            kinds={"parquet", "scikitlearn"},
        ),
    ],
    check_specs=[
        schema_check_spec(CANDIDATE_GEOMETRY),
        schema_check_spec(PREDICTIONS, TREE_PREDICTIONS),
        schema_check_spec(TIMINGS, TREE_TIMES),
    ],
    partitions_def=tier_partitions,
)
def trees(context: AssetExecutionContext, benchmark: Benchmark) -> Iterator[MaterializeResult[None] | AssetCheckResult]:
    tier = context.partition_key
    release_dir = benchmark.root.release(tier)

    @cache
    def data() -> TreeData:
        return read_tree_data(release_dir)

    @cache
    def fitted(variant: TreeVariant, seed: int) -> Trees:
        return split_trees(release_dir, data(), variant, seed)

    geometry, scores, times = _trees_products(benchmark, tier)
    yield from geometry.publish(lambda: geometry_table(data().inputs, data().geometry))
    yield from scores.publish(lambda: join_tables(PREDICTIONS, [predicted(fitted(*each), data(), each[1]) for each in TRAININGS]))
    timed, seed = TRAININGS[0]
    yield from times.publish(
        lambda: table_from_rows(TIMINGS, ranker_timing_rows(tree_decision_times(release_dir, fitted(timed, seed)), timed.value))
    )
    yield from _trees_checks(benchmark, tier)


def made_from_trainings(trainings: Sequence[tuple[TreeVariant, int]]) -> dict[str, str]:
    """What a record says of trees: `trees.42 trees.43`."""
    names = " ".join(f"{variant.value}.{seed}" for variant, seed in trainings)
    return {"trainings": names, "engine.scikit-learn": metadata.version("scikit-learn")}


def _trees_products(benchmark: Benchmark, tier: str) -> tuple[TableProduct, TableProduct, TableProduct]:
    made_from = {"code": TREES_CODE_VERSION, "contract": contract_hash(), **release_hashes(benchmark, tier)}
    trained = made_from_trainings(TRAININGS)
    paths = [benchmark.root.tier_table(tier, name) for name in (CANDIDATE_GEOMETRY.name, TREE_PREDICTIONS, TREE_TIMES)]
    return (
        TableProduct(CANDIDATE_GEOMETRY, paths[0], made_from, tier),
        TableProduct(PREDICTIONS, paths[1], made_from | trained, tier, TREE_PREDICTIONS),
        TableProduct(TIMINGS, paths[2], made_from | trained | {MACHINE: machine_name()}, tier, TREE_TIMES),
    )


def _trees_checks(benchmark: Benchmark, tier: str) -> Iterator[AssetCheckResult]:
    yield schema_check(CANDIDATE_GEOMETRY, benchmark.root.tier_table(tier, CANDIDATE_GEOMETRY.name))
    yield schema_check(PREDICTIONS, benchmark.root.tier_table(tier, TREE_PREDICTIONS), TREE_PREDICTIONS)
    yield schema_check(TIMINGS, benchmark.root.tier_table(tier, TREE_TIMES), TREE_TIMES)


trees_assets = [trees]
trees_step = Step("candidate geometry and trees", trees, _trees_products, _trees_checks)
