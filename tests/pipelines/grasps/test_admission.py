"""Laws of grasp admission: what is admitted is reachable and free, what is not says why, and nothing depends on order."""

from __future__ import annotations

import dataclasses
from collections import Counter

import numpy as np
import pytest

from objects.gripper import open_jaw_m
from objects.object_model import ObjectModel, PoolGrasp
from pipelines.codecs import Row, admitted_grasps
from pipelines.engines.planning.collision import CollisionModel
from pipelines.engines.robot.arm import Q_LOWER_RAD, Q_UPPER_RAD, fk, follow_line
from pipelines.grasps.admission import AdmissionParams, admission_rows, judge_grasp
from pipelines.values import AdmittedGrasp, Scene
from tables.schemas import GRASP_ADMISSION
from tables.store import content_hash, table_from_rows
from tests.builders import box_model, can_model, panda_scene, pose, tcp_pose
from tests.pipelines.engines.planning.bullet_reference import BulletReference

PARAMS = AdmissionParams()
SCENES = [(can_model(), [(0.45, 0.22)]), (box_model(), [(0.45, 0.2), (0.62, -0.18)])]


def only(object_model: ObjectModel, T_object_grasp: np.ndarray, jaw_width_m: float) -> ObjectModel:
    return dataclasses.replace(object_model, grasps=(PoolGrasp(0, "test", T_object_grasp, jaw_width_m),))


def status(object_model: ObjectModel, scene: Scene) -> str:
    (row,) = admission_rows(object_model, scene, PARAMS)
    return row["admission_status"]


def lines(admitted: AdmittedGrasp) -> tuple[np.ndarray, np.ndarray]:
    """Approach (pregrasp first) and lift of an admitted grasp, computed anew."""
    T_pregrasp, T_lifted = admitted.T_base_grasp.copy(), admitted.T_base_grasp.copy()
    T_pregrasp[:3, 3] -= PARAMS.pregrasp_m * admitted.T_base_grasp[:3, 2]
    T_lifted[2, 3] += PARAMS.lift_m
    approach = follow_line(T_pregrasp, admitted.T_base_grasp, admitted.pregrasp_q_rad, PARAMS.line_step_m, PARAMS.max_joint_jump_rad)
    lift = follow_line(admitted.T_base_grasp, T_lifted, admitted.grasp_q_rad, PARAMS.line_step_m, PARAMS.max_joint_jump_rad)
    assert approach is not None
    assert lift is not None
    return approach, lift


@pytest.mark.parametrize(("object_model", "obstacles"), SCENES, ids=["can", "box"])
def test_admitted_grasps_are_reached_and_free_as_pybullet_sees_it(object_model: ObjectModel, obstacles: list[tuple[float, float]]) -> None:
    """Approach and lift rechecked by the other engine every 5 mm; 1 mm deep would be a bug."""
    scene = panda_scene(object_model, obstacles)
    rows = admission_rows(object_model, scene, PARAMS)
    admitted = admitted_grasps(rows)
    assert len(admitted) >= 5
    with BulletReference(scene, object_model) as reference:
        for grasp in admitted:
            np.testing.assert_allclose(fk(grasp.grasp_q_rad), grasp.T_base_grasp, atol=1e-6)
            assert grasp.pregrasp_q_rad[6] == grasp.grasp_q_rad[6]
            approach, lift = lines(grasp)
            np.testing.assert_allclose(approach[-1], grasp.grasp_q_rad, atol=1e-5)
            for line in (approach, lift):
                assert np.all((line >= Q_LOWER_RAD) & (line <= Q_UPPER_RAD))
            pool = next(g for g in object_model.grasps if g.grasp_id == grasp.grasp_id)
            jaw_m = open_jaw_m(pool.jaw_width_m)
            assert min(reference.open_m(q, jaw_m, scene.T_base_object) for q in approach[::4]) > -0.001
            fingers_m = np.full(2, pool.jaw_width_m / 2)
            T_tcp_object = np.linalg.inv(pool.T_object_grasp)
            assert min(reference.carrying_m(q, fingers_m, T_tcp_object) for q in lift[2::4]) > -0.001


@pytest.mark.parametrize(("object_model", "obstacles"), SCENES, ids=["can", "box"])
def test_every_pool_grasp_has_one_row_and_a_reason(object_model: ObjectModel, obstacles: list[tuple[float, float]]) -> None:
    rows = admission_rows(object_model, panda_scene(object_model, obstacles), PARAMS)
    table = table_from_rows(GRASP_ADMISSION, rows)
    assert [row["grasp_id"] for row in rows] == [grasp.grasp_id for grasp in object_model.grasps]
    counts = Counter(row["admission_status"] for row in rows)
    assert len(counts) >= 3, counts
    reached_ik = {"admitted", "arm_collision", "approach_blocked", "lift_blocked", "not_needed"}
    for row in rows:
        assert (row["n_ik"] is not None) == (row["admission_status"] in reached_ik)
        assert (row["grasp_q_1_rad"] is not None) == (row["admission_status"] == "admitted")
    assert table.num_rows == len(object_model.grasps)


def test_rows_do_not_depend_on_pool_order_or_on_what_the_model_saw_before() -> None:
    """All grasps on one collision model, in either order, and each alone on a model of its own; twice over on one model."""
    object_model, obstacles = SCENES[1]
    scene = panda_scene(object_model, obstacles)
    hashes = set()
    for variant in (object_model, dataclasses.replace(object_model, grasps=object_model.grasps[::-1])):
        hashes.add(content_hash(table_from_rows(GRASP_ADMISSION, admission_rows(variant, scene, PARAMS))))
    assert len(hashes) == 1
    model = CollisionModel(scene, object_model)
    for grasp in (*object_model.grasps, *object_model.grasps[::-1]):
        T_base_grasp = scene.T_base_object @ grasp.T_object_grasp
        used, fresh = (judge_grasp(grasp, T_base_grasp, scene, m, PARAMS) for m in (model, CollisionModel(scene, object_model)))
        assert (used.status, used.n_ik) == (fresh.status, fresh.n_ik)
        np.testing.assert_array_equal(used.grasp_q_rad, fresh.grasp_q_rad)
    alone: list[Row] = []
    for grasp in object_model.grasps:
        alone += admission_rows(dataclasses.replace(object_model, grasps=(grasp,)), scene, PARAMS)
    assert content_hash(table_from_rows(GRASP_ADMISSION, alone)) in hashes


def test_the_quota_keeps_the_first_and_calls_the_others_not_needed() -> None:
    object_model, obstacles = SCENES[0]
    scene = panda_scene(object_model, obstacles)
    every = [row["grasp_id"] for row in admission_rows(object_model, scene, PARAMS) if row["admission_status"] == "admitted"]
    rows = admission_rows(object_model, scene, dataclasses.replace(PARAMS, quota=4))
    assert [row["grasp_id"] for row in rows if row["admission_status"] == "admitted"] == every[:4]
    assert [row["grasp_id"] for row in rows if row["admission_status"] == "not_needed"] == every[4:]


SIDE = tcp_pose((0.0, 0.0, 0.02), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))


def test_each_reason_is_given_where_it_is_the_reason() -> None:
    """One grasp from the near side, then one thing after another in its way."""
    object_model = only(can_model(), SIDE, 0.066)
    free = dataclasses.replace(panda_scene(object_model), T_base_object=pose(0.5, 0.0, 0.06))
    assert status(object_model, free) == "admitted"

    too_deep = SIDE @ pose(0.0, 0.0, 0.0)
    too_deep[0, 3] += 0.05
    assert status(only(object_model, too_deep, 0.066), free) == "palm_contact"
    low = tcp_pose((0.0, 0.0, -0.055), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    assert status(only(object_model, low, 0.066), free) == "scene_collision"
    behind = dataclasses.replace(free, obstacles=panda_scene(object_model, [(0.38, 0.05)]).obstacles)
    assert status(object_model, behind) == "scene_collision"
    off_axis = SIDE.copy()
    off_axis[1, 3] = 0.015
    assert status(only(object_model, off_axis, 0.066), free) == "object_collision"
    past_the_end = tcp_pose((-0.05, 0.0, 0.02), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    assert status(only(object_model, past_the_end, 0.04), free) == "fingers_miss"
    far = dataclasses.replace(free, T_base_object=pose(1.2, 0.0, 0.06))
    assert status(object_model, far) == "no_ik"
    ceiling = dataclasses.replace(
        free, obstacles=(dataclasses.replace(panda_scene(object_model, [(0.6, 0.0)]).obstacles[0], T_base_obstacle=pose(0.56, 0.0, 0.24)),)
    )
    assert status(object_model, ceiling) == "lift_blocked"


@pytest.mark.parametrize(("name", "value"), [("quota", 0), ("line_step_m", 0.005), ("palm_clearance_m", -0.001), ("n_q7", 0)])
def test_impossible_parameters_are_refused(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        AdmissionParams(**{name: value})
