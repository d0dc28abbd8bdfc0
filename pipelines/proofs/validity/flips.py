"""The study of executions run again as they were and under changes that ought not to matter: how many labels flip, and which way."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

from pipelines.codecs import Row
from pipelines.labels.execution import execute_perturbed
from pipelines.proofs.validity.changes import FRICTION, Change, changed_physics
from pipelines.proofs.validity.study import Numbers, Study, StudyUnit
from pipelines.proofs.validity.subject import Case, Subject, choose_mixed
from tables.vocabulary import ExecStatus, Perturbation

TELLING_SLIP_MM = 0.1  # of difference, below which two slips count as the same
# Keys of the criteria: share of flips, number of runs.
_KEYS = {
    Change.HALF_STEP: ("half_step_flip", "n_half_step"),
    Change.FINER_PADS: ("finer_pad_flip", "n_finer_pad"),
    Change.LEVER_UP: ("pad_lever_up_flip", "n_pad_lever_up"),
    Change.LEVER_DOWN: ("pad_lever_down_flip", "n_pad_lever_down"),
}


def flips_study(subject: Subject) -> Study:
    """The same number of executed candidates of each category, statuses at their natural rates, each under every change and none.

    More of them under other friction alone, since the share of flips that go the right way needs flips.
    """
    strata: dict[tuple[str, str], list[str]] = {}
    for row in subject.executed():
        strata.setdefault((row["category"], row["exec_status"]), []).append(row["candidate_id"])
    stored = {row["candidate_id"]: row["exec_status"] for row in subject.executed()}
    chosen, more = (
        choose_mixed(strata, subject.recipe.seed, "validity_executions", n) for n in (subject.sizes.n_executions, subject.sizes.n_friction)
    )
    changes = dict.fromkeys(more, (Change.NONE, *FRICTION)) | dict.fromkeys(chosen, tuple(Change))
    cases = {name: subject.case(name) for name in sorted(changes)}
    units = tuple(StudyUnit(f"{name} {change}", (case, stored[name], change)) for name, case in cases.items() for change in changes[name])
    return Study("flips", units, flips_row, flips_summary, unit_ms=160.0)


def flips_row(case: Case, stored_status: str, change: Change) -> Row:
    """How one candidate ends under one change."""
    setup = dataclasses.replace(case.recipe.execution_setup, physics=changed_physics(case.recipe, change))
    label = execute_perturbed(case.object_model, case.candidate, case.motion(), Perturbation.FRESH, setup)
    return {
        "candidate_id": case.candidate.candidate_id,
        "category": case.object_model.category,
        "change": change.value,
        "stored_status": stored_status,
        "status": label["exec_status"],
        "is_success": label["y_pipe"],
        "margin": label["tolerance_margin"],
        "slip_mm": 1e3 * label["transport_slip_m"],
        "slip_deg": math.degrees(label["transport_slip_rad"]),
    }


def flips_summary(rows: Sequence[Row]) -> Numbers:
    """Shares of flips, against the run without a change; of those under other friction, the share that goes the right way.

    The right way is that more friction turns failure into success, or less of it success into failure. Without any flip the share is 1.
    Slip in the hand has a right way of its own, which landing has no part in.
    """
    unchanged = [row for row in rows if row["change"] == Change.NONE.value]
    numbers: dict[str, float | None] = {
        "stored_differs": float(sum(row["status"] != row["stored_status"] for row in unchanged)),
        "n_stored": float(len(unchanged)),
    }
    for change, (key, count_key) in _KEYS.items():
        numbers |= _share(flips_of(rows, (change,)), key, count_key, len(pairs_of(rows, (change,))))
    flipped = flips_of(rows, FRICTION)
    numbers |= _share(flipped, "friction_flip", "n_friction", len(pairs_of(rows, FRICTION)))
    right = [after for _, after in flipped if goes_right_way(after)]
    slips = _slip_changes(rows)
    return numbers | {
        "friction_right_way": len(right) / len(flipped) if flipped else 1.0,
        "n_friction_flipped": float(len(flipped)),
        "friction_slip_right_way": sum(slips) / len(slips) if slips else 1.0,
        "n_friction_slip": float(len(slips)),
    }


def _slip_changes(rows: Sequence[Row]) -> list[bool]:
    """Of the holds whose slip under other friction is another: whether more friction slips less, or less of it more.

    What falls out of the hand has no slip that could be compared.
    """
    return [
        (after["slip_mm"] < before["slip_mm"]) == (after["change"] == Change.FRICTION_UP.value)
        for before, after in pairs_of(rows, FRICTION)
        if abs(after["slip_mm"] - before["slip_mm"]) > TELLING_SLIP_MM
        and ExecStatus.DROPPED.value not in (before["status"], after["status"])
    ]


def pairs_of(rows: Sequence[Row], changes: Sequence[Change], by: str = "candidate_id") -> list[tuple[Row, Row]]:
    """(row without a change, row with one) of the runs that have both."""
    unchanged: Mapping[str, Row] = {row[by]: row for row in rows if row["change"] == Change.NONE.value}
    names = [change.value for change in changes]
    return [(unchanged[row[by]], row) for row in rows if row["change"] in names and row[by] in unchanged]


def flips_of(rows: Sequence[Row], changes: Sequence[Change], by: str = "candidate_id") -> list[tuple[Row, Row]]:
    """Those of them whose success differs."""
    return [(before, after) for before, after in pairs_of(rows, changes, by) if before["is_success"] != after["is_success"]]


def goes_right_way(after: Row) -> bool:
    """Whether a flip under other friction is the one that physics expects."""
    return bool(after["is_success"] == (after["change"] == Change.FRICTION_UP.value))


def _share(flipped: Sequence[tuple[Row, Row]], key: str, count_key: str, n: int) -> dict[str, float | None]:
    return {key: len(flipped) / n if n else None, count_key: float(n)}
