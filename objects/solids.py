"""Watertight solids of catalogue objects and of mesh files that users bring; see decomposition.py for their convex parts.

Object frame: origin at the centre of the bounding box of the body (of a mug: the body without its handle), z the axis of the
body when upright, the handle of a mug along +x.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh

from objects.catalogue import CanShape, CuboidShape, MeshShape, ObjectSpec
from objects.errors import MeshError
from objects.mug import mug_cavity, mug_handle_hole, mug_mesh

# 48 facets: a lying can rocks by at most 3.75 degrees and its radius varies by 0.2 %, while a hull has only 96 vertices.
N_CAN_FACETS = 48

# A household object that a 0.08 m jaw can take: a mesh beyond these bounds was almost surely exported in millimetres or inches.
MIN_EXTENT_M, MAX_EXTENT_M = 0.010, 0.400
# Decomposition and ray casting take seconds at this size, minutes beyond.
MAX_FACES = 20_000


@dataclass(frozen=True, slots=True)
class Solid:
    """A watertight mesh in the object frame and the volumes that a mug must keep open."""

    mesh: trimesh.Trimesh
    cavity: trimesh.Trimesh | None = None
    handle_hole: trimesh.Trimesh | None = None


def solid_of(spec: ObjectSpec) -> Solid:
    """The solid of a catalogue entry.

    Raises:
        MeshError: a mesh file that cannot be read, is not watertight or has an implausible extent.
    """
    shape = spec.shape
    if isinstance(shape, CanShape):
        solid = Solid(trimesh.creation.cylinder(radius=shape.diameter_m / 2, height=shape.height_m, sections=N_CAN_FACETS))
    elif isinstance(shape, CuboidShape):
        solid = Solid(trimesh.creation.box(extents=shape.size_m))
    elif isinstance(shape, MeshShape):
        solid = Solid(_user_mesh(spec.object_id, shape))
    else:
        solid = Solid(mug_mesh(shape), mug_cavity(shape), mug_handle_hole(shape))
    if not solid.mesh.is_watertight or solid.mesh.volume <= 0.0:
        raise MeshError(
            f"{spec.object_id}: mesh is not watertight ({_n_open_edges(solid.mesh)} edges without exactly two faces, must be 0;"
            f" volume {solid.mesh.volume:.3g} m3, must be > 0)"
        )
    for axis, extent in zip("xyz", solid.mesh.extents, strict=True):
        if not MIN_EXTENT_M <= extent <= MAX_EXTENT_M:
            raise MeshError(
                f"{spec.object_id}: extent along {axis} {extent:.4g} m, must be in [{MIN_EXTENT_M}, {MAX_EXTENT_M}] m"
                " (is the file in another unit? set scale)"
            )
    return solid


def _user_mesh(object_id: str, shape: MeshShape) -> trimesh.Trimesh:
    if not shape.path.exists():
        raise MeshError(f"{object_id}: mesh file {shape.path} does not exist")
    try:
        loaded: Any = trimesh.load_mesh(shape.path)
    except (ValueError, IndexError, KeyError, NotImplementedError) as error:
        raise MeshError(f"{object_id}: mesh file {shape.path} cannot be read: {error}") from error
    mesh = trimesh.Trimesh(loaded.vertices * shape.scale, loaded.faces, process=True)
    mesh.merge_vertices()
    if not 4 <= len(mesh.faces) <= MAX_FACES:
        raise MeshError(f"{object_id}: mesh file {shape.path} has {len(mesh.faces)} faces, must be in [4, {MAX_FACES}]")
    if mesh.is_watertight and mesh.volume < 0:
        mesh.invert()
    mesh.apply_translation(-mesh.bounds.mean(axis=0))
    return mesh


def _n_open_edges(mesh: trimesh.Trimesh) -> int:
    _, counts = np.unique(mesh.edges_sorted, axis=0, return_counts=True)
    return int(np.sum(counts != 2))
