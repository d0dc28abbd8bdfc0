"""The pick-lift check: good grasps lift, bad ones fail for the reason they should, rows do not depend on each other."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from objects.errors import ObjectError
from objects.object_model import PoolGrasp
from pipelines.codecs import admitted_grasps, joints_in, pose_in
from pipelines.engines.physics.errors import PhysicsError
from pipelines.engines.robot.arm import fk
from pipelines.grasps.admission import AdmissionParams, admission_rows
from pipelines.grasps.pick_lift import PickLiftParams, pick_lift_rows
from pipelines.scenes.tabletop import standing
from pipelines.values import AdmittedGrasp
from tables import schemas
from tables.poses import inverse
from tables.store import table_from_rows
from tests.pipelines.engines.physics.lifted import MOTION, PHYSICS, lifted, scene_of
from tests.pipelines.engines.physics.object_models import can_model, cuboid_model

PARAMS = PickLiftParams()


def _admitted(object_model, scene, n=3):  # type: ignore[no-untyped-def]
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
    together = pick_lift_rows(object_model, scene, admitted, PARAMS, MOTION, PHYSICS)
    backwards = pick_lift_rows(object_model, scene, admitted[::-1], PARAMS, MOTION, PHYSICS)
    alone = [row for grasp in admitted for row in pick_lift_rows(object_model, scene, [grasp], PARAMS, MOTION, PHYSICS)]
    assert len(admitted) >= 2
    assert together == backwards[::-1] == alone


def test_a_hand_that_closes_beside_the_object_lifts_nothing() -> None:
    object_model = can_model()
    scene = scene_of(object_model)
    admitted = _admitted(object_model, scene, 1)
    aside = dataclasses.replace(scene, T_base_object=standing(np.array([0.55, -0.4]), 0.0) @ object_model.stable_poses[0].T_plane_object)
    (row,) = pick_lift_rows(object_model, aside, admitted, PARAMS, MOTION, PHYSICS)
    assert row["lift_status"] == "not_lifted"


def test_a_hand_that_shoves_the_object_away_is_told_apart() -> None:
    """The hand comes down 5 cm beside the middle: a finger pushes the can over or away before it closes."""
    object_model = can_model()
    scene = scene_of(object_model)
    (grasp,) = _admitted(object_model, scene, 1)
    T = scene.T_base_object.copy()
    T[:3, 3] += 0.05 * grasp.T_base_grasp[:3, 1]
    (row,) = pick_lift_rows(object_model, dataclasses.replace(scene, T_base_object=T), [grasp], PARAMS, MOTION, PHYSICS)
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
    (row,) = pick_lift_rows(object_model, scene, _admitted(object_model, scene), PARAMS, MOTION, PHYSICS)
    assert row["lift_status"] in ("slipped", "not_lifted")
    assert row["lift_slip_rad"] > PARAMS.max_slip_rad


def test_a_lift_out_of_reach_is_an_error_that_names_the_grasp() -> None:
    object_model = can_model()
    scene = scene_of(object_model)
    (grasp,) = _admitted(object_model, scene, 1)
    with pytest.raises(PhysicsError, match=f"full-0000-g{grasp.grasp_id:02d}.*cannot follow"):
        pick_lift_rows(object_model, scene, [grasp], PickLiftParams(lift_m=1.0), MOTION, PHYSICS)


def test_a_grasp_of_no_pool_is_an_error() -> None:
    object_model = can_model()
    scene = scene_of(object_model)
    (grasp,) = _admitted(object_model, scene, 1)
    stranger = AdmittedGrasp(63, grasp.T_base_grasp, grasp.pregrasp_q_rad, grasp.grasp_q_rad)
    with pytest.raises(ObjectError, match="test_can: grasp 63, must be one of"):
        pick_lift_rows(object_model, scene, [stranger], PARAMS, MOTION, PHYSICS)


@pytest.mark.parametrize(("field", "value"), [("lift_m", 0.0), ("min_rise_m", 0.12), ("max_slip_rad", -1.0)])
def test_params_are_valid_from_birth(field: str, value: float) -> None:
    with pytest.raises(ValueError, match=field):
        PickLiftParams(**{field: value})
