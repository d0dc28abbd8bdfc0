"""The turning hand as a frame: its motion against forward kinematics, what is free in it against the laws of mechanics."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from objects.object_model import ObjectModel
from pipelines.engines.physics.hand_motion import hand_motion
from pipelines.engines.physics.hand_rollout import move
from pipelines.engines.physics.hand_world import GRAVITY_M_S2, HandWorld
from pipelines.engines.physics.phases import Phase, pose_difference
from pipelines.engines.planning.trajectory import Trajectory
from pipelines.engines.robot.arm import HOME_Q_RAD, fk
from tests.pipelines.engines.physics.hand_runs import FAR_Q_RAD, MODELS, PARAMS, swing


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
        move(world, Phase.TRANSPORT, swing())
        assert world.is_lost
        # The state can still be told: the hand is where it left.
        q, fingers_m = world.arm_state()
        assert np.abs(fk(q) - world.tcp_pose()).max() < 1e-9
        assert np.abs(fingers_m - 0.04).max() < 1e-4
        handed_over, at = world.n_steps, world.object_pose()
        for _ in range(60):
            world.step()
        now = (world.object_pose() @ np.array([*object_model.com_m, 1.0]))[:3]
        # Semi-implicit Euler steps by the speed at a step's end: a fall of n steps is one of n (n + 1). Alone, steps are finer.
        t, h = handed_over * PARAMS.dt_s, PARAMS.step_s
        alone_s, fine_s = 60 * PARAMS.dt_s, PARAMS.dt_s / PARAMS.landing_steps_per_tick
        twice_m = GRAVITY_M_S2 * (t * (t + h) + 2 * t * alone_s + alone_s * (alone_s + fine_s))
        fallen = start - np.array([0.0, 0.0, 0.5 * twice_m])
        assert np.abs(now - fallen).max() < 1e-4
        assert handed_over <= 4
        assert pose_difference(at, world.object_pose())[1] < 1e-3  # nothing turned it


def test_a_spinning_object_in_the_turning_hand_keeps_its_angular_momentum() -> None:
    object_model = MODELS[2]
    T = fk(HOME_Q_RAD)
    T[:3, 3] -= T[:3, 2] * 0.5
    trajectory = swing()
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
