"""Theory of a grip without an engine: patches follow from geometry, demand from the load; both against what can be worked out by hand."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from objects.object_model import ObjectModel
from pipelines.engines.physics.hand_motion import HandMotion
from pipelines.engines.physics.hand_params import HandWorldParams
from pipelines.engines.physics.hand_world import GRAVITY_M_S2
from pipelines.engines.physics.pads import PAD_SIZE_M, even_pressure_lever_m, winkler_lever_m
from pipelines.proofs.validity.contact_patch import ContactPatch, contact_patch
from pipelines.proofs.validity.demand import capacity_n, carried, demand_ratio, demand_ratio_even_pads
from pipelines.values import LiftedGrasp
from tests.pipelines.engines.physics.lifted import MOTION, lifted
from tests.pipelines.engines.physics.object_models import can_model, cuboid_model

PARAMS = HandWorldParams()


def held(x_m: float = 0.0, z_m: float = 0.0, turn_z_rad: float = 0.0, turn_x_rad: float = 0.0) -> np.ndarray:
    """T_tcp_object: the object's axes along the hand's, moved, and turned about the hand's z and x."""
    c, s, cx, sx = math.cos(turn_z_rad), math.sin(turn_z_rad), math.cos(turn_x_rad), math.sin(turn_x_rad)
    T = np.eye(4)
    T[:3, :3] = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ np.array([[1.0, 0.0, 0.0], [0.0, cx, -sx], [0.0, sx, cx]])
    T[:3, 3] = x_m, 0.0, z_m
    return T


def patch_of(object_model: ObjectModel, T: np.ndarray, params: HandWorldParams = PARAMS) -> ContactPatch:
    patch = contact_patch(object_model, T, params)
    assert patch is not None
    return patch


def test_a_flat_face_has_the_stated_lever_and_no_preload() -> None:
    patch = patch_of(cuboid_model((0.09, 0.06, 0.14)), held())
    for lever_m in patch.levers_m:
        assert lever_m == pytest.approx(even_pressure_lever_m(*PAD_SIZE_M), rel=0.01)
    np.testing.assert_allclose(patch.preload_n, 0.0, atol=1e-9)
    np.testing.assert_allclose(patch.centre_m[[0, 1]], 0.0, atol=1e-9)
    scaled = patch_of(cuboid_model((0.09, 0.06, 0.14)), held(), HandWorldParams(pad_lever_scale=0.85))
    assert scaled.levers_m[0] == pytest.approx(0.85 * patch.levers_m[0])


def test_half_a_face_has_its_pressure_on_that_half() -> None:
    """The object ends in the middle of the pads: what is left is 8.75 mm wide, and its centre a quarter of the pad to the side."""
    patch = patch_of(cuboid_model((0.09, 0.06, 0.14)), held(x_m=0.045))
    assert patch.centre_m[0] == pytest.approx(PAD_SIZE_M[0] / 4, rel=0.03)
    assert patch.levers_m[0] == pytest.approx(even_pressure_lever_m(PAD_SIZE_M[0] / 2, PAD_SIZE_M[1]), rel=0.03)


def test_a_can_touches_along_a_strip() -> None:
    """The object is a 48-gon, theory's a cylinder; that is 1 % of the lever."""
    theory_m = winkler_lever_m(0.033, True, PARAMS.finger_force_n, PARAMS.pad_stiffness_n_m)
    assert patch_of(can_model(), held()).levers_m[0] == pytest.approx(theory_m, rel=0.02)
    across = winkler_lever_m(0.033, False, PARAMS.finger_force_n, PARAMS.pad_stiffness_n_m)
    T = np.eye(4)
    T[:3, :3] = [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]
    assert patch_of(can_model(), T).levers_m[0] == pytest.approx(across, rel=0.02)


@pytest.mark.parametrize(("turn_z_rad", "turn_x_rad", "axis"), [(0.1, 0.0, 0), (0.0, 0.1, 1), (0.2, 0.0, 0)])
def test_a_grip_askew_preloads_its_friction(turn_z_rad: float, turn_x_rad: float, axis: int) -> None:
    """Pads on opposite edges of a turned slab: the couple of the normal forces over the width is friction's."""
    slab = cuboid_model((0.016, 0.04, 0.016))
    patch = patch_of(slab, held(turn_z_rad=turn_z_rad, turn_x_rad=turn_x_rad))
    angle = turn_z_rad or turn_x_rad
    # Corners at (+-8, +-20) mm turned by the angle. A wedge of pad of length l is pressed in, its centre a third of it from the corner.
    arm_m, width_m = 0.016 * math.cos(angle) - 0.04 * math.sin(angle), 0.016 * math.sin(angle) + 0.04 * math.cos(angle)
    stiffness_n_m3 = PARAMS.pad_stiffness_n_m / (PAD_SIZE_M[0] * PAD_SIZE_M[1])
    wedge_m = math.sqrt(2 * PARAMS.finger_force_n / (stiffness_n_m3 * 0.016 * angle))
    expected = PARAMS.finger_force_n * (arm_m - 2 / 3 * wedge_m) / width_m
    assert abs(patch.preload_n[axis]) == pytest.approx(expected, rel=0.1)
    assert patch.preload_n[1 - axis] == pytest.approx(0.0, abs=1e-6)
    assert patch.levers_m[0] < 0.006


def test_a_hold_beside_the_pads_has_no_patch() -> None:
    assert contact_patch(cuboid_model((0.09, 0.06, 0.14)), held(x_m=0.06), PARAMS) is None


def still(n: int = 3) -> HandMotion:
    """A hand at rest that points down."""
    case = lifted("can")
    moving = carried(case.planned[0][1], MOTION, PARAMS.dt_s)[0]
    zero = np.zeros((n, 3))
    R = np.broadcast_to(np.diag([1.0, -1.0, -1.0]), (n, 3, 3))
    return dataclasses.replace(
        moving, R_mid=R, acceleration_m_s2=zero, rate_rad_s=zero, angular_acceleration_rad_s2=zero, position_gain_1_s2=np.zeros((n, 3, 3))
    )


@pytest.mark.parametrize("x_m", [0.0, 0.01, -0.02])
def test_demand_of_a_resting_hand_is_the_weight(x_m: float) -> None:
    """Weight along the fingers, its arm about the jaw axis the distance of the centre of mass from the centre of pressure."""
    model = cuboid_model((0.09, 0.06, 0.14))
    T = held(x_m=x_m)
    patch, whole_n = patch_of(model, T), capacity_n(model, PARAMS)
    grasp = LiftedGrasp(0, np.zeros(7), np.zeros(2), np.eye(4), T)
    weight_n = model.mass_kg * GRAVITY_M_S2
    expected = weight_n / whole_n * math.hypot(1.0, (x_m - patch.centre_m[0]) / even_pressure_lever_m(*PAD_SIZE_M))
    assert demand_ratio(patch, model, grasp, [still()], PARAMS) == pytest.approx(expected, rel=0.01)
    even = weight_n / whole_n * math.hypot(1.0, x_m / even_pressure_lever_m(*PAD_SIZE_M))
    assert demand_ratio_even_pads(model, grasp, [still()], PARAMS) == pytest.approx(even, rel=0.01)


def test_what_a_grip_takes_by_itself_is_added_on_one_pad() -> None:
    model = cuboid_model((0.09, 0.06, 0.14))
    grasp = LiftedGrasp(0, np.zeros(7), np.zeros(2), np.eye(4), held())
    free, pad_n = patch_of(model, held()), capacity_n(model, PARAMS) / 2
    askew = dataclasses.replace(free, preload_n=np.array([0.0, 0.5 * pad_n]))
    alone = demand_ratio(free, model, grasp, [still()], PARAMS)
    assert demand_ratio(askew, model, grasp, [still()], PARAMS) == pytest.approx(alone + 0.5)


def test_a_heavier_object_asks_for_more_of_the_same_motion() -> None:
    case = lifted("cuboid")
    candidate, motion = case.planned[0]
    hands = carried(motion, MOTION, PARAMS.dt_s)
    light, heavy = (cuboid_model(mass_kg=mass) for mass in (0.3, 0.6))
    patch = patch_of(light, candidate.grasp.T_tcp_object)
    patch = dataclasses.replace(patch, preload_n=np.zeros(2))
    ratio = demand_ratio(patch, light, candidate.grasp, hands, PARAMS)
    assert 0.05 < ratio < 1.0
    assert demand_ratio(patch, heavy, candidate.grasp, hands, PARAMS) == pytest.approx(2.0 * ratio)
