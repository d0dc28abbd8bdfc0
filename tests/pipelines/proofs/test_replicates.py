"""Replicates follow from identity, stay within their bounds, begin as the label did, and a killed run goes on where it was."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from pipelines.labels.execution import ExecutionSetup, Lateness, execute_held, execution_rows
from pipelines.labels.verdict import ExecutionParams, Monitor
from pipelines.proofs import replicates
from pipelines.proofs.replicates import NOTHING, ReplicateError, SceneWork, execute_uncertain, replicate_table, uncertainty_of
from pipelines.recipe import Recipe, load_recipe
from pipelines.values import Candidate, Plan
from tables.poses import rotation_angle_rad
from tests.pipelines.engines.physics.lifted import MOTION, PHYSICS, Lifted, lifted


def plan_of(motion_index: int, case: Lifted) -> tuple[Candidate, Plan]:
    """A planned candidate with the plan that its motion comes from."""
    candidate, motion = case.planned[motion_index]
    return candidate, Plan(motion.descend_q_rad[-1], motion.transport_q_rad[1:-1])


@pytest.fixture(scope="module")
def recipe() -> Recipe:
    whole = load_recipe("full")
    return dataclasses.replace(whole, hand_physics=PHYSICS)


def test_draws_follow_from_identity_and_fill_their_bounds() -> None:
    drawn = [uncertainty_of(42, f"full-{k:04d}-t0-g00", r) for k in range(400) for r in range(5)]
    assert drawn[7] == uncertainty_of(42, "full-0001-t0-g00", 2)
    assert len({one.friction_scale for one in drawn}) > 1000
    numbers = np.array([[one.friction_scale - 1, one.mass_scale - 1, *one.shift_m, *one.turn_rad] for one in drawn])
    bounds = np.array([0.10, 0.05, *[1e-3] * 3, *[math.radians(1.0)] * 3])
    assert (np.abs(numbers) <= bounds + 1e-12).all()
    # Even on [-b, b]: the mean within four standard errors of 0, the deviation b / sqrt 3.
    assert (np.abs(numbers.mean(axis=0)) < 4 * bounds / np.sqrt(3 * len(drawn))).all()
    assert numbers.std(axis=0) == pytest.approx(bounds / np.sqrt(3), rel=0.05)
    assert np.abs(np.corrcoef(numbers.T) - np.eye(8)).max() < 0.1
    ticks = np.array([dataclasses.astuple(one.late) for one in drawn])
    assert set(ticks.ravel()) == {-1, 0, 1}


def test_an_object_is_moved_in_the_axes_of_the_hand() -> None:
    T = np.eye(4)
    T[:3, :3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    T[:3, 3] = (0.0, 0.0, 0.03)
    moved = dataclasses.replace(NOTHING, shift_m=(1e-3, 0.0, 0.0), turn_rad=(0.0, 0.01, 0.0)).moved(T)
    assert moved[:3, 3] == pytest.approx([1e-3, 0.0, 0.03])
    assert float(rotation_angle_rad(T[:3, :3], moved[:3, :3])) == pytest.approx(0.01)
    assert (moved[:3, :3] @ T[:3, :3].T)[:, 1] == pytest.approx([0.0, 1.0, 0.0])
    assert NOTHING.moved(T) == pytest.approx(T)


def test_without_uncertainty_a_replicate_ends_as_the_label(recipe: Recipe) -> None:
    """The hand takes the object anew instead of holding it as measured: the end is the same to a tenth of a millimetre."""
    case = lifted("cuboid")
    setup = ExecutionSetup(recipe.execution, recipe.motion, PHYSICS)
    for k in (0, len(case.planned) - 1):
        candidate, plan = plan_of(k, case)
        (label,) = execution_rows(case.object_model, [case.planned[k]], setup)
        again = execute_uncertain(case.object_model, candidate, plan, recipe, NOTHING)
        assert again["exec_status"] == label["exec_status"] == "success"
        assert again["final_position_error_m"] == pytest.approx(label["final_position_error_m"], abs=2e-4)


def test_late_and_early_motions_take_as_many_ticks_more_or_fewer() -> None:
    from pipelines.engines.physics.hand_world import HandWorld

    case = lifted("cuboid")
    candidate, motion = case.planned[0]
    setup, grasp = ExecutionSetup(ExecutionParams(), MOTION, PHYSICS), candidate.grasp
    ends: dict[int, int] = {}
    for late in (Lateness(), Lateness(1, 0, 0), Lateness(0, 1, 0), Lateness(0, -1, 0), Lateness(-1, -1, 0)):
        with HandWorld(case.object_model, candidate.scene.obstacles, PHYSICS) as world:
            world.start_held("late", grasp.lifted_q_rad, grasp.fingers_m.tolist(), grasp.T_tcp_object)
            released: list[int] = []

            def watch(phase: object, world: HandWorld = world, released: list[int] = released) -> bool:
                if str(phase) == "open" and not released:
                    released.append(world.n_steps)
                return False

            row = execute_held(world, candidate, motion, setup, Monitor(world, grasp.T_tcp_object, setup.execution, watch), late)
        assert row["exec_status"] == "success"
        ends[late.transport + late.descend] = released[0]
    assert {shift: end - ends[0] for shift, end in ends.items()} == {0: 0, 1: 1, -1: -1, -2: -2}


def test_a_killed_run_goes_on_where_it_was(recipe: Recipe, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []

    def rows_of(work: SceneWork) -> list[dict[str, object]]:
        made.append(work.scene_id)
        if work.scene_id == "full-0001" and len(made) == 2:
            raise RuntimeError("killed")
        label = {"exec_status": "success", "is_success": True, "tolerance_margin": 0.5}
        name = f"{work.scene_id}-t0-g00"
        return [{"candidate_id": name, "replicate": r, **uncertainty_of(1, name, r).row(), **label} for r in range(2)]

    monkeypatch.setattr(replicates, "scene_rows", rows_of)
    works = [SceneWork(f"full-{k:04d}", lifted("cuboid").object_model, (), recipe, 2) for k in range(3)]
    kept = tmp_path / "rows.jsonl"
    with pytest.raises(ReplicateError, match="1 of 3 scenes failed, must be 0: full-0001: RuntimeError: killed"):
        replicate_table(works, kept, {"code": "1"}, 0)
    table = replicate_table(works, kept, {"code": "1"}, 0)
    assert made == ["full-0000", "full-0001", "full-0002", "full-0001"]
    assert table.num_rows == 6
    assert table["friction_scale"].to_pylist()[:2] == [uncertainty_of(1, "full-0000-t0-g00", r).friction_scale for r in range(2)]
    assert replicate_table(works, kept, {"code": "2"}, 0).equals(table)
    assert len(made) == 7, "rows of other code are made again"
