"""Places and outlines on the table: convex polygons of what stands there, gaps between them, random spots; all seen from above."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull

from objects.object_model import ObjectModel

Xy = Float[np.ndarray, "2"]
Polygon = Float[np.ndarray, "n 2"]

# Beside an object is no further than this from its centre.
_FURTHEST_M = 0.5
_RECTANGLE = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])


def footprint(object_model: ObjectModel, T_base_object: Float[np.ndarray, "4 4"]) -> Polygon:
    """Convex outline of an object, counter-clockwise, metres."""
    xy = object_model.mesh.vertices_m @ T_base_object[:2, :3].T + T_base_object[:2, 3]
    outline: Polygon = xy[ConvexHull(xy).vertices]
    return outline


def box_footprint(T_base_box: Float[np.ndarray, "4 4"], size_m: Float[np.ndarray, "3"]) -> Polygon:
    """Outline of a box that stands upright, counter-clockwise, metres."""
    outline: Polygon = (_RECTANGLE * size_m[:2]) @ T_base_box[:2, :2].T + T_base_box[:2, 3]
    return outline


def standing(xy: Xy, yaw_rad: float, height_m: float = 0.0) -> Float[np.ndarray, "4 4"]:
    """An upright pose at a spot of the table; a box of `height_m` stands on it by its centre."""
    T = np.eye(4)
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    T[:2, :2] = [[c, -s], [s, c]]
    T[:3, 3] = *xy, height_m / 2
    return T


def gap_m(a: Polygon, b: Polygon) -> float:
    """Widest gap between two convex outlines over the normals of their edges (separating axes); negative where they overlap.

    The distance between them where an edge is nearest, and a little less (never more) where two corners are.
    """
    axes = np.concatenate([_normals(a), _normals(b)])
    along_a, along_b = axes @ a.T, axes @ b.T
    return float(np.maximum(along_b.min(axis=1) - along_a.max(axis=1), along_a.min(axis=1) - along_b.max(axis=1)).max())


def beside(centre_xy: Xy, fixed: Polygon, moved: Callable[[Xy], Polygon], angle_rad: float, wanted_gap_m: float) -> Xy:
    """Where something is so far out from `centre_xy` in a direction that its outline leaves `wanted_gap_m` to a fixed one.

    Args:
        moved: outline of what is placed, at a spot.
    """
    direction = np.array([math.cos(angle_rad), math.sin(angle_rad)])
    low_m, high_m = 0.0, _FURTHEST_M
    for _ in range(12):  # bisection to 0.1 mm
        middle_m = (low_m + high_m) / 2
        if gap_m(fixed, moved(centre_xy + middle_m * direction)) < wanted_gap_m:
            low_m = middle_m
        else:
            high_m = middle_m
    return centre_xy + high_m * direction


def spot_in_sector(rng: np.random.Generator, radius_m: tuple[float, float], angle_rad: tuple[float, float]) -> Xy:
    """A spot, uniform over the area of an annular sector around the robot base."""
    radius = math.sqrt(rng.uniform(radius_m[0] ** 2, radius_m[1] ** 2))
    angle = rng.uniform(*angle_rad)
    return np.array([radius * math.cos(angle), radius * math.sin(angle)])


def is_in_sector(xy: Xy, radius_m: tuple[float, float], angle_rad: tuple[float, float]) -> bool:
    """Whether a spot is in an annular sector around the robot base."""
    radius, angle = math.hypot(*xy), math.atan2(xy[1], xy[0])
    return radius_m[0] <= radius <= radius_m[1] and angle_rad[0] <= angle <= angle_rad[1]


def _normals(outline: Polygon) -> Polygon:
    edges = np.roll(outline, -1, axis=0) - outline
    normals = np.stack([edges[:, 1], -edges[:, 0]], axis=1)
    unit: Polygon = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    return unit
