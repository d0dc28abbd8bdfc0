"""When a joint path is where: timing of paths by ruckig within scaled joint limits and a TCP speed; see planner.py for how paths are found.

Every piece of a path has one scalar progress that ruckig moves from rest to rest, so the arm stays exactly on the path that was
checked for collision (seven separate joint profiles would not).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import ruckig
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from pipelines.engines.bounds import bounded, check_bounds
from pipelines.engines.robot.arm import QD_MAX_RAD_S, QDD_MAX_RAD_S2, QDDD_MAX_RAD_S3, fk

_SAME_RAD = 1e-9


@dataclass(frozen=True, slots=True)
class MotionParams:
    """How fast the arm moves."""

    velocity_scale: float = bounded(1.0, 0.01, 1.0)  # shares of the rated limits of every joint
    acceleration_scale: float = bounded(1.0, 0.01, 1.0)
    jerk_scale: float = bounded(0.30, 0.001, 1.0)
    # Of the TCP in approach, lift, descend and retreat, up to what the controller of the Panda allows.
    line_speed_m_s: float = bounded(0.30, 0.001, 1.7)
    line_acceleration_m_s2: float = bounded(1.5, 0.01, 13.0)
    line_jerk_m_s3: float = bounded(40.0, 0.1, 6500.0)

    def __post_init__(self) -> None:
        check_bounds(self)


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Samples of a motion every `dt_s` from rest to rest; row k is the state at k * dt_s."""

    q_rad: Float[np.ndarray, "n 7"]
    qd_rad_s: Float[np.ndarray, "n 7"]
    duration_s: float


def time_path(waypoints: Float[np.ndarray, "k 7"], params: MotionParams, dt_s: float, stop_at_waypoints: bool) -> Trajectory:
    """Sampled motion along joint waypoints, from rest to rest.

    Args:
        waypoints: configurations in radians; repeated neighbours are dropped.
        dt_s: time between samples. Each piece is slowed to a whole number of samples (by less than one), so that
            waypoints where the arm stops are samples themselves.
        stop_at_waypoints: True runs straight joint-space pieces and stops at every waypoint (transport). False is one smooth
            motion on a cubic spline through all waypoints, whose TCP speed is limited too (lines).

    Raises:
        ValueError: no waypoints, or a value that is not finite, or dt_s not above 0.
    """
    if not dt_s > 0.0:
        raise ValueError(f"dt_s = {dt_s}, must be above 0")
    q_rad: list[np.ndarray] = []
    qd_rad_s: list[np.ndarray] = []
    for piece in _pieces(waypoints, params, stop_at_waypoints):
        n_steps = max(1, math.ceil(piece.duration_s / dt_s - 1e-9))
        stretch = piece.duration_s / (n_steps * dt_s)
        progress = np.array([piece.profile.at_time(k * dt_s * stretch)[:2] for k in range(n_steps + 1)])[:, :, 0]
        progress[0], progress[-1] = (0.0, 0.0), (piece.length, 0.0)
        q, slope = piece.at(progress[:, 0])
        first = 1 if q_rad else 0
        q_rad.append(q[first:])
        qd_rad_s.append((slope * progress[:, 1:] * stretch)[first:])
    if not q_rad:
        return Trajectory(waypoints[:1].copy(), np.zeros((1, 7)), 0.0)
    return Trajectory(np.concatenate(q_rad), np.concatenate(qd_rad_s), (sum(map(len, q_rad)) - 1) * dt_s)


def path_duration_s(waypoints: Float[np.ndarray, "k 7"], params: MotionParams, stop_at_waypoints: bool) -> float:
    """Duration of the motion of `time_path` before it is stretched to whole samples."""
    return sum(piece.duration_s for piece in _pieces(waypoints, params, stop_at_waypoints))


@dataclass(frozen=True, slots=True)
class _Piece:
    """A curve q(s) for s in [0, length] and the profile s(t) on it."""

    length: float
    start: Float[np.ndarray, "7"]
    direction: Float[np.ndarray, "7"]
    spline: CubicSpline | None
    profile: ruckig.Trajectory
    duration_s: float

    def at(self, s: Float[np.ndarray, "n"]) -> tuple[Float[np.ndarray, "n 7"], Float[np.ndarray, "n 7"]]:
        """q and dq/ds."""
        if self.spline is not None:
            return self.spline(s), self.spline(s, 1)
        # The end is stated, not computed: the last sample is the waypoint to the bit.
        q = np.where(s[:, None] == self.length, self.start + self.direction * self.length, self.start + s[:, None] * self.direction)
        return q, np.broadcast_to(self.direction, q.shape)


def _pieces(waypoints: Float[np.ndarray, "k 7"], params: MotionParams, stop_at_waypoints: bool) -> list[_Piece]:
    if waypoints.ndim != 2 or waypoints.shape[1] != 7 or not len(waypoints) or not np.all(np.isfinite(waypoints)):
        raise ValueError(f"waypoints of shape {waypoints.shape}, must be finite and (k, 7) with k >= 1")
    moves = np.concatenate([[True], np.abs(np.diff(waypoints, axis=0)).max(axis=1) > _SAME_RAD])
    q = waypoints[moves]
    if len(q) == 1:
        return []
    if stop_at_waypoints:
        return [_straight(q[k], q[k + 1], params) for k in range(len(q) - 1)]
    return [_smooth(q, params)]


def _straight(q_a: Float[np.ndarray, "7"], q_b: Float[np.ndarray, "7"], params: MotionParams) -> _Piece:
    """Straight joint-space piece with progress in [0, 1]."""
    step = q_b - q_a
    size = np.maximum(np.abs(step), 1e-12)
    limits = tuple(
        float((scale * bound / size).min())
        for scale, bound in (
            (params.velocity_scale, QD_MAX_RAD_S),
            (params.acceleration_scale, QDD_MAX_RAD_S2),
            (params.jerk_scale, QDDD_MAX_RAD_S3),
        )
    )
    profile = _rest_to_rest(1.0, *limits)
    return _Piece(1.0, q_a, step, None, profile, profile.duration)


def _smooth(q: Float[np.ndarray, "k 7"], params: MotionParams) -> _Piece:
    """One motion over all waypoints; progress is the TCP's way in metres.

    Along q(s) the joints have  qd = q' v,  qdd = q'' v^2 + q' a,  qddd = q''' v^3 + 3 q'' v a + q' j.  Speed is chosen first so that
    it takes at most half of each acceleration and a third of each jerk, then a and j take what is left on every piece of the spline;
    so the sums stay within their bounds whatever the phase of the profile.
    """
    step_m = np.linalg.norm(np.diff(fk(q)[:, :3, 3], axis=0), axis=1)
    # A floor keeps progress strictly increasing where only the joints move (a turn about the TCP).
    s = np.concatenate([[0.0], np.cumsum(np.maximum(step_m, 0.05 * np.abs(np.diff(q, axis=0)).max(axis=1)))])
    spline = CubicSpline(s, q)
    d1, d2, d3 = (np.maximum(bound, 1e-9) for bound in _largest_derivatives(spline))
    qd, qdd = params.velocity_scale * QD_MAX_RAD_S, params.acceleration_scale * QDD_MAX_RAD_S2
    qddd = params.jerk_scale * QDDD_MAX_RAD_S3
    v = min(params.line_speed_m_s, (qd / d1).min(), np.sqrt(qdd / 2 / d2).min(), np.cbrt(qddd / 3 / d3).min())
    a = min(params.line_acceleration_m_s2, ((qdd - d2 * v**2) / d1).min(), (qddd / 9 / (d2 * v)).min())
    j = min(params.line_jerk_m_s3, ((qddd - d3 * v**3 - 3 * d2 * v * a) / d1).min())
    profile = _rest_to_rest(float(s[-1]), float(v), float(a), float(j))
    return _Piece(float(s[-1]), q[0], q[-1], spline, profile, profile.duration)


def _largest_derivatives(
    spline: CubicSpline,
) -> tuple[Float[np.ndarray, "k 7"], Float[np.ndarray, "k 7"], Float[np.ndarray, "k 7"]]:
    """Largest |q'|, |q''|, |q'''| on each piece of a cubic spline, exactly: at its ends, and for q' also where q'' vanishes inside."""
    c3, c2, c1, _ = spline.c
    h = np.diff(spline.x)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = np.clip(np.nan_to_num(-c2 / (3 * c3), nan=0.0, posinf=0.0, neginf=0.0), 0.0, h)
    first = np.maximum(np.abs(c1), np.maximum(np.abs(c1 + turn * (2 * c2 + turn * 3 * c3)), np.abs(c1 + h * (2 * c2 + h * 3 * c3))))
    second = np.maximum(np.abs(2 * c2), np.abs(2 * c2 + 6 * c3 * h))
    return first, second, np.abs(6 * c3)


def _rest_to_rest(length: float, v: float, a: float, j: float) -> ruckig.Trajectory:
    bounds = ruckig.InputParameter(1)
    bounds.current_position, bounds.target_position = [0.0], [length]
    bounds.max_velocity, bounds.max_acceleration, bounds.max_jerk = [v], [a], [j]
    profile = ruckig.Trajectory(1)
    result = ruckig.Ruckig(1).calculate(bounds, profile)
    if result not in (ruckig.Result.Working, ruckig.Result.Finished):
        raise ValueError(f"ruckig: {result} for length {length}, v {v}, a {a}, j {j}")
    return profile
