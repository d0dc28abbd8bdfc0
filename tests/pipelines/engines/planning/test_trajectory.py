"""Laws of timed motion: within limits, from rest to rest, through its waypoints, on its path."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import ruckig
from hypothesis import given, settings
from hypothesis import strategies as st

from pipelines.engines.planning.trajectory import MotionParams, Trajectory, path_duration_s, time_path
from pipelines.engines.robot.arm import HOME_Q_RAD, QD_MAX_RAD_S, QDD_MAX_RAD_S2, QDDD_MAX_RAD_S3, fk, follow_line

DT_S = 1 / 240
PARAMS = MotionParams()
ROUNDING = 1e-6  # of a bound: finite differences of doubles


def random_path(seed: int, n: int) -> np.ndarray:
    return HOME_Q_RAD + np.random.default_rng(seed).uniform(-1.0, 1.0, (n, 7))


def random_line(seed: int) -> np.ndarray | None:
    rng = np.random.default_rng(seed)
    q = HOME_Q_RAD + rng.uniform(-0.4, 0.4, 7)
    T_end = fk(q)
    T_end[:3, 3] += rng.uniform(-0.06, 0.06, 3)
    return follow_line(fk(q), T_end, q, 0.0025, 0.1)


def assert_within_limits(motion: Trajectory, params: MotionParams, dt_s: float) -> None:
    """The mean of a derivative over a sample never exceeds its bound; third differences lose digits to dt^3."""
    qd, qdd = np.diff(motion.q_rad, axis=0) / dt_s, np.diff(motion.qd_rad_s, axis=0) / dt_s
    assert np.all(np.abs(motion.qd_rad_s) <= params.velocity_scale * QD_MAX_RAD_S * (1 + ROUNDING))
    assert np.all(np.abs(qd) <= params.velocity_scale * QD_MAX_RAD_S * (1 + ROUNDING))
    assert np.all(np.abs(qdd) <= params.acceleration_scale * QDD_MAX_RAD_S2 * (1 + ROUNDING) + 1e-6)
    if len(qdd) > 1:
        assert np.all(np.abs(np.diff(qdd, axis=0) / dt_s) <= params.jerk_scale * QDDD_MAX_RAD_S3 * (1 + ROUNDING) + 1e-3)


def assert_consistent(motion: Trajectory, dt_s: float) -> None:
    """Rest at both ends, and velocities that are the derivative of positions (trapezoid rule: error jerk * dt^2 / 12)."""
    assert np.all(motion.qd_rad_s[[0, -1]] == 0.0)
    assert motion.duration_s == pytest.approx((len(motion.q_rad) - 1) * dt_s)
    mean = (motion.qd_rad_s[1:] + motion.qd_rad_s[:-1]) / 2
    bound = PARAMS.jerk_scale * QDDD_MAX_RAD_S3.max() * dt_s**2 / 6 + 1e-9
    assert np.abs(np.diff(motion.q_rad, axis=0) / dt_s - mean).max() <= bound


@given(st.integers(0, 2**32 - 1), st.integers(2, 5))
@settings(max_examples=40, deadline=None)
def test_transport_stops_at_waypoints_and_keeps_to_straight_pieces(seed: int, n: int) -> None:
    waypoints = random_path(seed, n)
    motion = time_path(waypoints, PARAMS, DT_S, stop_at_waypoints=True)
    assert_within_limits(motion, PARAMS, DT_S)
    assert_consistent(motion, DT_S)
    at = [int(np.flatnonzero(np.all(np.abs(motion.q_rad - q) < 1e-12, axis=1))[0]) for q in waypoints]
    assert at == sorted(at)
    assert np.all(motion.qd_rad_s[at] == 0.0)
    for (a, b), (q_a, q_b) in zip(pairwise(at), pairwise(waypoints), strict=True):
        along = (motion.q_rad[a : b + 1] - q_a) @ (q_b - q_a) / np.square(q_b - q_a).sum()
        np.testing.assert_allclose(motion.q_rad[a : b + 1], q_a + along[:, None] * (q_b - q_a), atol=1e-12)
        assert np.all(np.diff(along) >= -1e-12)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_a_line_is_one_motion_through_all_waypoints(seed: int) -> None:
    line = random_line(seed)
    if line is None or len(line) < 2:
        return
    motion = time_path(line, PARAMS, DT_S, stop_at_waypoints=False)
    assert_within_limits(motion, PARAMS, DT_S)
    assert_consistent(motion, DT_S)
    np.testing.assert_allclose(motion.q_rad[[0, -1]], line[[0, -1]], atol=1e-12)
    assert np.all(np.abs(motion.qd_rad_s[1:-1]).max(axis=1) > 0.0)
    tcp = fk(motion.q_rad)[:, :3, 3]
    assert np.linalg.norm(np.diff(tcp, axis=0), axis=1).max() / DT_S <= PARAMS.line_speed_m_s * 1.01  # chords of the waypoints, not arcs
    # Every waypoint is passed: some sample is as near as half a sample's way at line speed.
    gaps = np.linalg.norm(fk(line)[:, None, :3, 3] - tcp, axis=2).min(axis=1)
    assert gaps.max() <= PARAMS.line_speed_m_s * DT_S / 2 + 1e-6


def test_one_straight_piece_is_as_fast_as_seven_phase_locked_joints() -> None:
    """Reference: ruckig's own seven-joint motion, held on the straight line by phase synchronisation."""
    for seed in range(20):
        q_a, q_b = random_path(seed, 2)
        bounds = ruckig.InputParameter(7)
        bounds.synchronization = ruckig.Synchronization.Phase
        bounds.current_position, bounds.target_position = q_a.tolist(), q_b.tolist()
        bounds.max_velocity = (PARAMS.velocity_scale * QD_MAX_RAD_S).tolist()
        bounds.max_acceleration = (PARAMS.acceleration_scale * QDD_MAX_RAD_S2).tolist()
        bounds.max_jerk = (PARAMS.jerk_scale * QDDD_MAX_RAD_S3).tolist()
        reference = ruckig.Trajectory(7)
        ruckig.Ruckig(7).calculate(bounds, reference)
        ours = path_duration_s(np.stack([q_a, q_b]), PARAMS, stop_at_waypoints=True)
        # Never faster than what phase locking allows, and at most what one joint's slower limit costs the others.
        assert reference.duration * (1 - 1e-9) <= ours <= reference.duration * 1.1


def test_durations_shrink_with_speed_and_samples_round_them_up() -> None:
    waypoints = random_path(5, 3)
    durations = [path_duration_s(waypoints, MotionParams(velocity_scale=scale), stop_at_waypoints=True) for scale in (0.1, 0.3, 0.5, 1.0)]
    assert durations == sorted(durations, reverse=True)
    assert durations[0] > 2 * durations[2]
    exact = path_duration_s(waypoints, PARAMS, stop_at_waypoints=True)
    sampled = time_path(waypoints, PARAMS, DT_S, stop_at_waypoints=True).duration_s
    assert 0.0 <= sampled - exact < 2 * DT_S + 1e-9


def test_the_same_path_gives_the_same_motion_to_the_bit() -> None:
    line = random_line(0)
    assert line is not None
    first, second = (time_path(line, PARAMS, DT_S, stop_at_waypoints=False) for _ in range(2))
    assert first.q_rad.tobytes() == second.q_rad.tobytes()
    assert first.qd_rad_s.tobytes() == second.qd_rad_s.tobytes()


def test_a_path_that_goes_nowhere_takes_no_time() -> None:
    motion = time_path(np.stack([HOME_Q_RAD, HOME_Q_RAD]), PARAMS, DT_S, stop_at_waypoints=True)
    assert motion.duration_s == 0.0
    np.testing.assert_array_equal(motion.q_rad, HOME_Q_RAD[None])


@pytest.mark.parametrize(("name", "value"), [("velocity_scale", 0.0), ("jerk_scale", np.nan), ("line_speed_m_s", -1.0)])
def test_impossible_speeds_are_refused(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        MotionParams(**{name: value})


def test_bad_waypoints_are_refused() -> None:
    for waypoints in (np.zeros((0, 7)), np.zeros((2, 6)), np.full((2, 7), np.nan)):
        with pytest.raises(ValueError, match="waypoints"):
            time_path(waypoints, PARAMS, DT_S, stop_at_waypoints=True)
    with pytest.raises(ValueError, match="dt_s"):
        time_path(HOME_Q_RAD[None], PARAMS, 0.0, stop_at_waypoints=True)
