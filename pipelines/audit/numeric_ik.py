"""Inverse kinematics by damped least squares on pybullet's kinematics: the slow twin of robot.arm's closed form.

It knows no grid of joint 7, no branches and no bound on the elbow, and so it can find what the closed form cannot.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from objects.gripper import TCP_FROM_HAND_M
from pipelines.audit.bullet_scene import BulletScene
from pipelines.robot.arm import Q_LOWER_RAD, Q_UPPER_RAD

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
    world: BulletScene, T_start: Float[np.ndarray, "4 4"], T_end: Float[np.ndarray, "4 4"], q_start: Float[np.ndarray, "7"], step_m: float
) -> Float[np.ndarray, "m 7"] | None:
    """Configurations along a straight TCP line at constant orientation and constant joint 7; None where the arm cannot follow."""
    way_m = T_end[:3, 3] - T_start[:3, 3]
    n_steps = max(1, math.ceil(float(np.linalg.norm(way_m)) / step_m - 1e-9))
    rows = [q_start]
    for k in range(1, n_steps + 1):
        T = T_start.copy()
        T[:3, 3] += way_m * (k / n_steps)
        q = reach(world, T, rows[-1], lock_q7=True)
        # A millimetre of the TCP is some milliradian; more is another branch.
        if q is None or np.abs(q - rows[-1]).max() > 0.1:
            return None
        rows.append(q)
    return np.array(rows)


def _error_and_jacobian(
    world: BulletScene, T_base_tcp: Float[np.ndarray, "4 4"], q: Float[np.ndarray, "7"]
) -> tuple[Float[np.ndarray, "6"], Float[np.ndarray, "6 7"]]:
    """Position and rotation still to go, in the base frame, and the geometric Jacobian of the TCP."""
    T = world.link_poses(q[None])[0]
    tcp = T[7, :3, 3] + TCP_FROM_HAND_M * T[7, :3, 2]
    turn = Rotation.from_matrix(T_base_tcp[:3, :3] @ T[7, :3, :3].T).as_rotvec()
    # Each link of the Panda turns about its own z axis.
    axes, origins = T[:7, :3, 2], T[:7, :3, 3]
    return np.concatenate([T_base_tcp[:3, 3] - tcp, turn]), np.concatenate([np.cross(axes, tcp - origins).T, axes.T])
