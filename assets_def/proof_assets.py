"""Labels made again and judged again: repeat executions and audits of a release; the work is in pipelines/proofs."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict

import pyarrow as pa
from dagster import AssetCheckResult, AssetExecutionContext, AssetSpec, MaterializeResult, multi_asset

from assets_def.checks import schema_check, schema_check_spec
from assets_def.inputs import release_hashes, stage_versions, tier_hashes
from assets_def.partitions import tier_partitions
from assets_def.products import TableProduct
from assets_def.resources import Benchmark
from assets_def.steps import Step
from pipelines.proofs.audit.params import AuditParams
from pipelines.proofs.audits import N_BUDGET, audit_items, audit_rows, choose_audited
from pipelines.proofs.repeats import Repeat, attempt_rows, choose_perturbed
from pipelines.proofs.replicates import CODE_VERSION as REPLICATE_CODE_VERSION
from pipelines.proofs.replicates import N_REPLICATES
from pipelines.recipe import Recipe
from pipelines.stages import STAGE
from reports.repeatability import N_REPEATS, N_TASKS_REPEATED, choose_tasks
from splits.manifest import read_manifest
from splits.release_reader import Release
from splits.replicates import execute_replicates, kept_beside, replicates_made_from
from tables.schemas import ATTEMPTS, AUDITS, OBJECT_TABLES, TEST_REPLICATES
from tables.store import table_from_rows
from tables.vocabulary import Perturbation

# Changes whenever rows may: how candidates are chosen, repeated or audited.
PROOF_CODE_VERSION = "1"
# Executed candidates repeated under each perturbation.
N_PERTURBED = {"mini": 24, "pilot": 300, "full": 500}  # 501 of full: as many of each category
# Executions of each planned candidate of the test split under small real uncertainty.
N_REPLICATED = {"mini": 2, "pilot": N_REPLICATES, "full": N_REPLICATES}
# Solved paths rechecked, and rejections judged again for each reason.
N_AUDITED = {"mini": (20, 3), "pilot": (500, 50), "full": (500, 50)}
# What candidates are decoded from, with their labels and plans.
VALUE_TABLES = (*OBJECT_TABLES, "scenes", "obstacles", "targets", "grasps", "candidates", "plans")


@multi_asset(
    name="repeat_executions",
    specs=[
        AssetSpec(
            "attempts",
            deps=["release"],
            description="Plans and executes chosen candidates again, each in a fresh process: tasks chosen by hash before any outcome is"
            f" read, and executed candidates under changes that ought not to matter. Rows: {ATTEMPTS.meaning}.",
            group_name="reports",
            code_version=PROOF_CODE_VERSION,
            kinds={"parquet"},
        )
    ],
    check_specs=[schema_check_spec(ATTEMPTS)],
    partitions_def=tier_partitions,
)
def attempts(context: AssetExecutionContext, benchmark: Benchmark) -> Iterator[MaterializeResult[None] | AssetCheckResult]:
    tier = context.partition_key
    (product,) = _attempts_products(benchmark, tier)
    yield from product.publish(lambda: _repeat(benchmark, tier))
    yield from _attempts_checks(benchmark, tier)


def _repeat(benchmark: Benchmark, tier: str) -> pa.Table:
    release = Release.open(benchmark.root.release(tier))
    recipe, candidates = benchmark.recipe_of_tier(tier), release.table("candidates")
    blind = candidates.select(["candidate_id", "scene_id", "target_id"])
    chosen = [
        *((task.candidate_id, Perturbation.FRESH, k) for task in choose_tasks(blind, recipe.seed) for k in range(task.n_repeats)),
        *((name, kind, 0) for name, kind in choose_perturbed(candidates, recipe.seed, N_PERTURBED[tier])),
    ]
    return table_from_rows(ATTEMPTS, attempt_rows(_repeats(release, recipe, chosen), benchmark.n_workers))


def _repeats(release: Release, recipe: Recipe, chosen: Sequence[tuple[str, Perturbation, int]]) -> list[Repeat]:
    repeats = []
    for name, kind, number in chosen:
        candidate = release.candidate(name)
        repeats.append(Repeat(recipe, release.values.object_model_of(candidate), candidate, release.values.labels(name), kind, number))
    return repeats


def _attempts_products(benchmark: Benchmark, tier: str) -> tuple[TableProduct]:
    chosen = {"perturbed": N_PERTURBED[tier], "tasks_repeated": N_TASKS_REPEATED, "repeats": N_REPEATS}
    made_from = {**_made_from(benchmark, tier, chosen), **tier_hashes(benchmark, tier, ["candidates"])}
    return (TableProduct(ATTEMPTS, benchmark.root.tier_table(tier, "attempts"), made_from, tier),)


def _attempts_checks(benchmark: Benchmark, tier: str) -> Iterator[AssetCheckResult]:
    yield schema_check(ATTEMPTS, benchmark.root.tier_table(tier, "attempts"))


@multi_asset(
    name="audit_labels",
    specs=[
        AssetSpec(
            "audits",
            deps=["release"],
            description="Checks planning labels by other means: solved paths in a second collision engine, spent budgets with ten times"
            f" as much, rejections by a finer, independent judge. Rows: {AUDITS.meaning}.",
            group_name="reports",
            code_version=PROOF_CODE_VERSION,
            kinds={"parquet"},
        )
    ],
    check_specs=[schema_check_spec(AUDITS)],
    partitions_def=tier_partitions,
)
def audits(context: AssetExecutionContext, benchmark: Benchmark) -> Iterator[MaterializeResult[None] | AssetCheckResult]:
    tier = context.partition_key
    (product,) = _audits_products(benchmark, tier)
    yield from product.publish(lambda: _audit(benchmark, tier))
    yield from _audits_checks(benchmark, tier)


def _audit(benchmark: Benchmark, tier: str) -> pa.Table:
    release = Release.open(benchmark.root.release(tier))
    recipe = benchmark.recipe_of_tier(tier)
    chosen = choose_audited(release.table("candidates"), recipe.seed, *N_AUDITED[tier])
    return table_from_rows(AUDITS, audit_rows(audit_items(chosen, release.values, recipe), benchmark.n_workers))


def _audits_products(benchmark: Benchmark, tier: str) -> tuple[TableProduct]:
    n_plans, n_per_reason = N_AUDITED[tier]
    parameters = {"plans": n_plans, "per_reason": n_per_reason, "budget": N_BUDGET, **asdict(AuditParams())}
    return (TableProduct(AUDITS, benchmark.root.tier_table(tier, "audits"), _made_from(benchmark, tier, parameters), tier),)


def _audits_checks(benchmark: Benchmark, tier: str) -> Iterator[AssetCheckResult]:
    yield schema_check(AUDITS, benchmark.root.tier_table(tier, "audits"))


@multi_asset(
    name="replicate_executions",
    specs=[
        AssetSpec(
            TEST_REPLICATES.name,
            deps=["release"],
            description="Executes every planned candidate of the test split again under small real uncertainty, for the ceiling report."
            f" Rows: {TEST_REPLICATES.meaning}.",
            group_name="reports",
            code_version=REPLICATE_CODE_VERSION,
            kinds={"parquet"},
        )
    ],
    check_specs=[schema_check_spec(TEST_REPLICATES)],
    partitions_def=tier_partitions,
)
def test_replicates(context: AssetExecutionContext, benchmark: Benchmark) -> Iterator[MaterializeResult[None] | AssetCheckResult]:
    tier = context.partition_key
    (product,) = _replicates_products(benchmark, tier)
    kept = kept_beside(product.path)

    def execute() -> pa.Table:
        release = Release.open(benchmark.root.release(tier))
        return execute_replicates(release, kept, None, benchmark.n_workers, N_REPLICATED[tier], benchmark.recipe_file, context.log.info)

    yield from product.publish(execute)
    kept.unlink(missing_ok=True)
    yield from _replicates_checks(benchmark, tier)


def _replicates_products(benchmark: Benchmark, tier: str) -> tuple[TableProduct]:
    manifest = read_manifest(benchmark.root.release(tier))
    made_from = replicates_made_from(manifest, benchmark.recipe_of_tier(tier), N_REPLICATED[tier])
    return (TableProduct(TEST_REPLICATES, benchmark.root.tier_table(tier, TEST_REPLICATES.name), made_from, tier),)


def _replicates_checks(benchmark: Benchmark, tier: str) -> Iterator[AssetCheckResult]:
    yield schema_check(TEST_REPLICATES, benchmark.root.tier_table(tier, TEST_REPLICATES.name))


def _made_from(benchmark: Benchmark, tier: str, parameters: Mapping[str, float]) -> dict[str, str]:
    return {
        "code": PROOF_CODE_VERSION,
        "recipe": benchmark.recipe_of_tier(tier).hash_of(),
        **stage_versions((STAGE["planning_labels"], STAGE["execution_labels"])),
        **release_hashes(benchmark, tier),
        **{f"parameter.{name}": str(value) for name, value in parameters.items()},
    }


proof_assets = [attempts, audits, test_replicates]
attempts_step = Step("attempts", attempts, _attempts_products, _attempts_checks)
audits_step = Step("audits", audits, _audits_products, _audits_checks)
replicates_step = Step("replicates of the test split", test_replicates, _replicates_products, _replicates_checks)
proof_steps = (attempts_step, audits_step, replicates_step)
