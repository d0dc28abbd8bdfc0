"""Reports of a tier: repeat executions, S_K, ablation, repeatability, dataset profile and gallery; the work is reports'."""

from collections.abc import Callable, Iterator, Sequence

from dagster import (
    AssetCheckResult,
    AssetDep,
    AssetExecutionContext,
    AssetsDefinition,
    AssetSpec,
    MaterializeResult,
    MetadataValue,
    asset,
    multi_asset,
)

from assets_def.checks import schema_check_spec
from assets_def.metadata import inline_figure
from assets_def.partitions import tier_partitions
from assets_def.resources import Benchmark
from assets_def.tier_tables import publish_tier_table
from pipelines.decoded import Decoded
from pipelines.proofs.audits import audit_items, audit_rows, choose_audited
from pipelines.proofs.repeats import Repeat, attempt_rows, choose_perturbed
from pipelines.recipe import Recipe
from reports.ablation import ablation_report
from reports.audit import audit_report
from reports.gallery import gallery_report
from reports.load import load_release
from reports.profile import profile_report
from reports.repeatability import choose_tasks, repeatability_report
from reports.report import Report
from reports.success_at_k import success_at_k_report
from tables.schemas import ATTEMPTS, AUDITS, OBJECT_TABLES, PREDICTIONS, TIMINGS
from tables.store import read_table, table_from_rows
from tables.vocabulary import Perturbation

REPORT_CODE_VERSION = "1"
# Executed candidates repeated under each perturbation, and filmstrips an execution status.
N_PERTURBED = {"mini": 24, "pilot": 300, "full": 900}
# Solved paths rechecked, and rejections judged again for each reason.
N_AUDITED = {"mini": (20, 3), "pilot": (500, 50), "full": (1000, 100)}
N_FILMS = {"mini": 1, "pilot": 3, "full": 3}
# What candidates are decoded from, with their labels and plans.
_VALUE_TABLES = (*OBJECT_TABLES, "scenes", "obstacles", "targets", "grasps", "candidates", "plans")


@multi_asset(
    name="repeat_executions",
    specs=[
        AssetSpec(
            "attempts",
            deps=["release"],
            description="Plans and executes chosen candidates again, each in a fresh process: tasks chosen by hash before any outcome is"
            f" read, and executed candidates under changes that ought not to matter. Rows: {ATTEMPTS.meaning}.",
            group_name="reports",
            code_version=REPORT_CODE_VERSION,
            kinds={"parquet"},
        )
    ],
    check_specs=[schema_check_spec(ATTEMPTS)],
    partitions_def=tier_partitions,
)
def attempts(context: AssetExecutionContext, benchmark: Benchmark) -> Iterator[MaterializeResult | AssetCheckResult]:
    tier = context.partition_key
    tables = load_release(benchmark.root.release(tier), _VALUE_TABLES)
    recipe = benchmark.recipe_of_tier(tier)
    blind = tables["candidates"].select(["candidate_id", "scene_id", "target_id"])
    chosen = [
        *((task.candidate_id, Perturbation.FRESH, k) for task in choose_tasks(blind, recipe.seed) for k in range(task.n_repeats)),
        *((name, kind, 0) for name, kind in choose_perturbed(tables["candidates"], recipe.seed, N_PERTURBED[tier])),
    ]
    rows = list(attempt_rows(_repeats(Decoded(tables), recipe, chosen), benchmark.n_workers))
    yield from publish_tier_table(benchmark, tier, ATTEMPTS, table_from_rows(ATTEMPTS, rows))


def _repeats(release: Decoded, recipe: Recipe, chosen: Sequence[tuple[str, Perturbation, int]]) -> list[Repeat]:
    repeats = []
    for name, kind, number in chosen:
        candidate = release.candidate(name)
        repeats.append(Repeat(recipe, release.object_model_of(candidate), candidate, release.labels(name), kind, number))
    return repeats


@multi_asset(
    name="audit_labels",
    specs=[
        AssetSpec(
            "audits",
            deps=["release"],
            description="Checks planning labels by other means: solved paths in a second collision engine, spent budgets with ten times"
            f" as much, rejections by a finer, independent judge. Rows: {AUDITS.meaning}.",
            group_name="reports",
            code_version=REPORT_CODE_VERSION,
            kinds={"parquet"},
        )
    ],
    check_specs=[schema_check_spec(AUDITS)],
    partitions_def=tier_partitions,
)
def audits(context: AssetExecutionContext, benchmark: Benchmark) -> Iterator[MaterializeResult | AssetCheckResult]:
    tier = context.partition_key
    tables = load_release(benchmark.root.release(tier), _VALUE_TABLES)
    recipe = benchmark.recipe_of_tier(tier)
    chosen = choose_audited(tables["candidates"], recipe.seed, *N_AUDITED[tier])
    rows = list(audit_rows(audit_items(chosen, Decoded(tables), recipe), benchmark.n_workers))
    yield from publish_tier_table(benchmark, tier, AUDITS, table_from_rows(AUDITS, rows))


def _success_at_k(benchmark: Benchmark, tier: str) -> Report:
    predictions = read_table(PREDICTIONS, benchmark.root.tier_table(tier, "predictions"))
    times = read_table(TIMINGS, benchmark.root.tier_table(tier, "decision_times"))
    tables = load_release(benchmark.root.release(tier))
    return success_at_k_report(tables, predictions, times, tier=tier, seed=benchmark.recipe_of_tier(tier).seed)


def _ablation(benchmark: Benchmark, tier: str) -> Report:
    predictions = read_table(PREDICTIONS, benchmark.root.tier_table(tier, "predictions"))
    return ablation_report(load_release(benchmark.root.release(tier)), predictions, tier=tier, seed=benchmark.recipe_of_tier(tier).seed)


def _repeatability(benchmark: Benchmark, tier: str) -> Report:
    repeated = read_table(ATTEMPTS, benchmark.root.tier_table(tier, "attempts"))
    return repeatability_report(repeated, load_release(benchmark.root.release(tier), ["candidates"])["candidates"], tier=tier)


def _audit(benchmark: Benchmark, tier: str) -> Report:
    audited = read_table(AUDITS, benchmark.root.tier_table(tier, "audits"))
    return audit_report(audited, load_release(benchmark.root.release(tier), ["candidates"])["candidates"], tier=tier)


def _profile(benchmark: Benchmark, tier: str) -> Report:
    return profile_report(load_release(benchmark.root.release(tier)), tier=tier, seed=benchmark.recipe_of_tier(tier).seed)


def _gallery(benchmark: Benchmark, tier: str) -> Report:
    tables = load_release(benchmark.root.release(tier), _VALUE_TABLES)
    return gallery_report(tables, benchmark.recipe_of_tier(tier), tier=tier, n_films=N_FILMS[tier])


def _report_asset(name: str, deps: Sequence[str], description: str, make: Callable[[Benchmark, str], Report]) -> AssetsDefinition:
    @asset(
        name=f"{name}_report",
        deps=[AssetDep(dep) for dep in deps],
        description=description,
        group_name="reports",
        code_version=REPORT_CODE_VERSION,
        partitions_def=tier_partitions,
        kinds={"markdown"},
    )
    def report(context: AssetExecutionContext, benchmark: Benchmark) -> MaterializeResult:
        tier = context.partition_key
        made = make(benchmark, tier)
        path = made.write(benchmark.report_dir(tier))
        figures = {f"figure {stem}": inline_figure(png) for stem, png in made.figures.items()}
        report_text = MetadataValue.md(made.markdown)
        metrics = {name: float(value) for name, value in made.metrics.items()}
        return MaterializeResult(metadata={"path": MetadataValue.path(str(path)), "report": report_text, **metrics, **figures})

    return report


success_at_k = _report_asset(
    "success_at_k", ["release", "predictions", "decision_times"], "S_K of six policies on both tasks, the paper beside ours.", _success_at_k
)
ablation = _report_asset("ablation", ["release", "predictions"], "The ranker and three ablations on the validation split.", _ablation)
repeatability = _report_asset("repeatability", ["release", "attempts"], "How often a label comes out the same again.", _repeatability)
audit = _report_asset("audit", ["release", "audits"], "What the audits of the planning labels found.", _audit)
profile = _report_asset("profile", ["release"], "Counts, statuses, coverage and the ladder of policies that learn nothing.", _profile)
gallery = _report_asset("gallery", ["release"], "Contact sheets: scenes, grasps, filmstrips of every outcome.", _gallery)

report_assets = [attempts, audits, profile, gallery, repeatability, audit, success_at_k, ablation]


def report_assets_of(until: str) -> list[AssetsDefinition]:
    """The report assets that need no ranker, or all."""
    return report_assets if until == "reports" else [attempts, audits, profile, gallery, repeatability, audit]
