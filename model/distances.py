"""Distances between boxes, lines and points, many at once, in float64; what they are measured for is in geometry.py."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

SHORTEST_M = 1e-9  # a line below it is a point


def moved(T: Float[np.ndarray, "*c 4 4"], points_m: Float[np.ndarray, "*c n 3"]) -> Float[np.ndarray, "*c n 3"]:
    """Points of frame b in frame a, for T_a_b; leading axes broadcast."""
    # Written out, not as a matrix product: BLAS may add in another order when it has another number of threads.
    R, t = T[..., None, :3, :3], T[..., None, :3, 3]
    x, y, z = (points_m[..., k, None] for k in range(3))
    in_a: Float[np.ndarray, "*c n 3"] = R[..., 0] * x + R[..., 1] * y + R[..., 2] * z + t
    return in_a


def box_distance_m(
    points_m: Float[np.ndarray, "c n 3"], centres_m: Float[np.ndarray, "c b 3"], half_m: Float[np.ndarray, "b 3"]
) -> Float[np.ndarray, "c b"]:
    """Smallest signed distance of points to each box, in the frame whose axes the boxes share: negative inside, by the depth.

    The exact distance of a box (Quilez, "Distance functions"), which is also the smallest move of the point that brings it to a face.
    """
    nearest = np.empty(centres_m.shape[:2])
    for box in range(len(half_m)):
        outside = np.abs(points_m - centres_m[:, box, None]) - half_m[box]
        x, y, z = outside[..., 0], outside[..., 1], outside[..., 2]
        deepest = np.maximum(np.maximum(x, y), z)
        away = np.sqrt(np.maximum(x, 0.0) ** 2 + np.maximum(y, 0.0) ** 2 + np.maximum(z, 0.0) ** 2)
        nearest[:, box] = (away + np.minimum(deepest, 0.0)).min(axis=1)
    return nearest


def segment_distance_m(
    points_m: Float[np.ndarray, "n 3"], start_m: Float[np.ndarray, "c 3"], end_m: Float[np.ndarray, "c 3"]
) -> Float[np.ndarray, "c"]:
    """Smallest distance of points to each straight line from start to end; a line without length is a point."""
    along = end_m - start_m
    length2 = np.maximum(np.sum(along**2, axis=1), SHORTEST_M**2)
    # Axis by axis: numpy sums over a last axis of 3 several times slower.
    to_point = [points_m[None, :, k] - start_m[:, None, k] for k in range(3)]
    share = np.clip(sum(to_point[k] * along[:, None, k] for k in range(3)) / length2[:, None], 0.0, 1.0)
    gap2 = sum((to_point[k] - share * along[:, None, k]) ** 2 for k in range(3))
    nearest: Float[np.ndarray, "c"] = np.sqrt(np.min(gap2, axis=1))
    return nearest


def cloud_distance_m(points_a_m: Float[np.ndarray, "n 3"], points_b_m: Float[np.ndarray, "m 3"]) -> float:
    """Smallest distance between points of two clouds."""
    gap2 = sum((points_a_m[:, None, k] - points_b_m[None, :, k]) ** 2 for k in range(3))
    return float(np.sqrt(np.min(gap2)))


def lowest_corner_m(
    T: Float[np.ndarray, "c 4 4"], centres_m: Float[np.ndarray, "c b 3"], half_m: Float[np.ndarray, "b 3"]
) -> Float[np.ndarray, "c b"]:
    """Height (z of frame a) of the lowest corner of boxes that share the axes of frame b, for T_a_b."""
    up = T[:, None, 2, :3]
    lowest: Float[np.ndarray, "c b"] = np.sum(up * centres_m, axis=2) - np.sum(np.abs(up) * half_m, axis=2) + T[:, None, 2, 3]
    return lowest
