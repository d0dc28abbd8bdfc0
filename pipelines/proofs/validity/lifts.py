"""The study of pick-lifts run again as they were and under changes that ought not to matter: is the grasp still lifted, or still not?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from objects.object_model import ObjectModel
from pipelines.codecs import Row, admitted_grasps
from pipelines.grasps.pick_lift import PickLiftSetup, pick_lift_rows
from pipelines.proofs.validity.changes import FRICTION, Change, changed_physics
from pipelines.proofs.validity.flips import flips_of, pairs_of
from pipelines.proofs.validity.study import Numbers, Study, StudyUnit
from pipelines.proofs.validity.subject import Subject, choose_mixed
from pipelines.recipe import Recipe
from pipelines.values import AdmittedGrasp, Scene
from tables.vocabulary import LiftStatus

CHANGES = (Change.NONE, Change.HALF_STEP, *FRICTION)


@dataclass(frozen=True, slots=True)
class LiftCase:
    """An admitted grasp with all that it takes to lift it."""

    object_model: ObjectModel
    scene: Scene
    grasp: AdmittedGrasp
    recipe: Recipe

    @property
    def name(self) -> str:
        return _name(self.scene.scene_id, self.grasp.grasp_id)


def lifts_study(subject: Subject) -> Study:
    """The same number of admitted grasps of each category, statuses at their natural rates, each under some changes and none."""
    strata: dict[tuple[str, str], list[str]] = {}
    stored: dict[str, Row] = {}
    for row in (row for rows in subject.values.grasp_rows.values() for row in rows if row["admission_status"] == "admitted"):
        stored[name := _name(row["scene_id"], row["grasp_id"])] = row
        strata.setdefault((subject.values.object_models[row["object_id"]].category, str(row["lift_status"])), []).append(name)
    # Only what is chosen is decoded: `full` has tens of thousands of admitted grasps.
    chosen = choose_mixed(strata, subject.recipe.seed, "validity_lifts", subject.sizes.n_lifts)
    cases = {name: (_case(subject, stored[name]), str(stored[name]["lift_status"])) for name in chosen}
    units = tuple(StudyUnit(f"{name} {change}", (*case, change)) for name, case in cases.items() for change in CHANGES)
    return Study("lifts", units, lifts_row, lifts_summary, unit_ms=100.0)


def _name(scene_id: str, grasp_id: int) -> str:
    return f"{scene_id}-g{grasp_id:02d}"


def _case(subject: Subject, row: Row) -> LiftCase:
    """An admitted row of `grasps` with its scene and object."""
    (grasp,) = admitted_grasps([row])
    scene = subject.values.scene(row["scene_id"])
    return LiftCase(subject.values.object_models[scene.object_id], scene, grasp, subject.recipe)


def lifts_row(case: LiftCase, stored_status: str, change: Change) -> Row:
    """How one grasp ends under one change."""
    recipe = case.recipe
    setup = PickLiftSetup(recipe.pick_lift, recipe.grasp_admission, recipe.motion, changed_physics(recipe, change))
    (label,) = pick_lift_rows(case.object_model, case.scene, [case.grasp], setup)
    return {
        "grasp": case.name,
        "category": case.object_model.category,
        "change": change.value,
        "stored_status": stored_status,
        "status": label["lift_status"],
        "is_success": label["lift_status"] == LiftStatus.LIFTED.value,
    }


def lifts_summary(rows: Sequence[Row]) -> Numbers:
    """Shares of grasps that are lifted under a change and not without it, or the reverse."""
    unchanged = [row for row in rows if row["change"] == Change.NONE.value]
    numbers: dict[str, float | None] = {
        "lift_stored_differs": float(sum(row["status"] != row["stored_status"] for row in unchanged)),
        "n_lift_stored": float(len(unchanged)),
    }
    for key, count_key, changes in (
        ("lift_half_step_flip", "n_lift_half_step", (Change.HALF_STEP,)),
        ("lift_friction_flip", "n_lift_friction", FRICTION),
    ):
        n = len(pairs_of(rows, changes, "grasp"))
        numbers |= {key: len(flips_of(rows, changes, "grasp")) / n if n else None, count_key: float(n)}
    return numbers
