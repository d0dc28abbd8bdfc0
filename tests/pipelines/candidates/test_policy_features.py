"""What the endpoint baselines know: reach without collisions, and the hand alone against table and obstacles."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np
import pytest

from objects.gripper import gripper_boxes, open_jaw_m
from pipelines.candidates.policy_features import policy_feature_rows
from pipelines.engines.planning.bodies import CLEARANCE_M
from pipelines.engines.robot.arm import ik
from pipelines.engines.robot.geometry import box_corners, moved
from pipelines.values import Candidate, LiftedGrasp, Scene, Target
from tables.schemas import POLICY_FEATURES, TIMINGS
from tables.store import table_from_rows
from tests.builders import box_model, can_model, panda_scene, pose


def candidates_of(scene: Scene, grasp_ids: Iterable[int], target_ids: Iterable[int]) -> list[Candidate]:
    """Candidates whose lifted state is beside the point."""
    eye, grasps = np.eye(4), list(grasp_ids)
    return [Candidate(scene, LiftedGrasp(g, np.zeros(7), np.zeros(2), eye, eye), scene.target(t)) for t in target_ids for g in grasps]


def test_nothing_measured_after_planning_can_enter() -> None:
    """The pose measured in the hand is in the candidate, and wrong here: nothing may change."""
    object_model = can_model()
    candidates = candidates_of(panda_scene(object_model, [(0.45, 0.25)]), range(0, 40, 7), range(8))
    spoilt = [
        dataclasses.replace(c, grasp=LiftedGrasp(c.grasp.grasp_id, *[np.full(n, np.nan) for n in (7, 2, (4, 4), (4, 4))]))
        for c in candidates
    ]
    assert policy_feature_rows(object_model, spoilt, 128)[0] == policy_feature_rows(object_model, candidates, 128)[0]


def test_features_and_timings_fit_their_tables_and_repeat() -> None:
    object_model = can_model()
    scene = panda_scene(object_model, [(0.45, 0.25)])
    features, timings = policy_feature_rows(object_model, candidates_of(scene, range(0, 40, 3), range(8)), 128)
    assert table_from_rows(POLICY_FEATURES, features).num_rows == 14 * 8
    assert table_from_rows(TIMINGS, timings).num_rows == 2 * 14 * 8
    assert {row["stage"] for row in timings} == {"policy_ik", "policy_gripper"}
    again, _ = policy_feature_rows(object_model, candidates_of(scene, range(39, -1, -3), range(7, -1, -1)), 128)
    assert sorted(again, key=lambda row: row["candidate_id"]) == sorted(features, key=lambda row: row["candidate_id"])


def test_reach_ignores_collisions_and_the_hand_ignores_reach() -> None:
    object_model = can_model()
    scene = panda_scene(object_model)
    out_of_reach = dataclasses.replace(scene, targets=(Target(0, 0, pose(1.5, 0.0, 0.06)),))
    buried = dataclasses.replace(scene, targets=(Target(0, 0, pose(0.5, 0.0, -0.3)),))
    blocked = dataclasses.replace(panda_scene(object_model, [(0.5, 0.0)]), targets=(Target(0, 0, pose(0.5, 0.0, 0.06)),))
    grasp_ids = range(len(object_model.grasps))
    far, _ = policy_feature_rows(object_model, candidates_of(out_of_reach, grasp_ids, [0]), 128)
    assert not any(row["ik_feasible"] for row in far)
    assert any(row["gripper_free"] for row in far)
    below, _ = policy_feature_rows(object_model, candidates_of(buried, grasp_ids, [0]), 128)
    assert any(row["ik_feasible"] for row in below)
    assert not any(row["gripper_free"] for row in below)
    inside, _ = policy_feature_rows(object_model, candidates_of(blocked, grasp_ids, [0]), 128)
    without, _ = policy_feature_rows(object_model, candidates_of(dataclasses.replace(blocked, obstacles=()), grasp_ids, [0]), 128)
    assert [row["ik_feasible"] for row in inside] == [row["ik_feasible"] for row in without]
    assert not any(row["gripper_free"] for row in inside)
    assert any(row["gripper_free"] for row in without)


@pytest.mark.parametrize("object_model", [can_model(), box_model()], ids=["can", "box"])
def test_the_hand_over_a_table_is_free_where_its_lowest_corner_is(object_model: object) -> None:
    """Reference: corners of the gripper's boxes. The hand's hull is inside its box by up to 2 mm, so closer calls are left out."""
    lying = pose(0.45, 0.1, 0.033) @ np.array([[0.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    scene = dataclasses.replace(panda_scene(object_model), targets=(Target(0, 0, lying), Target(1, 0, pose(0.45, 0.1, 0.06))))
    features, _ = policy_feature_rows(object_model, candidates_of(scene, [g.grasp_id for g in object_model.grasps], [0, 1]), 128)
    free = {row["candidate_id"]: row["gripper_free"] for row in features}
    verdicts = []
    for target in scene.targets:
        for grasp in object_model.grasps:
            T_place = target.T_base_target @ grasp.T_object_grasp
            boxes = zip(*gripper_boxes(open_jaw_m(grasp.jaw_width_m)), strict=True)
            lowest = min(moved(T_place @ T, box_corners(size))[:, 2].min() for T, size in boxes)
            if not -0.002 <= lowest - CLEARANCE_M <= 0.0:
                verdicts.append(lowest > CLEARANCE_M)
                assert free[f"full-0000-t{target.target_id}-g{grasp.grasp_id:02d}"] == verdicts[-1]
    assert 0.2 < np.mean(verdicts) < 0.95


def test_reach_is_that_of_the_pool_grasp_at_the_target() -> None:
    object_model = box_model()
    scene = panda_scene(object_model)
    features, _ = policy_feature_rows(object_model, candidates_of(scene, [g.grasp_id for g in object_model.grasps], range(8)), 128)
    expected = [len(ik(t.T_base_target @ g.T_object_grasp, 128)) > 0 for t in scene.targets for g in object_model.grasps]
    assert [row["ik_feasible"] for row in features] == expected
    assert 0.0 < np.mean(expected) < 1.0
