"""Three real-sized objects built by hand for physics tests, independent of objects/build.py."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh

from objects.object_model import ObjectModel, PoolGrasp, StablePose, TriangleMesh
from tables.vocabulary import Symmetry


def can_model(radius_m: float = 0.033, height_m: float = 0.115, mass_kg: float = 0.35) -> ObjectModel:
    """A drinks can: one convex part, grasps from the side and from above."""
    solid = trimesh.creation.cylinder(radius_m, height_m, sections=48)
    side = [_grasp(k, "side", approach=(np.cos(a), np.sin(a), 0.0), jaw=(-np.sin(a), np.cos(a), 0.0), width_m=2 * radius_m)
            for k, a in enumerate(np.linspace(0, 2 * np.pi, 8, endpoint=False))]  # fmt: skip
    top = [_grasp(8 + k, "top", (0.0, 0.0, -1.0), (np.cos(a), np.sin(a), 0.0), 2 * radius_m, at=(0.0, 0.0, height_m / 2 - 0.02))
           for k, a in enumerate(np.linspace(0, np.pi, 4, endpoint=False))]  # fmt: skip
    poses = (
        _rest(0, "upright", 0.3, np.eye(3), height_m / 2),
        _rest(1, "inverted", 0.3, np.diag([1.0, -1.0, -1.0]), height_m / 2),
        # A 48-gon lies on a face, not on an edge.
        _rest(2, "lying", 0.4, _turn_y(90) @ _turn_z(180 / 48), radius_m * np.cos(np.pi / 48)),
    )
    solid.density = mass_kg / solid.volume
    return _model("can", Symmetry.REVOLUTION_Z, [solid, solid], poses, (*side, *top))


def cuboid_model(size_m: tuple[float, float, float] = (0.06, 0.09, 0.14), mass_kg: float = 0.3) -> ObjectModel:
    """A carton: one box part, grasps across its x width."""
    solid = trimesh.creation.box(size_m)
    x, y, z = size_m
    grasps = [_grasp(0, "top", (0, 0, -1.0), (1.0, 0, 0), x, at=(0, 0, z / 2 - 0.02))]
    grasps += [_grasp(1 + k, "side", (0, s, 0), (1.0, 0, 0), x, at=(0, -s * (y / 2 - 0.025), h))
               for k, (s, h) in enumerate([(1.0, 0.0), (-1.0, 0.0), (1.0, 0.04), (-1.0, -0.04)])]  # fmt: skip
    poses = (
        _rest(0, "face_z", 0.2, np.eye(3), z / 2),
        _rest(1, "face_y", 0.4, _turn_x(90), y / 2),
        _rest(2, "face_x", 0.4, _turn_y(90), x / 2),
    )
    solid.density = mass_kg / solid.volume
    return _model("cuboid", Symmetry.BOX, [solid, solid], poses, tuple(grasps))


def mug_model(outer_m: float = 0.040, height_m: float = 0.095, wall_m: float = 0.005, mass_kg: float = 0.3) -> ObjectModel:
    """A mug: 12 wall wedges, a bottom and a handle of three boxes; grasps at the rim."""
    n = 12
    angles = np.linspace(0, 2 * np.pi, n, endpoint=False)
    parts = []
    for a in angles:
        b = a + 2 * np.pi / n
        ring = [(r * np.cos(t), r * np.sin(t)) for r in (outer_m, outer_m - wall_m) for t in (a, b)]
        parts.append(_hull([(x, y, z) for x, y in ring for z in (-height_m / 2 + wall_m, height_m / 2)]))
    bottom = [(outer_m * np.cos(a), outer_m * np.sin(a), z) for a in angles for z in (-height_m / 2, -height_m / 2 + wall_m)]
    parts.append(_hull(bottom))
    for centre, size in (((outer_m + 0.010, 0, 0.025), (0.030, 0.012, 0.010)), ((outer_m + 0.010, 0, -0.025), (0.030, 0.012, 0.010)),
                         ((outer_m + 0.030, 0, 0.0), (0.010, 0.012, 0.060))):  # fmt: skip
        box = trimesh.creation.box(size)
        box.apply_translation(centre)
        parts.append(box)
    solid = trimesh.boolean.union(parts, engine="manifold")
    at = outer_m * np.cos(np.pi / n) - wall_m / 2
    rim = []
    for k, a in enumerate(angles + np.pi / n):
        out = np.array([np.cos(a), np.sin(a), 0.0])
        rim.append(_grasp(k, "rim", (0, 0, -1.0), tuple(out), wall_m, at=(at * out[0], at * out[1], height_m / 2 - 0.015)))
    poses = (_rest(0, "upright", 0.6, np.eye(3), height_m / 2), _rest(1, "inverted", 0.4, np.diag([1.0, -1.0, -1.0]), height_m / 2))
    solid.density = mass_kg / solid.volume
    return _model("mug", Symmetry.NONE, [solid, *parts], poses, tuple(rim))


def _model(
    category: str,
    symmetry: Symmetry,
    solids: list[trimesh.Trimesh],
    stable_poses: tuple[StablePose, ...],
    grasps: tuple[PoolGrasp, ...],
) -> ObjectModel:
    """An object of the whole solid, which has its mass, and its convex parts."""
    whole, *parts = (TriangleMesh(np.array(solid.vertices), np.array(solid.faces)) for solid in solids)
    return ObjectModel(
        object_id=f"test_{category}",
        category=category,
        symmetry=symmetry,
        mass_kg=float(solids[0].mass),
        friction=0.8,
        com_m=np.array(solids[0].center_mass),
        inertia_kg_m2=np.array(solids[0].moment_inertia),
        mesh=whole,
        parts=tuple(parts),
        stable_poses=stable_poses,
        grasps=grasps,
    )


def _hull(points: list[tuple[float, float, float]]) -> trimesh.Trimesh:
    return trimesh.PointCloud(np.array(points)).convex_hull


def _grasp(
    grasp_id: int, kind: str, approach: Sequence[float], jaw: Sequence[float], width_m: float, at: Sequence[float] = (0.0, 0.0, 0.0)
) -> PoolGrasp:
    z, y = np.array(approach, dtype=float), np.array(jaw, dtype=float)
    T = np.eye(4)
    T[:3, :3] = np.column_stack([np.cross(y, z), y, z])
    T[:3, 3] = at
    return PoolGrasp(grasp_id, kind, T, width_m)


def _rest(stable_pose_id: int, resting: str, probability: float, R: np.ndarray, height_m: float) -> StablePose:
    T = np.eye(4)
    T[:3, :3], T[2, 3] = R, height_m
    return StablePose(stable_pose_id, resting, probability, T)


def _turn_x(degrees: float) -> np.ndarray:
    return trimesh.transformations.rotation_matrix(np.radians(degrees), [1, 0, 0])[:3, :3]


def _turn_y(degrees: float) -> np.ndarray:
    return trimesh.transformations.rotation_matrix(np.radians(degrees), [0, 1, 0])[:3, :3]


def _turn_z(degrees: float) -> np.ndarray:
    return trimesh.transformations.rotation_matrix(np.radians(degrees), [0, 0, 1])[:3, :3]
