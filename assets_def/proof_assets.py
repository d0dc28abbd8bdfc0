"""Labels made again and judged again: repeat executions and audits of a release; the work is in pipelines/proofs."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
from dagster import AssetCheckResult, AssetExecutionContext, AssetsDefinition, AssetSpec, MaterializeResult, multi_asset

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
from splits.replicates import checked_recipe, execute_replicates, kept_beside, replicates_made_from
from tables.columns import TableSchema
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


@dataclass(frozen=True, slots=True)
class Proof:
    """Labels of a release made or judged again: a table about it, which is an asset.

    Attributes:
        name: of what Dagster materializes.
        description: what it does.
        made_from: what decides its rows, for the record of the table.
        make: its rows, told how far it is.
        kept: the file of finished work that `make` leaves beside the table, until that is published.
    """

    schema: TableSchema
    name: str
    description: str
    code_version: str
    made_from: Callable[[Benchmark, str], dict[str, str]]
    make: Callable[[Benchmark, str, Callable[[str], Any]], pa.Table]
    kept: Callable[[Path], Path] | None = None

    def product(self, benchmark: Benchmark, tier: str) -> TableProduct:
        path = benchmark.root.tier_table(tier, self.schema.name)
        return TableProduct(self.schema, path, self.made_from(benchmark, tier), tier)

    def checks(self, benchmark: Benchmark, tier: str) -> Iterator[AssetCheckResult]:
        yield schema_check(self.schema, benchmark.root.tier_table(tier, self.schema.name))


def _asset_of(proof: Proof) -> AssetsDefinition:
    spec = AssetSpec(
        proof.schema.name,
        deps=["release"],
        description=f"{proof.description} Rows: {proof.schema.meaning}.",
        group_name="reports",
        code_version=proof.code_version,
        kinds={"parquet"},
    )

    @multi_asset(name=proof.name, specs=[spec], check_specs=[schema_check_spec(proof.schema)], partitions_def=tier_partitions)
    def made(context: AssetExecutionContext, benchmark: Benchmark) -> Iterator[MaterializeResult[None] | AssetCheckResult]:
        tier = context.partition_key
        product = proof.product(benchmark, tier)
        yield from product.publish(lambda: proof.make(benchmark, tier, context.log.info))
        if proof.kept is not None:
            proof.kept(product.path).unlink(missing_ok=True)
        yield from proof.checks(benchmark, tier)

    return made


def _step_of(proof: Proof, name: str) -> Step:
    return Step(name, _asset_of(proof), lambda benchmark, tier: [proof.product(benchmark, tier)], proof.checks)


def _repeat(benchmark: Benchmark, tier: str, log: Callable[[str], Any]) -> pa.Table:
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


def _repeat_made_from(benchmark: Benchmark, tier: str) -> dict[str, str]:
    chosen = {"perturbed": N_PERTURBED[tier], "tasks_repeated": N_TASKS_REPEATED, "repeats": N_REPEATS}
    return {**_made_from(benchmark, tier, chosen), **tier_hashes(benchmark, tier, ["candidates"])}


def _audit(benchmark: Benchmark, tier: str, log: Callable[[str], Any]) -> pa.Table:
    release = Release.open(benchmark.root.release(tier))
    recipe = benchmark.recipe_of_tier(tier)
    chosen = choose_audited(release.table("candidates"), recipe.seed, *N_AUDITED[tier])
    return table_from_rows(AUDITS, audit_rows(audit_items(chosen, release.values, recipe), benchmark.n_workers))


def _audit_made_from(benchmark: Benchmark, tier: str) -> dict[str, str]:
    n_plans, n_per_reason = N_AUDITED[tier]
    parameters = {"plans": n_plans, "per_reason": n_per_reason, "budget": N_BUDGET, **asdict(AuditParams())}
    return _made_from(benchmark, tier, parameters)


def _replicate(benchmark: Benchmark, tier: str, log: Callable[[str], Any]) -> pa.Table:
    release, kept = Release.open(benchmark.root.release(tier)), kept_beside(benchmark.root.tier_table(tier, TEST_REPLICATES.name))
    recipe = checked_recipe(release.manifest, benchmark.recipe_file)
    return execute_replicates(release, recipe, kept, None, benchmark.n_workers, N_REPLICATED[tier], log)


def _replicate_made_from(benchmark: Benchmark, tier: str) -> dict[str, str]:
    manifest = read_manifest(benchmark.root.release(tier))
    return replicates_made_from(manifest, benchmark.recipe_of_tier(tier), N_REPLICATED[tier])


def _made_from(benchmark: Benchmark, tier: str, parameters: Mapping[str, float]) -> dict[str, str]:
    return {
        "code": PROOF_CODE_VERSION,
        "recipe": benchmark.recipe_of_tier(tier).hash_of(),
        **stage_versions((STAGE["planning_labels"], STAGE["execution_labels"])),
        **release_hashes(benchmark, tier),
        **{f"parameter.{name}": str(value) for name, value in parameters.items()},
    }


attempts_step = _step_of(
    Proof(
        ATTEMPTS,
        "repeat_executions",
        "Plans and executes chosen candidates again, each in a fresh process: tasks chosen by hash before any outcome is read, and executed"
        " candidates under changes that ought not to matter.",
        PROOF_CODE_VERSION,
        _repeat_made_from,
        _repeat,
    ),
    "attempts",
)
audits_step = _step_of(
    Proof(
        AUDITS,
        "audit_labels",
        "Checks planning labels by other means: solved paths in a second collision engine, spent budgets with ten times as much, rejections"
        " by a finer, independent judge.",
        PROOF_CODE_VERSION,
        _audit_made_from,
        _audit,
    ),
    "audits",
)
replicates_step = _step_of(
    Proof(
        TEST_REPLICATES,
        "replicate_executions",
        "Executes every planned candidate of the test split again under small real uncertainty, for the ceiling report.",
        REPLICATE_CODE_VERSION,
        _replicate_made_from,
        _replicate,
        kept_beside,
    ),
    "replicates of the test split",
)
proof_steps = (attempts_step, audits_step, replicates_step)
proof_assets = [step.asset for step in proof_steps]
