"""The held object's engine against mechanics: geometry, rest, free flight, inertia forces, impulses, grips; its bits and its errors."""

from __future__ import annotations

import hashlib
import subprocess
import sys

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from objects.object_model import ObjectModel
from pipelines.engines.physics.coming_to_rest import settle
from pipelines.engines.physics.errors import PhysicsError
from pipelines.engines.physics.hand_bodies import FINGERS
from pipelines.engines.physics.hand_model import Carrier, build_model
from pipelines.engines.physics.hand_motion import hand_motion
from pipelines.engines.physics.hand_params import HandWorldParams
from pipelines.engines.physics.hand_rollout import close_fingers, hold, move, open_fingers
from pipelines.engines.physics.hand_world import GRAVITY_M_S2, HandWorld
from pipelines.engines.physics.phases import Phase, pose_difference
from pipelines.engines.planning.trajectory import MotionParams, Trajectory, time_path
from pipelines.engines.robot.arm import HOME_Q_RAD, fk, follow_line
from pipelines.values import Obstacle
from tables.poses import inverse, matrix_of
from tests.pipelines.engines.physics.object_models import can_model, cuboid_model, mug_model

MODELS = [can_model(), cuboid_model(), mug_model()]
PARAMS = HandWorldParams()
FAST = MotionParams(velocity_scale=1.0, acceleration_scale=1.0, jerk_scale=0.3)
FAR_Q_RAD = HOME_Q_RAD + np.array([0.9, 0.3, 0.3, 0.4, 0.5, -0.4, 0.8])


def _swing(dt_s: float = PARAMS.dt_s) -> Trajectory:
    """At the joints' limits there and back: every joint turns."""
    return time_path(np.stack([HOME_Q_RAD, FAR_Q_RAD, HOME_Q_RAD]), FAST, dt_s, stop_at_waypoints=True)


def _taken(world: HandWorld, grasp_id: int, label: str = "test") -> None:
    grasp = world.object_model.grasps[grasp_id]
    world.start_taking(label, HOME_Q_RAD, grasp.jaw_width_m / 2 + 0.002, inverse(grasp.T_object_grasp), 0.2)


def _run(world: HandWorld, grasp_id: int) -> bytes:
    """Take, swing, set down nothing, open, fall, settle: every model and every kind of contact."""
    _taken(world, grasp_id)
    move(world, Phase.TRANSPORT, _swing())
    open_fingers(world, 0.08, 0.5)
    q, fingers_m = world.arm_state()
    world.remove_hand()
    settle(world, 240)
    return np.concatenate([world.object_pose().ravel(), q, fingers_m, [world.n_steps, world.impulse_n_s("object", "table")]]).tobytes()


@pytest.mark.parametrize("carrier", list(Carrier))
@pytest.mark.parametrize("object_model", MODELS, ids=lambda m: m.object_id)
def test_parts_mass_and_inertia_are_where_the_object_has_them(object_model: ObjectModel, carrier: Carrier) -> None:
    """MuJoCo moves meshes to axes of their own: the vertices that it collides must still be the parts'."""
    scene = build_model(object_model, (), PARAMS, carrier)
    m = scene.model
    for k, part in enumerate(object_model.parts):
        geom = m.geom(f"part {k}")
        R = Rotation.from_quat(geom.quat[[1, 2, 3, 0]]).as_matrix()
        if geom.type[0] == mujoco.mjtGeom.mjGEOM_BOX:
            corners = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3) * geom.size
        else:
            first, n = m.mesh_vertadr[geom.dataid[0]], m.mesh_vertnum[geom.dataid[0]]
            corners = m.mesh_vert[first : first + n].astype(float)
        placed = corners @ R.T + geom.pos
        gaps = np.linalg.norm(placed[:, None] - part.vertices_m, axis=-1)
        assert gaps.min(axis=0).max() < 1e-7
        assert gaps.min(axis=1).max() < 1e-7
    body = m.body("object")
    R = Rotation.from_quat(body.iquat[[1, 2, 3, 0]]).as_matrix()
    assert body.mass[0] == pytest.approx(object_model.mass_kg)
    np.testing.assert_allclose(body.ipos, object_model.com_m, atol=1e-12)
    np.testing.assert_allclose(R @ np.diag(body.inertia) @ R.T, object_model.inertia_kg_m2, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("object_model", MODELS, ids=lambda m: m.object_id)
def test_objects_rest_where_their_stable_poses_say(object_model: ObjectModel) -> None:
    for pose in object_model.stable_poses:
        T = pose.T_plane_object.copy()
        T[0, 3] = 0.5
        with HandWorld(object_model, (), PARAMS) as world:
            world.start_open("rest", HOME_Q_RAD, 0.04, T)
            world.remove_hand()
            hold(world, Phase.SETTLE, 0.5)
            drift_m, turn_rad = pose_difference(T, world.object_pose())
            assert abs(world.object_pose()[2, 3] - T[2, 3]) < 5e-5
            assert drift_m < 1e-4
            assert turn_rad < 2e-3


def test_pads_yield_as_stated_whatever_the_object_weighs() -> None:
    for mass_kg in (0.03, 0.5):
        for n in (3, 5):
            params = HandWorldParams(cells_per_side=n)
            with HandWorld(cuboid_model(mass_kg=mass_kg), (), params) as world:
                world.start_taking("press", HOME_Q_RAD, 0.032, _between_the_pads(), 0.4)
                mujoco.mj_forward(world._state.at.model, world._state.data)
                contacts = [
                    c
                    for c in world._state.data.contact
                    if " cell " in world._state.at.model.geom(c.geom2).name + world._state.at.model.geom(c.geom1).name
                ]
                assert len(contacts) == 2 * n * n
                wanted_m = params.finger_force_n / params.pad_stiffness_n_m
                np.testing.assert_allclose([-c.dist for c in contacts], wanted_m, rtol=0.02)


def _between_the_pads() -> np.ndarray:
    """The carton with its 60 mm between the pads, weightless."""
    T = np.eye(4)
    T[:3, :3] = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    T[2, 3] = 0.045  # below the palm
    return T


def test_hand_motion_is_the_derivative_of_forward_kinematics() -> None:
    """A smooth joint motion whose derivatives are known, sampled at ticks; forward kinematics differentiated 64 times finer."""
    dt_s, n, amplitude, rate = PARAMS.dt_s, 120, FAR_Q_RAD - HOME_Q_RAD, 8.0

    def q(t: np.ndarray) -> np.ndarray:
        return HOME_Q_RAD + np.outer(1.0 - np.cos(rate * t), amplitude)

    t = np.arange(n + 1) * dt_s
    qd = np.outer(rate * np.sin(rate * t), amplitude)
    motion = hand_motion(Trajectory(q(t), qd, float(t[-1])), dt_s)
    middle, h = t[:-1] + dt_s / 2, dt_s / 64
    before, now, after = (fk(q(middle + s)) for s in (-h, 0.0, h))
    R = now[:, :3, :3]
    a = np.einsum("nji,nj->ni", R, (after[:, :3, 3] - 2 * now[:, :3, 3] + before[:, :3, 3]) / h**2)
    w = np.einsum(
        "nij,nj->ni", _transposed(R) @ before[:, :3, :3], Rotation.from_matrix(_transposed(before) @ after[:, :3, :3]).as_rotvec()
    )
    assert np.abs(a).max() > 40.0
    assert np.abs(motion.acceleration_m_s2 - a).max() < 0.01 * np.abs(a).max()
    assert np.abs(motion.rate_rad_s - w / (2 * h)).max() < 0.01 * np.abs(w / (2 * h)).max()
    alpha = np.gradient(np.einsum("nij,nj->ni", R, w / (2 * h)), dt_s, axis=0)[1:-1]
    assert np.abs(np.einsum("nij,nj->ni", R, motion.angular_acceleration_rad_s2)[1:-1] - alpha).max() < 0.03 * np.abs(alpha).max()


def _transposed(T: np.ndarray) -> np.ndarray:
    return np.swapaxes(T[:, :3, :3], 1, 2)


@pytest.mark.parametrize("object_model", MODELS[1:], ids=lambda m: m.object_id)
def test_what_the_turning_hand_loses_flies_on_a_parabola(object_model: ObjectModel) -> None:
    """An object left in the open, turning hand: inertia forces, hand-over to the base frame and free flight against mechanics."""
    T0 = fk(HOME_Q_RAD)
    T_tcp_object = np.eye(4)
    T_tcp_object[:3, 3] = 0.0, 0.0, -0.4  # behind the palm, so that it can fall
    with HandWorld(object_model, (), PARAMS) as world:
        world.start_open("lost", HOME_Q_RAD, 0.04, T0 @ T_tcp_object)
        start = (T0 @ T_tcp_object @ np.array([*object_model.com_m, 1.0]))[:3]
        move(world, Phase.TRANSPORT, _swing())
        assert world.is_lost
        handed_over, at = world.n_steps, world.object_pose()
        for _ in range(60):
            world.step()
        now = (world.object_pose() @ np.array([*object_model.com_m, 1.0]))[:3]
        # Semi-implicit Euler steps by the speed at a step's end: a fall of n steps is one of n (n + 1).
        t, h = (handed_over + 60) * PARAMS.dt_s, PARAMS.step_s
        fallen = start - np.array([0.0, 0.0, 0.5 * GRAVITY_M_S2 * t * (t + h)])
        assert np.abs(now - fallen).max() < 1e-4
        assert handed_over <= 4
        assert pose_difference(at, world.object_pose())[1] < 1e-3  # nothing turned it


def test_a_spinning_object_in_the_turning_hand_keeps_its_angular_momentum() -> None:
    object_model = MODELS[2]
    T = fk(HOME_Q_RAD)
    T[:3, 3] -= T[:3, 2] * 0.5
    trajectory = _swing()
    motion = hand_motion(trajectory, PARAMS.dt_s)
    with HandWorld(object_model, (), PARAMS) as world:
        world.start_open("spin", HOME_Q_RAD, 0.04, T)
        world.begin_motion(motion)
        world._state.data.qvel[world._state.at.object_v + 3 : world._state.at.object_v + 6] = 3.0, -2.0, 4.0

        def momentum() -> np.ndarray:
            R = world.object_pose()[:3, :3]
            _, w = world._state.object_twist()
            return R @ object_model.inertia_kg_m2 @ w

        before = momentum()
        for k in range(40):
            world._untouched = 0  # keep it in the turning frame
            world.step_along(motion, k, trajectory.q_rad[k + 1])
        assert np.abs(motion.rate_rad_s[:40]).max() > 1.0
        assert np.linalg.norm(momentum() - before) < 0.02 * np.linalg.norm(before)


def test_impulse_of_a_landing_is_weight_times_time() -> None:
    """From rest to rest the table gives back all that gravity has: a peak that a look once a tick would miss would be missing."""
    object_model = MODELS[1]
    T = object_model.stable_poses[0].T_plane_object.copy()
    T[:3, 3] += 0.5, 0.0, 0.03
    with HandWorld(object_model, (), PARAMS) as world:
        world.start_open("landing", HOME_Q_RAD, 0.04, T)
        world.remove_hand()
        hold(world, Phase.SETTLE, 1.0)
        wanted = object_model.mass_kg * GRAVITY_M_S2 * world.n_steps * PARAMS.dt_s
        assert world.impulse_n_s("object", "table") == pytest.approx(wanted, rel=0.01)
        assert world.impulse_n_s("robot", "table") == 0.0


@pytest.mark.parametrize("object_model", MODELS, ids=lambda m: m.object_id)
def test_a_hold_is_restarted_from_what_is_saved(object_model: ObjectModel) -> None:
    with HandWorld(object_model, (), PARAMS) as world:
        _taken(world, 1)
        hold(world, Phase.HOLD, 0.3)
        assert pose_difference(inverse(object_model.grasps[1].T_object_grasp), world.inhand_pose())[0] < 1e-3  # it is held
        (q, fingers_m), T = world.arm_state(), world.inhand_pose()
    with HandWorld(object_model, (), PARAMS) as world:
        world.start_held("again", q, fingers_m.tolist(), T)
        hold(world, Phase.HOLD, 0.25)
        assert pose_difference(T, world.inhand_pose())[0] < 2e-5


def test_pick_lift_transport_and_release_of_a_carton() -> None:
    object_model = MODELS[1]
    T_object = object_model.stable_poses[0].T_plane_object.copy()
    T_object[:3, 3] += 0.5, 0.0, 0.0
    T_grasp = T_object @ object_model.grasps[0].T_object_grasp
    q = _solve(T_grasp)
    up = T_grasp.copy()
    up[2, 3] += 0.12
    line = follow_line(T_grasp, up, q, 0.0025, 0.35)
    assert line is not None
    with HandWorld(object_model, (), PARAMS) as world:
        world.start_open("lift", line[-1], 0.04, T_object)
        move(world, Phase.APPROACH, time_path(line[::-1], MotionParams(), PARAMS.dt_s, stop_at_waypoints=False))
        assert pose_difference(world.object_pose(), T_object)[0] < 1e-4
        assert close_fingers(world, 0.8)
        hold(world, Phase.CLOSE, 0.1)
        T_closed = world.inhand_pose()
        move(world, Phase.LIFT, time_path(line, MotionParams(), PARAMS.dt_s, stop_at_waypoints=False))
        assert world.object_pose()[2, 3] - T_object[2, 3] == pytest.approx(0.12, abs=1e-3)
        swing = np.stack([line[-1], line[-1] + np.array([0.5, 0.0, 0.2, 0.0, 0.3, 0.0, 0.4]), line[-1]])
        assert move(world, Phase.TRANSPORT, time_path(swing, MotionParams(), PARAMS.dt_s, stop_at_waypoints=True))
        assert pose_difference(T_closed, world.inhand_pose())[0] < 8e-4
        move(world, Phase.DESCEND, time_path(line[::-1], MotionParams(), PARAMS.dt_s, stop_at_waypoints=False))
        before = world.arm_state()[1]
        opened = []
        world.command_fingers(PARAMS.finger_speed_m_s)
        for _ in range(40):
            world.step()
            opened.append(world.arm_state()[1])
        rates = np.diff([before, *opened], axis=0) / PARAMS.dt_s
        assert rates.max() < 1.2 * PARAMS.finger_speed_m_s  # pads that are let go do not throw the fingers
        assert np.abs(np.diff(opened, axis=1)).max() < 2e-5  # nor one before the other
        assert pose_difference(world.object_pose(), T_object)[0] < 1e-3


def _solve(T: np.ndarray) -> np.ndarray:
    from pipelines.engines.robot.arm import ik

    solutions = ik(T, 32)
    return solutions[np.argmin(np.abs(solutions - HOME_Q_RAD).max(axis=1))]


def test_same_bits_in_any_order_and_process() -> None:
    with HandWorld(MODELS[0], (), PARAMS) as world:
        first = _run(world, 1)
        other = _run(world, 3)
        assert _run(world, 1) == first
        assert other != first
    with HandWorld(MODELS[2], (), PARAMS) as world:
        _run(world, 0)
    with HandWorld(MODELS[0], (), PARAMS) as world:
        assert _run(world, 3) == other
        assert _run(world, 1) == first
    code = (
        "from tests.pipelines.engines.physics.test_hand_world import *\nfrom tests.pipelines.engines.physics.test_hand_world import _run\n"
        "with HandWorld(MODELS[0], (), PARAMS) as world: print(hashlib.sha256(_run(world, 1)).hexdigest())"
    )
    fresh = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()[-1]
    assert fresh == hashlib.sha256(first).hexdigest()


def test_a_hand_that_presses_on_the_table_stops() -> None:
    """Down by 60 mm with its object on the table: the arm stops by itself, and the force stays that of a jam of a tick."""
    object_model = MODELS[1]
    T_object = object_model.stable_poses[1].T_plane_object.copy()
    T_object[:3, 3] += 0.5, 0.0, 0.0
    T_start = matrix_of(np.array([0.5, 0.0, T_object[2, 3] + 0.13, 1.0, 0.0, 0.0, 0.0]))
    T_end = T_start.copy()
    T_end[2, 3] = 0.02
    line = follow_line(T_start, T_end, _solve(T_start), 0.0025, 0.35)
    assert line is not None
    with HandWorld(object_model, (), PARAMS) as world:
        world.start_open("jam", line[0], 0.01, T_object)
        done = move(world, Phase.DESCEND, time_path(line, MotionParams(), PARAMS.dt_s, stop_at_waypoints=False))
        assert not done
        assert world.is_stopped
        assert world.n_steps < len(line) * 100
        assert 0.0 < world.impulse_n_s("object", "table") < 10.0


def test_what_the_engine_cannot_answer_for_is_an_error_with_the_label() -> None:
    with HandWorld(MODELS[1], (), PARAMS) as world:
        _taken(world, 0, "full-0000-t0-g00")
        world._state.data.qvel[world._state.at.object_v] = 1e12
        with pytest.raises(PhysicsError, match=r"full-0000-t0-g00.*warned"):
            hold(world, Phase.HOLD, 0.1)
        _taken(world, 0, "full-0000-t0-g01")
        world._state.data.qpos[world._state.at.object_q] = np.nan
        with pytest.raises(PhysicsError, match="full-0000-t0-g01"):
            hold(world, Phase.HOLD, 0.1)
        _taken(world, 0, "full-0000-t0-g02")
        with pytest.raises(PhysicsError, match="full-0000-t0-g02: a motion starts"):
            move(world, Phase.TRANSPORT, time_path(np.stack([FAR_Q_RAD, HOME_Q_RAD]), FAST, PARAMS.dt_s, stop_at_waypoints=True))


def test_collisions_of_the_held_object_with_an_obstacle_are_felt() -> None:
    """An obstacle in the way of the swing: its impulse is counted while the hand turns, and none without it."""
    T = fk(HOME_Q_RAD)
    turned = fk(HOME_Q_RAD + np.array([0.3, 0, 0, 0, 0, 0, 0]))
    obstacle = Obstacle(0, matrix_of(np.array([*turned[:2, 3], T[2, 3] + 0.02, 0.0, 0.0, 0.0, 1.0])), np.array([0.05, 0.05, 0.1]))
    sums = []
    for obstacles in ((), (obstacle,)):
        with HandWorld(MODELS[0], obstacles, PARAMS) as world:
            _taken(world, 1)
            q = np.stack([HOME_Q_RAD, HOME_Q_RAD + np.array([0.6, 0, 0, 0, 0, 0, 0])])
            move(world, Phase.TRANSPORT, time_path(q, MotionParams(), PARAMS.dt_s, stop_at_waypoints=True))
            sums.append(sum(world.impulse_n_s("object", name) + world.impulse_n_s("robot", name) for name in world.fixed_bodies))
    assert sums[0] == 0.0
    assert sums[1] > 0.02


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"finger_force_n": 20.0}, "finger_force_n = 20.0"),
        ({"pad_lever_scale": 1.3}, "pad_lever_scale = 1.3"),
        ({"cells_per_side": 4}, "cells_per_side = 4"),
        ({"steps_per_tick": 1}, "steps_per_tick"),
        ({"pad_stiffness_n_m": 0.0}, "pad_stiffness_n_m = 0.0"),
    ],
)
def test_parameters_out_of_bounds_are_refused(changes: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        HandWorldParams(**changes)  # type: ignore[arg-type]


def test_fingers_are_the_two_that_press() -> None:
    with HandWorld(MODELS[1], (), PARAMS) as world:
        _taken(world, 0)
        assert all(world.touching(finger) for finger in FINGERS)
        assert not world.touching("panda_hand")
