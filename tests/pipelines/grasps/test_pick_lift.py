"""The pick-lift check: good grasps lift, bad ones fail for the reason they should, rows do not depend on each other."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from objects.errors import ObjectError
from objects.object_model import ObjectModel, PoolGrasp
from pipelines.codecs import admitted_grasps, joints_in, pose_in
from pipelines.engines.physics.errors import PhysicsError
from pipelines.engines.planning.trajectory import Trajectory, time_path
from pipelines.engines.robot.arm import fk, follow_line
from pipelines.grasps import pick_lift
from pipelines.grasps.admission import AdmissionParams, admission_rows
from pipelines.grasps.pick_lift import PickLiftParams, pick_lift_rows
from pipelines.scenes.tabletop import standing
from pipelines.values import AdmittedGrasp, Scene
from tables import schemas
from tables.poses import inverse
from tables.store import table_from_rows
from tests.pipelines.engines.physics.lifted import LIFTING, lifted, scene_of
from tests.pipelines.engines.physics.object_models import can_model, cuboid_model

PARAMS = LIFTING.pick_lift


def _admitted(object_model: ObjectModel, scene: Scene, n: int = 3) -> tuple[AdmittedGrasp, ...]:
    return admitted_grasps(admission_rows(object_model, scene, AdmissionParams(quota=n)))


@pytest.mark.parametrize("name", ["can", "cuboid", "mug"])
def test_good_grasps_lift_and_their_rows_tell_one_story(name: str) -> None:
    case = lifted(name)
    table_from_rows(schemas.PICK_LIFT, case.lift_rows)
    assert len(case.grasps) == len(case.lift_rows)
    for row, grasp in zip(case.lift_rows, case.grasps, strict=True):
        T_tcp, T_object = fk(joints_in(row, "lifted_q")), pose_in(row, "lifted")
        np.testing.assert_allclose(inverse(T_tcp) @ T_object, pose_in(row, "inhand"), atol=1e-9)
        assert row["lift_slip_m"] <= PARAMS.max_slip_m
        assert T_object[2, 3] - case.scene.T_base_object[2, 3] >= PARAMS.min_rise_m
        width_m = next(g.jaw_width_m for g in case.object_model.grasps if g.grasp_id == grasp.grasp_id)
        # Polygons and turned mugs: a finger may find the object 2 mm wider or narrower than the ray that measured it.
        assert grasp.fingers_m.sum() == pytest.approx(width_m, abs=0.002)


def test_a_row_does_not_depend_on_the_others() -> None:
    object_model = cuboid_model()
    scene = scene_of(object_model)
    admitted = _admitted(object_model, scene)
    together = pick_lift_rows(object_model, scene, admitted, LIFTING)
    backwards = pick_lift_rows(object_model, scene, admitted[::-1], LIFTING)
    alone = [row for grasp in admitted for row in pick_lift_rows(object_model, scene, [grasp], LIFTING)]
    assert len(admitted) >= 2
    assert together == backwards[::-1] == alone


def test_a_hand_that_closes_beside_the_object_lifts_nothing() -> None:
    object_model = can_model()
    scene = scene_of(object_model)
    admitted = _admitted(object_model, scene, 1)
    aside = dataclasses.replace(scene, T_base_object=standing(np.array([0.55, -0.4]), 0.0) @ object_model.stable_poses[0].T_plane_object)
    (row,) = pick_lift_rows(object_model, aside, admitted, LIFTING)
    assert row["lift_status"] == "not_lifted"


def test_a_hand_that_shoves_the_object_away_is_told_apart() -> None:
    """The hand comes down 5 cm beside the middle: a finger pushes the can over or away before it closes."""
    object_model = can_model()
    scene = scene_of(object_model)
    (grasp,) = _admitted(object_model, scene, 1)
    T = scene.T_base_object.copy()
    T[:3, 3] += 0.05 * grasp.T_base_grasp[:3, 1]
    (row,) = pick_lift_rows(object_model, dataclasses.replace(scene, T_base_object=T), [grasp], LIFTING)
    assert row["lift_status"] == "disturbed"
    assert row["lifted_q_1_rad"] is None
    table_from_rows(schemas.PICK_LIFT, [row])


def test_a_heavy_object_held_at_its_end_slips() -> None:
    """2.5 kg of carton held 5 cm from its middle: 1.2 N m turn about the jaw, two pads of rubber hold a tenth of that."""
    object_model = cuboid_model(mass_kg=2.5)
    scene = scene_of(object_model)
    T = np.eye(4)
    T[:3, :3] = np.column_stack([np.cross([1.0, 0, 0], [0, 0, -1.0]), [1.0, 0, 0], [0, 0, -1.0]])
    T[:3, 3] = 0.0, 0.035, 0.05
    object_model = dataclasses.replace(object_model, grasps=(PoolGrasp(0, "top", T, 0.06),))
    (row,) = pick_lift_rows(object_model, scene, _admitted(object_model, scene), LIFTING)
    assert row["lift_status"] in ("slipped", "not_lifted")
    assert row["lift_slip_rad"] > PARAMS.max_slip_rad


def test_a_lift_out_of_reach_is_an_error_that_names_the_grasp() -> None:
    object_model = can_model()
    scene = scene_of(object_model)
    (grasp,) = _admitted(object_model, scene, 1)
    with pytest.raises(PhysicsError, match=f"full-0000-g{grasp.grasp_id:02d}.*cannot follow"):
        pick_lift_rows(object_model, scene, [grasp], dataclasses.replace(LIFTING, pick_lift=PickLiftParams(lift_m=1.0)))


@pytest.mark.parametrize("line_step_m", [LIFTING.admission.line_step_m, 0.001])
def test_a_grasp_is_tried_along_the_lines_that_admission_checked(line_step_m: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """The lift row by row, the approach to a thousandth of a micrometre, whatever the step of admission."""
    object_model = can_model()
    scene, admission = scene_of(object_model), dataclasses.replace(LIFTING.admission, line_step_m=line_step_m)
    (grasp,) = admitted_grasps(admission_rows(object_model, scene, dataclasses.replace(admission, quota=1)))
    followed: list[np.ndarray] = []

    def listen(waypoints: np.ndarray, *rest: object, **more: object) -> Trajectory:
        followed.append(waypoints)
        return time_path(waypoints, *rest, **more)  # type: ignore[arg-type]

    monkeypatch.setattr(pick_lift, "time_path", listen)
    pick_lift_rows(object_model, scene, [grasp], dataclasses.replace(LIFTING, admission=admission))
    T_pregrasp, T_lifted = grasp.T_base_grasp.copy(), grasp.T_base_grasp.copy()
    T_pregrasp[:3, 3] -= admission.pregrasp_m * grasp.T_base_grasp[:3, 2]
    T_lifted[2, 3] += admission.lift_m
    away, up = (
        follow_line(grasp.T_base_grasp, T, grasp.grasp_q_rad, line_step_m, admission.max_joint_jump_rad) for T in (T_pregrasp, T_lifted)
    )
    assert away is not None
    approach, lift = followed
    np.testing.assert_array_equal(lift, up)
    # A line that comes out a hair longer has a row more: then no row is further from a row of the other than a step.
    assert len(approach) - len(away) in (0, 1)
    np.testing.assert_allclose(approach[[0, -1]], away[[-1, 0]], atol=1e-9)
    if len(approach) == len(away):
        np.testing.assert_allclose(approach, away[::-1], atol=1e-9)
    assert np.linalg.norm(np.diff(fk(approach)[:, :3, 3], axis=0), axis=1).max() <= line_step_m + 1e-9


def test_a_line_that_admission_would_refuse_is_an_error_that_names_the_grasp() -> None:
    object_model = can_model()
    scene = scene_of(object_model)
    strict = AdmissionParams(max_joint_jump_rad=0.01)
    refused = {row["grasp_id"] for row in admission_rows(object_model, scene, strict) if row["admission_status"] != "admitted"}
    grasp = next(grasp for grasp in _admitted(object_model, scene, 64) if grasp.grasp_id in refused)
    with pytest.raises(PhysicsError, match=f"full-0000-g{grasp.grasp_id:02d}.*cannot follow"):
        pick_lift_rows(object_model, scene, [grasp], dataclasses.replace(LIFTING, admission=strict))


def test_a_grasp_of_no_pool_is_an_error() -> None:
    object_model = can_model()
    scene = scene_of(object_model)
    (grasp,) = _admitted(object_model, scene, 1)
    stranger = AdmittedGrasp(63, grasp.T_base_grasp, grasp.pregrasp_q_rad, grasp.grasp_q_rad)
    with pytest.raises(ObjectError, match=r"test_can: .*63"):
        pick_lift_rows(object_model, scene, [stranger], LIFTING)


@pytest.mark.parametrize(("field", "value"), [("lift_m", 0.0), ("min_rise_m", 0.12), ("max_slip_rad", -1.0)])
def test_params_are_valid_from_birth(field: str, value: float) -> None:
    with pytest.raises(ValueError, match=field):
        PickLiftParams(**{field: value})
