"""Inverse kinematics by damped least squares on the kinematics of pybullet: the slow twin of the closed form in robot/arm.py.

It knows no grid of joint 7, no branches and no bound on the elbow, and so it can find what the closed form cannot.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from objects.gripper import TCP_FROM_HAND_M
from pipelines.engines.robot.arm import Q_LOWER_RAD, Q_UPPER_RAD
from pipelines.proofs.audit.bullet_scene import BulletScene

_MAX_STEPS = 60
_MAX_STEP_RAD = 0.4
_HOPELESS = 20, 0.3  # after so many steps still so far away: it hangs on a joint limit, and few of those come loose
_TOLERANCE = 1e-7  # metres and radians; ten times finer than what the planner accepts of the closed form
_DAMPING = 1e-3  # keeps steps short near singularities; error^2 is added to it far away


def reach(
    world: BulletScene, T_base_tcp: Float[np.ndarray, "4 4"], q_start: Float[np.ndarray, "7"], *, lock_q7: bool = False
) -> Float[np.ndarray, "7"] | None:
    """A configuration within limits at a TCP pose, descending from `q_start`; None where the descent does not get there.

    Args:
        lock_q7: joint 7 stays where it is.
    """
    q = np.array(q_start, dtype=np.float64)
    n_free = 6 if lock_q7 else 7
    for k in range(_MAX_STEPS):
        error, jacobian = _error_and_jacobian(world, T_base_tcp, q)
        size = float(np.abs(error).max())
        if size < _TOLERANCE:
            return q
        if k == _HOPELESS[0] and size > _HOPELESS[1]:
            return None
        J = jacobian[:, :n_free]
        step = J.T @ np.linalg.solve(J @ J.T + (_DAMPING**2 + 1e-2 * size**2) * np.eye(6), error)
        step *= min(1.0, _MAX_STEP_RAD / max(float(np.abs(step).max()), 1e-12))
        q[:n_free] = np.clip(q[:n_free] + step, Q_LOWER_RAD[:n_free], Q_UPPER_RAD[:n_free])
    return None


def solutions(world: BulletScene, T_base_tcp: Float[np.ndarray, "4 4"], n_restarts: int, rng: np.random.Generator) -> list[np.ndarray]:
    """Configurations at a TCP pose from random starts within the joint limits, in the order of the starts."""
    starts = rng.uniform(Q_LOWER_RAD, Q_UPPER_RAD, (n_restarts, 7))
    found = (reach(world, T_base_tcp, start) for start in starts)
    return [q for q in found if q is not None]


def follow_line(
    world: BulletScene,
    T_start: Float[np.ndarray, "4 4"],
    T_end: Float[np.ndarray, "4 4"],
    q_start: Float[np.ndarray, "7"],
    step_m: float,
    max_joint_jump_rad: float,
) -> Float[np.ndarray, "m 7"] | None:
    """Configurations along a straight TCP line at constant orientation and constant joint 7; None where the arm cannot follow."""
    way_m = T_end[:3, 3] - T_start[:3, 3]
    n_steps = max(1, math.ceil(float(np.linalg.norm(way_m)) / step_m - 1e-9))
    rows = [q_start]
    for k in range(1, n_steps + 1):
        T = T_start.copy()
        T[:3, 3] += way_m * (k / n_steps)
        q = reach(world, T, rows[-1], lock_q7=True)
        if q is None or np.abs(q - rows[-1]).max() > max_joint_jump_rad:
            return None
        rows.append(q)
    return np.array(rows)


def _error_and_jacobian(
    world: BulletScene, T_base_tcp: Float[np.ndarray, "4 4"], q: Float[np.ndarray, "7"]
) -> tuple[Float[np.ndarray, "6"], Float[np.ndarray, "6 7"]]:
    """Position and rotation still to go, in the base frame, and the geometric Jacobian of the TCP."""
    T = world.link_poses(q[None])[0]
    tcp = T[7, :3, 3] + TCP_FROM_HAND_M * T[7, :3, 2]
    # Each link of the Panda turns about its own z axis; `np.cross` is ten times slower than the three lines that it takes.
    (a, b, c), (x, y, z) = T[:7, :3, 2].T, (tcp - T[:7, :3, 3]).T
    jacobian = np.array([b * z - c * y, c * x - a * z, a * y - b * x, a, b, c])
    return np.concatenate([T_base_tcp[:3, 3] - tcp, _turn(T_base_tcp[:3, :3] @ T[7, :3, :3].T)]), jacobian


def _turn(R: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3"]:
    """Rotation vector; of a half turn, where its direction is lost, some vector of that length."""
    double_sine = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    size = math.sqrt(float(double_sine @ double_sine))
    angle = math.atan2(size, float(R[0, 0] + R[1, 1] + R[2, 2]) - 1.0)
    if size < 1e-6:
        return double_sine / 2 if angle < 1.0 else np.array([angle, 0.0, 0.0])
    return double_sine * (angle / size)
