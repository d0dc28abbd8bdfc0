"""From a catalogue entry to the rows of the five object tables, and to object_models; each step lives in its own module."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float

from objects.catalogue import ObjectSpec
from objects.decomposition import Decomposition, DecompositionParams, decompose, mesh_sha256
from objects.grasp_pool import GraspPoolParams, RatedGrasp, grasp_pool
from objects.object_model import ObjectModel, StablePose, TriangleMesh, object_models_from_tables
from objects.solids import Solid, solid_of
from objects.stable_poses import StablePoseParams, stable_poses
from tables.identity import rng_for
from tables.poses import pose_columns, pose_of
from tables.schemas import GRASP_POOL, OBJECT_MESHES, OBJECT_PARTS, OBJECTS, STABLE_POSES
from tables.store import table_from_rows

Row = dict[str, Any]


@dataclass(frozen=True, slots=True)
class ObjectParams:
    """Parameters of every step that builds an object."""

    decomposition: DecompositionParams = field(default_factory=DecompositionParams)
    stable_poses: StablePoseParams = field(default_factory=StablePoseParams)
    grasp_pool: GraspPoolParams = field(default_factory=GraspPoolParams)


@dataclass(frozen=True, slots=True)
class ObjectTables:
    """Rows of one object for each object table, and what was changed of a user's mesh (which `source` says too)."""

    objects: list[Row]
    object_meshes: list[Row]
    object_parts: list[Row]
    stable_poses: list[Row]
    grasp_pool: list[Row]
    notes: tuple[str, ...] = ()


def build_object(spec: ObjectSpec, params: ObjectParams, seed: int, progress: Callable[[str], Any] | None = None) -> ObjectTables:
    """Solid, convex parts, mass properties, stable poses and grasp pool of one catalogue entry.

    Args:
        seed: the recipe seed; the result depends on it, the entry and the parameters alone.
        progress: is told, in a line now and then, what takes long.

    Raises:
        ObjectError: the object cannot be built; names it, the value and its bound.
    """
    solid = solid_of(spec)
    mesh = TriangleMesh(np.array(solid.mesh.vertices, dtype=np.float64), np.array(solid.mesh.faces, dtype=np.int64))
    coacd_seed = int(rng_for(seed, "decomposition", spec.object_id).integers(2**31))
    decomposition = decompose(spec, solid, params.decomposition, coacd_seed, progress)
    com_m = np.asarray(solid.mesh.center_mass) + np.array(spec.com_offset_m)
    poses = stable_poses(spec, solid.mesh, com_m, params.stable_poses)
    grasps = grasp_pool(spec, solid.mesh, decomposition.parts, com_m, poses, params.grasp_pool, seed)
    return ObjectTables(
        objects=[_object_row(spec, solid, mesh, com_m, decomposition, grasps)],
        object_meshes=[{"object_id": spec.object_id, **_mesh_columns(mesh)}],
        object_parts=[{"object_id": spec.object_id, "part_id": k, **_mesh_columns(p)} for k, p in enumerate(decomposition.parts)],
        stable_poses=[_pose_row(spec.object_id, pose) for pose in poses],
        grasp_pool=[_grasp_row(spec.object_id, grasp) for grasp in grasps],
        notes=solid.notes,
    )


def build_object_models(specs: Iterable[ObjectSpec], params: ObjectParams, seed: int) -> dict[str, ObjectModel]:
    """Models of catalogue entries by id, through the same tables that a release holds."""
    return object_models_of([build_object(spec, params, seed) for spec in specs])


def object_models_of(tables: Iterable[ObjectTables]) -> dict[str, ObjectModel]:
    """Models of built objects by id."""
    built = list(tables)
    return object_models_from_tables(
        table_from_rows(OBJECTS, [row for t in built for row in t.objects]),
        table_from_rows(OBJECT_MESHES, [row for t in built for row in t.object_meshes]),
        table_from_rows(OBJECT_PARTS, [row for t in built for row in t.object_parts]),
        table_from_rows(STABLE_POSES, [row for t in built for row in t.stable_poses]),
        table_from_rows(GRASP_POOL, [row for t in built for row in t.grasp_pool]),
    )


def inertia_kg_m2(mesh: trimesh.Trimesh, mass_kg: float) -> Float[np.ndarray, "3 3"]:
    """Inertia about the centroid of a solid of uniform density, object axes.

    It is also used about a shifted centre of mass: the inertia of a partly filled container is smaller by at most the mass times the
    square of the shift, and the uniform one is the safe side for the solver.
    """
    return np.asarray(mesh.moment_inertia) * (mass_kg / mesh.volume)


def _object_row(
    spec: ObjectSpec,
    solid: Solid,
    mesh: TriangleMesh,
    com_m: Float[np.ndarray, "3"],
    decomposition: Decomposition,
    grasps: tuple[RatedGrasp, ...],
) -> Row:
    size, inertia = solid.mesh.extents, inertia_kg_m2(solid.mesh, spec.mass_kg)
    return {
        "object_id": spec.object_id,
        "category": spec.category.value,
        "name": spec.name,
        "source": "; ".join([spec.source, *(["its mesh was repaired"] if solid.notes else []), *solid.notes]),
        **{f"size_{axis}_m": float(size[k]) for k, axis in enumerate("xyz")},
        "mass_kg": spec.mass_kg,
        "friction": spec.friction,
        **{f"com_{axis}_m": float(com_m[k]) for k, axis in enumerate("xyz")},
        **{f"i{a}{b}_kg_m2": float(inertia["xyz".index(a), "xyz".index(b)]) for a, b in ("xx", "yy", "zz", "xy", "xz", "yz")},
        "symmetry": spec.symmetry.value,
        "mesh_volume_m3": float(solid.mesh.volume),
        "hull_volume_ratio": decomposition.volume_ratio,
        "cavity_fill": decomposition.cavity_fill,
        "handle_hole_fill": decomposition.handle_hole_fill,
        "min_graspable_width_m": min(grasp.grasp.jaw_width_m for grasp in grasps),
        "mesh_sha256": mesh_sha256([mesh]),
        "parts_sha256": decomposition.sha256,
    }


def _mesh_columns(mesh: TriangleMesh) -> Row:
    return {"vertices_m": mesh.vertices_m.ravel().tolist(), "faces": mesh.faces.ravel().tolist()}


def _pose_row(object_id: str, pose: StablePose) -> Row:
    return {
        "object_id": object_id,
        "stable_pose_id": pose.stable_pose_id,
        "resting": pose.resting,
        "probability": pose.probability,
        **dict(zip(pose_columns("rest"), pose_of(pose.T_plane_object).tolist(), strict=True)),
    }


def _grasp_row(object_id: str, rated: RatedGrasp) -> Row:
    return {
        "object_id": object_id,
        "grasp_id": rated.grasp.grasp_id,
        "grasp_kind": rated.grasp.grasp_kind,
        **dict(zip(pose_columns("objectgrasp"), pose_of(rated.grasp.T_object_grasp).tolist(), strict=True)),
        "jaw_width_m": rated.grasp.jaw_width_m,
        "cone_margin_rad": rated.cone_margin_rad,
        "com_distance_m": rated.com_distance_m,
    }
