"""Which planning labels are audited, and a row for each; see audit/ for how a path or a rejection is judged.

See reports/audit.py for what the rows mean, and repeats.py for physics under perturbations.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import groupby

import pyarrow as pa

from objects.object_model import ObjectModel
from pipelines.codecs import Row
from pipelines.decoded import Decoded
from pipelines.engines.planning.collision import CollisionModel
from pipelines.labels.planning import judge_candidate, motion_of
from pipelines.proofs.audit.bullet_scene import BulletScene
from pipelines.proofs.audit.errors import AuditError
from pipelines.proofs.audit.params import AuditParams
from pipelines.proofs.audit.paths import recheck_path
from pipelines.proofs.audit.rejections import rejudge
from pipelines.recipe import Recipe
from pipelines.running.workers import run_units
from pipelines.values import Candidate, Plan
from tables.identity import order_key
from tables.vocabulary import Audit, PlanStatus

N_BUDGET = 300  # ten times the budget is up to ten core-seconds a candidate
_ITEMS_A_UNIT = 8  # they share a scene and its engine; small enough that two workers end together


@dataclass(frozen=True, slots=True)
class AuditItem:
    """One audit of one candidate; the plan exists where a path is rechecked."""

    recipe: Recipe
    object_model: ObjectModel
    candidate: Candidate
    stored_status: PlanStatus
    plan: Plan | None
    audit: Audit

    @property
    def candidate_id(self) -> str:
        return self.candidate.candidate_id


def choose_audited(candidates: pa.Table, seed: int, n_plans: int, n_per_reason: int) -> list[tuple[str, Audit]]:
    """Candidates to audit, and how: of every status those that hash lowest, as far as there are enough.

    Solved ones have their paths rechecked, those that spent their budget get ten times as much, all others are judged again.

    Args:
        candidates: columns `candidate_id` and `plan_status` of table `candidates`.
        seed: the recipe seed.
        n_plans: paths to recheck.
        n_per_reason: candidates of every other reason; of spent budgets `N_BUDGET`.
    """
    by_status: dict[PlanStatus, list[str]] = {status: [] for status in PlanStatus}
    for row in candidates.select(["candidate_id", "plan_status"]).to_pylist():
        by_status[PlanStatus(row["plan_status"])].append(row["candidate_id"])
    chosen = []
    for status, names in by_status.items():
        audit, n = {
            PlanStatus.SOLVED: (Audit.PATH_GEOMETRY, n_plans),
            PlanStatus.BUDGET_SPENT: (Audit.SEARCH_BUDGET, N_BUDGET),
        }.get(status, (Audit.REJECTION, n_per_reason))
        chosen += [(name, audit) for name in sorted(names, key=lambda name: order_key(seed, "audited", name))[:n]]
    return sorted(chosen)


def audit_items(chosen: Sequence[tuple[str, Audit]], release: Decoded, recipe: Recipe) -> list[AuditItem]:
    """Everything the chosen audits need.

    Args:
        release: object tables, `scenes`, `obstacles`, `targets`, `grasps`, `candidates` and `plans`.
        recipe: what the labels were made with.
    """
    items = []
    for name, audit in chosen:
        candidate, status = release.candidate(name), PlanStatus(release.labels(name)["plan_status"])
        plan = release.plan(name) if audit is Audit.PATH_GEOMETRY else None
        items.append(AuditItem(recipe, release.object_model_of(candidate), candidate, status, plan, audit))
    return items


def audit_rows(items: Sequence[AuditItem], n_workers: int, params: AuditParams | None = None) -> Iterator[Row]:
    """Rows of `audits`, as they finish; no row depends on the others or on the number of workers.

    Raises:
        AuditError: an audit failed or its process died.
    """
    ordered = sorted(items, key=lambda item: (item.candidate.scene.scene_id, item.audit.value, item.candidate_id))
    units: list[tuple[list[AuditItem], AuditParams]] = []
    for _, group in groupby(ordered, key=lambda item: (item.candidate.scene.scene_id, item.audit)):
        alike = list(group)
        units += [(alike[k : k + _ITEMS_A_UNIT], params or AuditParams()) for k in range(0, len(alike), _ITEMS_A_UNIT)]
    with closing(run_units(audit_unit, units, n_workers)) as outcomes:
        for outcome in outcomes:
            if outcome.error is not None:
                names = [item.candidate_id for item in units[outcome.index][0]]
                raise AuditError(f"{names[0]} to {names[-1]}: {outcome.error}")
            yield from outcome.value


def audit_unit(items: Sequence[AuditItem], params: AuditParams) -> list[Row]:
    """Rows of audits of one kind in one scene."""
    first = items[0]
    if first.audit is Audit.SEARCH_BUDGET:
        model = CollisionModel(first.candidate.scene, first.object_model)
        return [_budget_row(item, model, params) for item in items]
    with BulletScene(first.candidate.scene, first.object_model, exact=first.audit is Audit.REJECTION) as world:
        judge = _path_row if first.audit is Audit.PATH_GEOMETRY else _rejection_row
        return [judge(item, world, params) for item in items]


def _path_row(item: AuditItem, world: BulletScene, params: AuditParams) -> Row:
    if item.plan is None:
        raise AuditError(f"{item.candidate_id}: stored as {item.stored_status}, but has no plan")
    recipe = item.recipe
    T_base_place = item.candidate.release_pose(recipe.planning.release_height_m)
    motion = motion_of(item.candidate, item.plan, recipe.planning)
    verdict = recheck_path(world, item.candidate.grasp, T_base_place, motion, recipe.motion, params.step_rad)
    return {
        **_row(item, None, verdict.n_configurations, agrees=verdict.depth_m <= params.max_depth_m),
        "depth_m": verdict.depth_m,
        "deepest_pair": verdict.deepest_pair,
        "clearance_m": verdict.clearance_m,
    }


def _budget_row(item: AuditItem, model: CollisionModel, params: AuditParams) -> Row:
    planning = item.recipe.planning
    search = dataclasses.replace(planning.search, max_checks=params.budget_factor * planning.search.max_checks)
    patient = dataclasses.replace(planning, search=search)
    found = judge_candidate(item.object_model, item.candidate, patient, item.recipe.seed, model)
    return _row(item, found.status, found.n_checks, agrees=found.motion is None)


def _rejection_row(item: AuditItem, world: BulletScene, params: AuditParams) -> Row:
    found = rejudge(world, item.candidate, item.recipe.planning, params, item.recipe.seed)
    return _row(item, found.status, found.n_configurations, agrees=found.status is not PlanStatus.SOLVED)


def _row(item: AuditItem, audited: PlanStatus | None, n_configurations: int, *, agrees: bool) -> Row:
    return {
        "candidate_id": item.candidate_id,
        "audit": item.audit.value,
        "stored_status": item.stored_status.value,
        "audited_status": None if audited is None else audited.value,
        "depth_m": None,
        "deepest_pair": None,
        "clearance_m": None,
        "n_configurations": n_configurations,
        "agrees": agrees,
    }
