"""The Franka Panda arm: limits, forward and inverse kinematics, straight TCP lines; see engines/planning/ for collision and timing.

Forward and inverse kinematics are the closed forms of frankik; tests hold them against pinocchio and pybullet on the URDF.
"""

from __future__ import annotations

import math

import frankik
import numpy as np
from jaxtyping import Float

from objects.gripper import TCP_FROM_HAND_M
from tables.poses import inverse

# Limits of the real Panda, Franka Control Interface documentation ("Robot and interface specifications"); the URDF in pybullet_data
# has wider ones.
Q_LOWER_RAD = np.array([-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973])
Q_UPPER_RAD = np.array([2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973])
QD_MAX_RAD_S = np.array([2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61])
QDD_MAX_RAD_S2 = np.array([15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0])
QDDD_MAX_RAD_S3 = np.array([7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0])
HOME_Q_RAD = np.array([0.0, -np.pi / 4, 0.0, -3 * np.pi / 4, 0.0, np.pi / 2, np.pi / 4])
for _constant in (Q_LOWER_RAD, Q_UPPER_RAD, QD_MAX_RAD_S, QDD_MAX_RAD_S2, QDDD_MAX_RAD_S3, HOME_Q_RAD):
    _constant.setflags(write=False)

# The closed form loses digits next to its singularities; a solution that misses its pose by more is no solution.
IK_TOLERANCE = 1e-6
# frankik.fk gives the TCP, but its inverse wants the flange (link8): the hand is turned by -45 degrees about the flange's z.
_C = math.sqrt(0.5)
T_FLANGE_TCP = np.array([[_C, _C, 0.0, 0.0], [-_C, _C, 0.0, 0.0], [0.0, 0.0, 1.0, TCP_FROM_HAND_M], [0.0, 0.0, 0.0, 1.0]])
T_FLANGE_TCP.setflags(write=False)
_T_TCP_FLANGE = inverse(T_FLANGE_TCP)


def fk(q: Float[np.ndarray, "*n 7"]) -> Float[np.ndarray, "*n 4 4"]:
    """T_base_tcp of arm configurations in radians; limits are not checked."""
    if q.ndim == 1:
        T_base_tcp: Float[np.ndarray, "4 4"] = frankik.fk(q)
        return T_base_tcp
    return np.array([frankik.fk(row) for row in q.reshape(-1, 7)]).reshape(*q.shape[:-1], 4, 4)


def ik(T_base_tcp: Float[np.ndarray, "4 4"], n_q7: int) -> Float[np.ndarray, "k 7"]:
    """All configurations within limits that reach a TCP pose, on a grid of the redundant joint 7.

    He and Liu, "Analytical inverse kinematics for Franka Emika Panda", 2021. Their form covers q4 < -0.467 rad.

    Args:
        T_base_tcp: TCP pose in the base frame.
        n_q7: grid cells over the range of joint 7; their centres are tried (32 for a pose; lines need more, see PlanningParams).

    Returns:
        Up to 4 configurations a cell, ordered by q7, then by branch.
    """
    T_base_flange = T_base_tcp @ _T_TCP_FLANGE
    width = (Q_UPPER_RAD[6] - Q_LOWER_RAD[6]) / n_q7
    q = np.concatenate([frankik.ik_full(T_base_flange, HOME_Q_RAD, Q_LOWER_RAD[6] + (k + 0.5) * width, False) for k in range(n_q7)])
    return _valid(q, T_base_tcp)


def follow_line(
    T_start: Float[np.ndarray, "4 4"],
    T_end: Float[np.ndarray, "4 4"],
    q_start: Float[np.ndarray, "7"],
    max_step_m: float,
    max_joint_jump_rad: float,
) -> Float[np.ndarray, "m 7"] | None:
    """Configurations along a straight TCP line at constant orientation and constant q7, each the branch nearest to the one before.

    Args:
        T_start, T_end: TCP poses in the base frame, of the same orientation.
        q_start: configuration at `T_start`; the first row of the result.
        max_step_m: longest TCP step between rows.
        max_joint_jump_rad: largest change of a joint in one step; more is a jump to another branch.

    Returns:
        Rows from `T_start` to `T_end`, or None where the arm cannot follow.

    Raises:
        ValueError: the orientations differ, or `q_start` is not at `T_start`.
    """
    turn = float(np.abs(T_start[:3, :3] - T_end[:3, :3]).max())
    miss = float(np.abs(fk(q_start) - T_start).max())
    if turn > IK_TOLERANCE or miss > 10 * IK_TOLERANCE:
        raise ValueError(f"line: ends turned by {turn:.2g}, start missed by {miss:.2g}, must be at most {IK_TOLERANCE:g}")
    step_m = T_end[:3, 3] - T_start[:3, 3]
    n_steps = max(1, math.ceil(float(np.linalg.norm(step_m)) / max_step_m - 1e-9))
    T = np.repeat(T_start[None], n_steps, axis=0)
    T[:, :3, 3] += step_m * (np.arange(1, n_steps + 1) / n_steps)[:, None]
    T_flange = T @ _T_TCP_FLANGE
    if np.isnan(frankik.ik_full(T_flange[-1], HOME_Q_RAD, q_start[6], False)).all():
        return None  # a line whose end is out of reach is the common failure: not worth its other steps
    branches = np.array([frankik.ik_full(T_k, HOME_Q_RAD, q_start[6], False) for T_k in T_flange])
    branches[np.isnan(branches)] = 1e9  # no solution: further than any jump
    before = np.concatenate([np.repeat(q_start[None, None], 4, axis=1), branches[:-1]])
    jumps = np.abs(branches[:, None] - before[:, :, None]).max(axis=-1).tolist()
    branch, picked = 0, []
    for from_branch in jumps:
        jump = from_branch[branch]
        branch = jump.index(min(jump))
        if jump[branch] > max_joint_jump_rad:
            return None
        picked.append(branch)
    q = branches[np.arange(n_steps), picked]
    if np.abs(fk(q) - T).max() > IK_TOLERANCE:
        return None
    return np.concatenate([q_start[None], q])


def _valid(q: Float[np.ndarray, "n 7"], T_base_tcp: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "k 7"]:
    q = q[~np.isnan(q[:, 0])]
    q = q[np.all((q >= Q_LOWER_RAD) & (q <= Q_UPPER_RAD), axis=1)]
    return q[[bool(np.abs(frankik.fk(row) - T_base_tcp).max() <= IK_TOLERANCE) for row in q]] if len(q) else q
