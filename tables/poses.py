"""Poses as the tables hold them (x, y, z, qx, qy, qz, qw) and as the code computes with them (4x4); nothing else.

`T_a_b` maps coordinates of frame b into frame a. Quaternions are xyzw, unit length, qw >= 0.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

POSE_PARTS = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")


def pose_columns(prefix: str) -> tuple[str, ...]:
    """The seven column names of a pose, for example `target_x_m` ... `target_qw`."""
    return tuple(f"{prefix}_{part}" for part in POSE_PARTS)


def matrix_of(pose: Float[np.ndarray, "*n 7"]) -> Float[np.ndarray, "*n 4 4"]:
    """4x4 transforms of pose rows; the quaternion is normalised.

    Raises:
        ValueError: a quaternion shorter than 1e-6.
    """
    pose = np.asarray(pose, dtype=np.float64)
    q = pose[..., 3:]
    norm = np.linalg.norm(q, axis=-1, keepdims=True)
    if np.any(norm < 1e-6):
        raise ValueError(f"quaternion of length {float(norm.min()):.3g}, must be at least 1e-6")
    x, y, z, w = np.moveaxis(q / norm, -1, 0)
    T = np.zeros((*pose.shape[:-1], 4, 4))
    T[..., 0, 0] = 1 - 2 * (y * y + z * z)
    T[..., 0, 1] = 2 * (x * y - z * w)
    T[..., 0, 2] = 2 * (x * z + y * w)
    T[..., 1, 0] = 2 * (x * y + z * w)
    T[..., 1, 1] = 1 - 2 * (x * x + z * z)
    T[..., 1, 2] = 2 * (y * z - x * w)
    T[..., 2, 0] = 2 * (x * z - y * w)
    T[..., 2, 1] = 2 * (y * z + x * w)
    T[..., 2, 2] = 1 - 2 * (x * x + y * y)
    T[..., :3, 3] = pose[..., :3]
    T[..., 3, 3] = 1.0
    return T


def pose_of(T: Float[np.ndarray, "*n 4 4"]) -> Float[np.ndarray, "*n 7"]:
    """Pose rows of 4x4 transforms (Shepperd's method: divide by the largest quaternion component), with qw >= 0."""
    T = np.asarray(T, dtype=np.float64)
    R = T[..., :3, :3]
    trace = R[..., 0, 0] + R[..., 1, 1] + R[..., 2, 2]
    squares = np.stack([R[..., 0, 0], R[..., 1, 1], R[..., 2, 2], trace], axis=-1)
    pick = np.argmax(squares, axis=-1)
    q = np.empty((*R.shape[:-2], 4))
    for largest in range(4):
        rows = pick == largest
        if not np.any(rows):
            continue
        r = R[rows]
        if largest == 3:
            part = np.stack([r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1], 1 + trace[rows]], -1)
        else:
            i, j, k = largest, (largest + 1) % 3, (largest + 2) % 3
            part = np.empty((len(r), 4))
            part[:, i] = 1 - trace[rows] + 2 * r[:, i, i]
            part[:, j] = r[:, j, i] + r[:, i, j]
            part[:, k] = r[:, k, i] + r[:, i, k]
            part[:, 3] = r[:, k, j] - r[:, j, k]
        q[rows] = part
    q /= np.linalg.norm(q, axis=-1, keepdims=True)
    q = np.where(q[..., 3:] < 0, -q, q)
    return np.concatenate([T[..., :3, 3], q], axis=-1)


def inverse(T: Float[np.ndarray, "*n 4 4"]) -> Float[np.ndarray, "*n 4 4"]:
    """Inverse of rigid transforms: transposed rotation, exact where `numpy.linalg.inv` is only close."""
    out = np.zeros_like(T)
    Rt = np.swapaxes(T[..., :3, :3], -1, -2)
    out[..., :3, :3] = Rt
    out[..., :3, 3] = -np.einsum("...ij,...j->...i", Rt, T[..., :3, 3])
    out[..., 3, 3] = 1.0
    return out


def rotation_angle_rad(R_a: Float[np.ndarray, "*n 3 3"], R_b: Float[np.ndarray, "*n 3 3"]) -> Float[np.ndarray, "*n"]:
    """Angle of the rotation between two rotations, in [0, pi]; atan2 form, accurate near 0 and near pi."""
    R = np.swapaxes(R_a, -1, -2) @ R_b
    skew = np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], axis=-1)
    return np.asarray(np.arctan2(np.linalg.norm(skew, axis=-1), np.trace(R, axis1=-2, axis2=-1) - 1.0))
