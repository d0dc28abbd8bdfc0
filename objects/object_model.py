"""Everything a stage needs of one object, read back from the object tables; building it is solids' and grasp_pool's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Float, Int

from objects.errors import ObjectError
from tables.poses import matrix_of, pose_columns, rotation_angle_rad
from tables.vocabulary import Symmetry


@dataclass(frozen=True, slots=True)
class TriangleMesh:
    """Vertices in metres (object frame) and triangles."""

    vertices_m: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]


@dataclass(frozen=True, slots=True)
class StablePose:
    """A resting pose: `T_plane_object` has x = y = 0 and any yaw is equally stable."""

    stable_pose_id: int
    resting: str
    probability: float
    T_plane_object: Float[np.ndarray, "4 4"]


@dataclass(frozen=True, slots=True)
class PoolGrasp:
    """A grasp in the object frame."""

    grasp_id: int
    grasp_kind: str
    T_object_grasp: Float[np.ndarray, "4 4"]
    jaw_width_m: float


@dataclass(frozen=True, slots=True)
class ObjectModel:
    """One object: geometry, mass properties (inertia about the centre of mass, object axes), stable poses, grasp pool."""

    object_id: str
    category: str
    symmetry: Symmetry
    mass_kg: float
    friction: float
    com_m: Float[np.ndarray, "3"]
    inertia_kg_m2: Float[np.ndarray, "3 3"]
    mesh: TriangleMesh
    parts: tuple[TriangleMesh, ...]
    stable_poses: tuple[StablePose, ...]
    grasps: tuple[PoolGrasp, ...]

    def grasp(self, grasp_id: int) -> PoolGrasp:
        """A grasp of the pool; raises ObjectError where it has none of that id."""
        for grasp in self.grasps:
            if grasp.grasp_id == grasp_id:
                return grasp
        raise ObjectError(f"{self.object_id}: grasp {grasp_id}, must be one of {[grasp.grasp_id for grasp in self.grasps]}")

    def rotation_error_rad(self, R_a: Float[np.ndarray, "3 3"], R_b: Float[np.ndarray, "3 3"]) -> float:
        """Smallest rotation between two object orientations, modulo the object's symmetry, in [0, pi]."""
        if self.symmetry is Symmetry.REVOLUTION_Z:
            cosine = float(np.clip(R_a[:, 2] @ R_b[:, 2], -1.0, 1.0))
            return float(np.arctan2(np.linalg.norm(np.cross(R_a[:, 2], R_b[:, 2])), cosine))
        turns = _HALF_TURNS if self.symmetry is Symmetry.BOX else _HALF_TURNS[:1]
        return float(rotation_angle_rad(R_a @ turns, R_b).min())


_HALF_TURNS = np.stack([np.diag(d) for d in ([1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0])])


def object_models_from_tables(
    objects: pa.Table, object_meshes: pa.Table, object_parts: pa.Table, stable_poses: pa.Table, grasp_pool: pa.Table
) -> dict[str, ObjectModel]:
    """Models of all objects by id, in the order of the `objects` table."""
    meshes = {row["object_id"]: _mesh(row) for row in object_meshes.to_pylist()}
    parts, poses, grasps = _grouped(object_parts), _grouped(stable_poses), _grouped(grasp_pool)
    object_models = {}
    for row in objects.to_pylist():
        object_id = row["object_id"]
        ixx, iyy, izz, ixy, ixz, iyz = (row[f"{name}_kg_m2"] for name in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"))
        object_models[object_id] = ObjectModel(
            object_id=object_id,
            category=row["category"],
            symmetry=Symmetry(row["symmetry"]),
            mass_kg=row["mass_kg"],
            friction=row["friction"],
            com_m=np.array([row["com_x_m"], row["com_y_m"], row["com_z_m"]]),
            inertia_kg_m2=np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]]),
            mesh=meshes[object_id],
            parts=tuple(_mesh(part) for part in parts[object_id]),
            stable_poses=tuple(StablePose(p["stable_pose_id"], p["resting"], p["probability"], _pose(p, "rest")) for p in poses[object_id]),
            grasps=tuple(PoolGrasp(g["grasp_id"], g["grasp_kind"], _pose(g, "objectgrasp"), g["jaw_width_m"]) for g in grasps[object_id]),
        )
    return object_models


def _grouped(table: pa.Table) -> dict[str, list[dict[str, Any]]]:
    groups: dict[str, list[dict[str, Any]]] = {}
    for row in table.to_pylist():
        groups.setdefault(row["object_id"], []).append(row)
    return groups


def _mesh(row: Mapping[str, Any]) -> TriangleMesh:
    return TriangleMesh(np.array(row["vertices_m"]).reshape(-1, 3), np.array(row["faces"], dtype=np.int64).reshape(-1, 3))


def _pose(row: Mapping[str, Any], prefix: str) -> Float[np.ndarray, "4 4"]:
    return matrix_of(np.array([row[name] for name in pose_columns(prefix)], dtype=np.float64))
