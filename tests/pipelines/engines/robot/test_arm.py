"""Forward and inverse kinematics of the Panda against pinocchio and pybullet, and the laws of straight lines."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pybullet
import pybullet_data
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pybullet_utils.bullet_client import BulletClient

from pipelines.engines.robot.arm import HOME_Q_RAD, IK_TOLERANCE, Q_LOWER_RAD, Q_UPPER_RAD, fk, follow_line, ik
from pipelines.engines.robot.geometry import panda
from tables.poses import matrix_of
from tests.builders import tcp_pose

LINE_STEP_M, MAX_JUMP_RAD = 0.0025, 0.1
URDF = f"{pybullet_data.getDataPath()}/franka_panda/panda.urdf"


def configurations(n: int, seed: int, q4_max_rad: float = Q_UPPER_RAD[3]) -> np.ndarray:
    upper = Q_UPPER_RAD.copy()
    upper[3] = q4_max_rad
    return np.random.default_rng(seed).uniform(Q_LOWER_RAD, upper, (n, 7))


def test_forward_kinematics_agree_with_pinocchio_and_pybullet() -> None:
    """Three engines, two descriptions of the robot; pybullet computes poses in single precision."""
    robot = panda()
    data = robot.model.createData()
    client = BulletClient(pybullet.DIRECT)
    arm = client.loadURDF(URDF, useFixedBase=True)
    T_hand_tcp = np.eye(4)
    T_hand_tcp[2, 3] = 0.1034
    for q in configurations(200, 1):
        pin.forwardKinematics(robot.model, data, np.concatenate([q, [0.0, 0.0]]))
        np.testing.assert_allclose(fk(q), data.oMi[7].homogeneous @ robot.T_link7_tcp, atol=1e-9)
        for joint in range(7):
            client.resetJointState(arm, joint, float(q[joint]))
        state = client.getLinkState(arm, 8, computeForwardKinematics=True)
        np.testing.assert_allclose(fk(q), matrix_of(np.array([*state[4], *state[5]])) @ T_hand_tcp, atol=2e-6)
    client.disconnect()


def test_limits_are_the_real_robots_and_narrower_than_the_urdfs() -> None:
    model = panda().model
    assert np.all(model.lowerPositionLimit[:7] < Q_LOWER_RAD)
    assert np.all(model.upperPositionLimit[:7] > Q_UPPER_RAD)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_every_solution_reaches_its_pose_within_limits(seed: int) -> None:
    T = fk(configurations(1, seed)[0])
    solutions = ik(T, 8)
    assert solutions.shape[1:] == (7,)
    for q in solutions:
        assert np.all((q >= Q_LOWER_RAD) & (q <= Q_UPPER_RAD))
        assert np.abs(fk(q) - T).max() <= IK_TOLERANCE
    assert np.all(np.diff(solutions[:, 6]) >= 0.0)
    np.testing.assert_array_equal(solutions, ik(T, 8))


def test_a_configuration_is_found_again_from_its_pose() -> None:
    """A line that goes nowhere ends where it starts: among the branches at the same q7 is the configuration itself.

    The closed form covers q4 < -0.467 rad; next to its singularities (2 in 1,000) digits run out and nothing is returned.
    """
    found = []
    for q in configurations(2000, 2, q4_max_rad=-0.467):
        line = follow_line(fk(q), fk(q), q, LINE_STEP_M, MAX_JUMP_RAD)
        found.append(line is not None and float(np.abs(line[-1] - q).max()) < 1e-5)
    assert np.mean(found) > 0.99


def test_a_finer_grid_finds_no_other_reachable_poses() -> None:
    """Poses over the table as placing meets them: reach found by 32 cells is reach found by 128."""
    rng = np.random.default_rng(3)
    reach = []
    for _ in range(150):
        yaw, tilt = rng.uniform(-np.pi, np.pi), rng.uniform(0.0, np.pi / 2)
        approach = np.array([np.sin(tilt) * np.cos(yaw), np.sin(tilt) * np.sin(yaw), -np.cos(tilt)])
        jaw = np.cross(approach, rng.normal(size=3))
        T = tcp_pose(rng.uniform([0.3, -0.4, 0.02], [0.7, 0.4, 0.3]), approach, jaw)
        reach.append((len(ik(T, 32)) > 0, len(ik(T, 128)) > 0))
    assert 0.2 < np.mean([fine for _, fine in reach]) < 1.0
    assert sum(coarse != fine for coarse, fine in reach) <= 2


@given(st.integers(0, 2**32 - 1), st.floats(0.01, 0.15))
@settings(max_examples=60, deadline=None)
def test_a_line_is_straight_and_continuous(seed: int, length_m: float) -> None:
    rng = np.random.default_rng(seed)
    q_start = HOME_Q_RAD + rng.uniform(-0.4, 0.4, 7)
    T_start = fk(q_start)
    direction = rng.normal(size=3)
    T_end = T_start.copy()
    T_end[:3, 3] += length_m * direction / np.linalg.norm(direction)
    line = follow_line(T_start, T_end, q_start, LINE_STEP_M, MAX_JUMP_RAD)
    if line is None:
        return
    T = fk(line)
    way = T[:, :3, 3] - T_start[:3, 3]
    along = way @ (direction / np.linalg.norm(direction))
    np.testing.assert_array_equal(line[0], q_start)
    np.testing.assert_allclose(way - along[:, None] * direction / np.linalg.norm(direction), 0.0, atol=2e-6)
    np.testing.assert_allclose(T[:, :3, :3], np.broadcast_to(T_start[:3, :3], T[:, :3, :3].shape), atol=2e-6)
    np.testing.assert_allclose(along[-1], length_m, atol=2e-6)
    assert np.all(np.diff(along) > 0.0)
    assert np.diff(along).max() <= LINE_STEP_M + 2e-6
    assert np.abs(np.diff(line, axis=0)).max() <= MAX_JUMP_RAD
    assert np.all(line[:, 6] == q_start[6])
    assert np.all((line[1:] >= Q_LOWER_RAD) & (line[1:] <= Q_UPPER_RAD))


def test_most_lines_over_the_table_can_be_followed() -> None:
    """Guards the law above against passing on nothing."""
    T_start = fk(HOME_Q_RAD)
    for step in np.vstack([np.eye(3), -np.eye(3)]) * 0.1:
        T_end = T_start.copy()
        T_end[:3, 3] += step
        line = follow_line(T_start, T_end, HOME_Q_RAD, LINE_STEP_M, MAX_JUMP_RAD)
        assert line is not None
        assert len(line) == 41


def test_a_line_out_of_reach_is_none_and_a_wrong_start_an_error() -> None:
    T_start = fk(HOME_Q_RAD)
    T_end = T_start.copy()
    T_end[0, 3] += 1.0
    assert follow_line(T_start, T_end, HOME_Q_RAD, LINE_STEP_M, MAX_JUMP_RAD) is None
    with pytest.raises(ValueError, match="start missed"):
        follow_line(T_start, T_start, HOME_Q_RAD + 0.01, LINE_STEP_M, MAX_JUMP_RAD)
    T_turned = T_start.copy()
    T_turned[:3, :3] = T_start[:3, [1, 2, 0]]
    with pytest.raises(ValueError, match="ends turned"):
        follow_line(T_start, T_turned, HOME_Q_RAD, LINE_STEP_M, MAX_JUMP_RAD)
