"""Studies of stored executions against theory: what the planned motion asks of the grip, and what became of the object."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import rankdata

from pipelines.codecs import Row
from pipelines.labels.verdict import is_slip
from pipelines.proofs.validity.contact_patch import contact_patch
from pipelines.proofs.validity.demand import capacity_n, carried, demand_ratio, demand_ratio_even_pads
from pipelines.proofs.validity.study import Numbers, Study, StudyUnit
from pipelines.proofs.validity.subject import Case, Subject
from tables.identity import order_key
from tables.vocabulary import Category, ExecStatus

# Shares of the capacity below which an object must not move, and must not be lost.
STICKS, HOLDS = 0.25, 0.5
CATEGORIES = (Category.CAN.value, Category.CUBOID.value)


def loads_study(subject: Subject) -> Study:
    """Demand ratios of the executed cans and cuboids beside their stored outcomes; nothing is executed again."""
    rows = subject.executed(CATEGORIES)
    rows = sorted(rows, key=lambda row: order_key(subject.recipe.seed, "loads", row["candidate_id"]))[: subject.sizes.n_loads]
    rows = sorted(rows, key=lambda row: str(row["candidate_id"]))
    units = tuple(StudyUnit(row["candidate_id"], (subject.case(row["candidate_id"]), row)) for row in rows)
    return Study("loads", units, loads_row, loads_summary, unit_ms=40.0, runs_engine=False)


def loads_row(case: Case, stored: Row) -> Row:
    """Demand ratios of one candidate beside its stored labels; the first None where a pad's face does not meet the object.

    Lost is what fell on the way or slipped beyond the verdict's bound, however it ended.
    """
    physics, object_model, grasp = case.recipe.hand_physics, case.object_model, case.candidate.grasp
    hands = carried(case.motion(), case.recipe.motion, physics.dt_s)
    patch = contact_patch(object_model, grasp.T_tcp_object, physics)
    is_lost = stored["exec_status"] == ExecStatus.DROPPED.value or is_slip(
        stored["transport_slip_m"], stored["transport_slip_rad"], case.recipe.execution
    )
    row = {
        **stored,
        "is_lost": is_lost,
        "demand_even_pads": demand_ratio_even_pads(object_model, grasp, hands, physics),
        "demand": None,
        "preload": None,
    }
    if patch is not None:
        row["demand"] = demand_ratio(patch, object_model, grasp, hands, physics)
        row["preload"] = float(np.linalg.norm(patch.preload_n)) / (capacity_n(object_model, physics) / 2)
    return row


def loads_summary(rows: Sequence[Row]) -> Numbers:
    """Slip of light loads, what was lost of them, and how well the ratio foretells the outcome.

    Outcome is the stored success, whatever the reason of a failure: release and landing count against theory, which knows nothing of them.
    """
    cuboids = [row for row in rows if row["category"] == Category.CUBOID.value]
    preloads = [row["preload"] for row in rows if row["preload"] is not None]
    held = np.array([not row["is_lost"] for row in cuboids], dtype=bool)
    return {
        **_by_load(rows, "demand", ""),
        **_by_load(rows, "demand_even_pads", "_even_pads"),
        "cuboid_auc": _foretold(cuboids, "demand", np.array([row["y_pipe"] for row in cuboids], dtype=bool)),
        "cuboid_held_auc": _foretold(cuboids, "demand", held),
        "cuboid_auc_even_pads": _foretold(cuboids, "demand_even_pads", np.array([row["y_pipe"] for row in cuboids], dtype=bool)),
        "n_cuboid_auc": float(len(cuboids)),
        "preload_ratio_max": max(preloads, default=None),
        "n_loads": float(len(rows)),
    }


def _by_load(rows: Sequence[Row], ratio: str, suffix: str) -> dict[str, float | None]:
    sticking = [row for row in rows if row[ratio] is not None and row[ratio] <= STICKS]
    light = [row for row in rows if row[ratio] is not None and row[ratio] <= HOLDS]
    return {
        f"transport_slip{suffix}_mm_max": max((1e3 * row["transport_slip_m"] for row in sticking), default=None),
        f"n_transport_slip{suffix}": float(len(sticking)),
        f"light_load_drops{suffix}": float(sum(row["is_lost"] for row in light)) if light else None,
        f"n_light_load{suffix}": float(len(light)),
    }


def _foretold(rows: Sequence[Row], ratio: str, is_good: Bool[np.ndarray, "n"]) -> float | None:
    """Area under the ROC curve of a small ratio as a prediction of a good outcome; a hold without a patch counts as the worst."""
    values = np.array([np.inf if row[ratio] is None else row[ratio] for row in rows], dtype=np.float64)
    return area_under_roc(-values, is_good)


def area_under_roc(scores: Float[np.ndarray, "n"], is_good: Bool[np.ndarray, "n"]) -> float | None:
    """Chance that a good one scores above a bad one, ties counting half (Mann and Whitney); None where there is only one kind."""
    n_good, n_bad = int(is_good.sum()), int((~is_good).sum())
    if not n_good or not n_bad:
        return None
    return float((rankdata(scores)[is_good].sum() - n_good * (n_good + 1) / 2) / (n_good * n_bad))
