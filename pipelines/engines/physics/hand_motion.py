"""How the hand moves along a timed joint path: pose, rate of turn and accelerations of every tick, all from the same cubic in the joints.

Between two samples (q, qd) of a trajectory the joints follow the cubic through both. The hand's motion in a tick is taken from its poses
at the tick's start, middle and end, so acceleration, velocity and position agree with each other to second order in the tick.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from objects.object_model import ObjectModel
from pipelines.engines.physics.errors import PhysicsError
from pipelines.engines.planning.trajectory import Trajectory
from pipelines.engines.robot.arm import fk
from tables.poses import inverse, pose_of, rotation_angle_rad

# Lines are followed at constant orientation up to what inverse kinematics and the spline through its rows leave (below 1e-4 rad).
TURNING_RAD = 5e-4


@dataclass(frozen=True, slots=True)
class HandMotion:
    """The hand of n ticks. Vectors of a tick are in the hand's axes at its middle but those that say base.

    Attributes:
        T_base_tcp: poses at the ticks' ends, and at the start.
        R_mid: orientations at the ticks' middles.
        acceleration_m_s2: of the TCP, of each tick.
        rate_rad_s, angular_acceleration_rad_s2: of the hand.
        start_velocity_m_s, base_acceleration_m_s2: of the TCP, base axes; velocity at the tick's start.
        end_velocity_m_s, end_rate_rad_s: in the hand's axes at the tick's end.
        tcp_base_pose: the base in the hand at the ticks' ends.
        position_gain_1_s2, velocity_gain_1_s: what the frame's turning does to a point at r with velocity v in it: the point's apparent
            acceleration is -(acceleration + position_gain r + velocity_gain v) (Euler and centrifugal, Coriolis).
        is_turning: whether the orientation changes at all.
    """

    T_base_tcp: Float[np.ndarray, "m 4 4"]
    R_mid: Float[np.ndarray, "n 3 3"]
    acceleration_m_s2: Float[np.ndarray, "n 3"]
    rate_rad_s: Float[np.ndarray, "n 3"]
    angular_acceleration_rad_s2: Float[np.ndarray, "n 3"]
    start_velocity_m_s: Float[np.ndarray, "n 3"]
    base_acceleration_m_s2: Float[np.ndarray, "n 3"]
    end_velocity_m_s: Float[np.ndarray, "n 3"]
    end_rate_rad_s: Float[np.ndarray, "n 3"]
    tcp_base_pose: Float[np.ndarray, "n 7"]
    position_gain_1_s2: Float[np.ndarray, "n 3 3"]
    velocity_gain_1_s: Float[np.ndarray, "n 3 3"]
    is_turning: bool


def hand_motion(trajectory: Trajectory, tick_s: float) -> HandMotion:
    """The hand along a trajectory whose samples are `tick_s` apart."""
    q, qd = trajectory.q_rad, trajectory.qd_rad_s
    middle = 0.5 * (q[:-1] + q[1:]) + 0.125 * tick_s * (qd[:-1] - qd[1:])
    T, M = fk(q), fk(middle)
    x, x_mid, R, R_mid = T[:, :3, 3], M[:, :3, 3], T[:, :3, :3], M[:, :3, :3]
    half = 0.5 * tick_s
    a = (x[1:] - 2.0 * x_mid + x[:-1]) / half**2
    start_velocity = (x_mid - x[:-1]) / half - 0.5 * half * a
    end_velocity = (x[1:] - x_mid) / half + 0.5 * half * a
    first, second = _small_turn(R[:-1], R_mid), _small_turn(R_mid, R[1:])
    alpha = (second - first) / half**2
    rate = (first + second) / tick_s
    spin = _cross_matrix(rate)
    return HandMotion(
        T_base_tcp=T,
        R_mid=R_mid,
        acceleration_m_s2=np.einsum("nji,nj->ni", R_mid, a),
        rate_rad_s=rate,
        angular_acceleration_rad_s2=alpha,
        start_velocity_m_s=start_velocity,
        base_acceleration_m_s2=a,
        end_velocity_m_s=np.einsum("nji,nj->ni", R[1:], end_velocity),
        end_rate_rad_s=second / half + 0.5 * half * alpha,
        tcp_base_pose=pose_of(inverse(T[1:])),
        position_gain_1_s2=_cross_matrix(alpha) + spin @ spin,
        velocity_gain_1_s=2.0 * spin,
        is_turning=bool(rotation_angle_rad(R[:1], R).max() > TURNING_RAD) if len(R) > 1 else False,
    )


def check_start(label: str, motion: HandMotion, T_base_hand: Float[np.ndarray, "4 4"]) -> None:
    """See that a motion starts where the hand is.

    Raises:
        PhysicsError: it starts elsewhere; names the run.
    """
    miss = float(np.abs(motion.T_base_tcp[0] - T_base_hand).max())
    if miss > 1e-4:
        raise PhysicsError(f"{label}: a motion starts {miss:.2g} (m or sine) from where the hand is, must be at most 1e-4")


def inertia_load(
    motion: HandMotion,
    k: int,
    body: ObjectModel,
    R_tcp_object: Float[np.ndarray, "3 3"],
    origin_m: Float[np.ndarray, "3"],
    velocity: Float[np.ndarray, "6"],
) -> Float[np.ndarray, "6"]:
    """Inertia force (at the centre of mass) and torque on an object in the hand's frame in tick k, in its axes.

    Args:
        origin_m: of the object's frame.
        velocity: of its origin in the hand's axes, and its rate of turn in its own axes, both with respect to the hand.
    """
    rate, alpha = motion.rate_rad_s[k], motion.angular_acceleration_rad_s2[k]
    w = R_tcp_object @ velocity[3:]
    to_com = R_tcp_object @ body.com_m
    r, v = origin_m + to_com, velocity[:3] + cross(w, to_com)
    drag = -(motion.acceleration_m_s2[k] + motion.position_gain_1_s2[k] @ r + motion.velocity_gain_1_s[k] @ v)
    I = R_tcp_object @ body.inertia_kg_m2 @ R_tcp_object.T
    L = I @ rate
    # d/dt of I (rate + w) in the turning frame, less what an engine that knows w alone does itself.
    torque = -(I @ alpha) - cross(rate, L + I @ w) - cross(w, L) + I @ cross(w, rate)
    return np.concatenate([body.mass_kg * drag, torque])


def cross(a: Float[np.ndarray, "3"], b: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """numpy's cross product costs ten times as much on three numbers."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _small_turn(R_a: Float[np.ndarray, "n 3 3"], R_b: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 3"]:
    """Rotation vectors from a to b in a's axes; exact to fifth order in the angle, which is below 0.02 rad in half a tick."""
    S = np.einsum("nji,njk->nik", R_a, R_b)
    w = 0.5 * np.stack([S[:, 2, 1] - S[:, 1, 2], S[:, 0, 2] - S[:, 2, 0], S[:, 1, 0] - S[:, 0, 1]], axis=-1)
    s2 = np.sum(w * w, axis=-1, keepdims=True)
    return np.asarray(w * (1.0 + s2 / 6.0 + 3.0 * s2 * s2 / 40.0))


def _cross_matrix(v: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
    """M with M x = v cross x."""
    M = np.zeros((len(v), 3, 3))
    M[:, 0, 1], M[:, 0, 2], M[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    M[:, 1, 0], M[:, 2, 0], M[:, 2, 1] = v[:, 2], -v[:, 1], v[:, 0]
    return M
