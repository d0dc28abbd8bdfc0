"""What Bullet is given of an object: collision shapes and its mass frame; the world is world.py."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

from objects.object_model import ObjectModel, TriangleMesh
from pipelines.engines.physics.errors import PhysicsError
from tables.poses import pose_of

# Bullet pads every convex hull by this much and nothing can turn it off (`collisionMargin=0` does not); boxes it pads inwards.
HULL_MARGIN_M = 0.001


@dataclass(frozen=True, slots=True)
class BoxPart:
    """A convex part that is a box in the object frame; Bullet's box is exact and cheaper than its hull."""

    centre_m: Float[np.ndarray, "3"]
    half_extents_m: Float[np.ndarray, "3"]


@dataclass(frozen=True, slots=True)
class ObjectBody:
    """An object as Bullet wants it: boxes, one OBJ text with a group for each other part, and the frame of its principal inertia."""

    boxes: tuple[BoxPart, ...]
    hulls_obj: str
    T_object_mass: Float[np.ndarray, "4 4"]
    mass_pose: Float[np.ndarray, "7"]
    principal_inertia_kg_m2: Float[np.ndarray, "3"]


def object_body(object_model: ObjectModel) -> ObjectBody:
    """Collision shapes and mass frame of an object; hulls are shrunk by Bullet's margin so that the padded body has the true size.

    Raises:
        PhysicsError: a part without volume.
    """
    boxes, hulls_obj = _shapes(object_model.object_id, tuple(part.vertices_m.tobytes() for part in object_model.parts))
    moments, axes = np.linalg.eigh(object_model.inertia_kg_m2)
    # eigh's vectors may be mirrored; a mass frame must be a rotation.
    axes = axes * np.array([1.0, 1.0, np.sign(np.linalg.det(axes))])
    T_object_mass = np.eye(4)
    T_object_mass[:3, :3], T_object_mass[:3, 3] = axes, object_model.com_m
    return ObjectBody(boxes, hulls_obj, T_object_mass, pose_of(T_object_mass), moments)


@lru_cache(maxsize=64)
def _shapes(object_id: str, parts: tuple[bytes, ...]) -> tuple[tuple[BoxPart, ...], str]:
    boxes, hulls = [], []
    for part_id, raw in enumerate(parts):
        vertices_m = np.frombuffer(raw).reshape(-1, 3)
        box = _as_box(vertices_m)
        try:
            if box is not None:
                boxes.append(box)
            else:
                hulls.append(shrunk_hull(vertices_m, HULL_MARGIN_M))
        except QhullError as error:
            raise PhysicsError(f"{object_id}: part {part_id} with {len(vertices_m)} vertices has volume 0, must be above") from error
    if not boxes and len(hulls) == 1:
        hulls = _halves(hulls[0])
    return tuple(boxes), _obj_text(hulls)


def _as_box(vertices_m: Float[np.ndarray, "v 3"]) -> BoxPart | None:
    """The axis-aligned box whose corners the vertices are, all eight and nothing else."""
    low, high = vertices_m.min(axis=0), vertices_m.max(axis=0)
    at_corner = np.minimum(np.abs(vertices_m - low), np.abs(vertices_m - high)).max() < 1e-7
    if len(vertices_m) != 8 or not at_corner or (high - low).min() <= 0.0 or len(np.unique(vertices_m > (low + high) / 2, axis=0)) != 8:
        return None
    return BoxPart((low + high) / 2, (high - low) / 2)


def shrunk_hull(vertices_m: Float[np.ndarray, "v 3"], by_m: float) -> TriangleMesh:
    """Convex hull whose faces are all moved inwards by `by_m`, or by half of its inscribed ball's radius where that is less."""
    planes = np.unique(np.round(ConvexHull(vertices_m).equations, 9), axis=0)
    centre, radius_m = _inscribed_ball(planes)
    moved = planes + np.array([0.0, 0.0, 0.0, min(by_m, radius_m / 2)])
    corners = HalfspaceIntersection(moved, centre).intersections
    corners = corners[np.unique(np.round(corners, 7), axis=0, return_index=True)[1]]
    return hull_mesh(corners)


def _halves(hull: TriangleMesh) -> list[TriangleMesh]:
    """A hull cut in two across its longest axis.

    Bullet adds one contact point a step to each pair of convex shapes. A can in one piece lies on one end at a time, rocks, and is
    pushed up by the error correction so much that it rolls faster and faster by itself; in two pieces it rolls out as a can does.
    """
    vertices_m = hull.vertices_m
    axis = int(np.argmax(np.ptp(vertices_m, axis=0)))
    height_m = vertices_m[:, axis] - (vertices_m[:, axis].min() + vertices_m[:, axis].max()) / 2
    low, high = np.flatnonzero(height_m < 0.0), np.flatnonzero(height_m >= 0.0)
    share = (height_m[high] / (height_m[high] - height_m[low, None]))[..., None]
    # Points where the lines from every low to every high vertex cross the plane: their hull is the cut.
    cut = (share * vertices_m[low, None] + (1.0 - share) * vertices_m[None, high]).reshape(-1, 3)
    return [hull_mesh(np.concatenate([vertices_m[part], cut])) for part in (low, high)]


def hull_mesh(points_m: Float[np.ndarray, "n 3"]) -> TriangleMesh:
    """Convex hull of points, only its vertices kept, faces wound outwards."""
    hull = ConvexHull(points_m)
    number = np.full(len(points_m), -1)
    number[hull.vertices] = np.arange(len(hull.vertices))
    corners = points_m[hull.simplices]
    outward = np.einsum("ij,ij->i", np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), hull.equations[:, :3]) > 0
    faces: Int[np.ndarray, "f 3"] = np.where(outward[:, None], hull.simplices, hull.simplices[:, ::-1])
    return TriangleMesh(points_m[hull.vertices], number[faces])


def _inscribed_ball(planes: Float[np.ndarray, "p 4"]) -> tuple[Float[np.ndarray, "3"], float]:
    """Centre and radius of the largest ball inside half-spaces n x + d <= 0 (the Chebyshev centre, a linear program)."""
    norms = np.linalg.norm(planes[:, :3], axis=1)
    solution = linprog(
        [0, 0, 0, -1], A_ub=np.column_stack([planes[:, :3], norms]), b_ub=-planes[:, 3], bounds=[(None, None)] * 3 + [(0, None)]
    )
    return solution.x[:3], float(solution.x[3])


def _obj_text(meshes: list[TriangleMesh]) -> str:
    """One OBJ group a mesh: Bullet makes one convex hull of each group."""
    lines, first = [], 1
    for k, mesh in enumerate(meshes):
        lines.append(f"o part_{k}")
        lines += [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in mesh.vertices_m]
        lines += [f"f {a} {b} {c}" for a, b, c in mesh.faces + first]
        first += len(mesh.vertices_m)
    return "\n".join(lines) + "\n" if meshes else ""
