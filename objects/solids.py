"""Watertight solids of catalogue objects; see user_mesh.py for mesh files that users bring and decomposition.py for convex parts.

Object frame: origin at the centre of the bounding box of the body (of a mug: the body without its handle), z the axis of the
body when upright, the handle of a mug along +x.
"""

from __future__ import annotations

from dataclasses import dataclass

import trimesh

from objects.catalogue import CanShape, CuboidShape, MeshShape, ObjectSpec
from objects.errors import MeshError
from objects.mesh_repair import n_open_edges
from objects.mug import mug_cavity, mug_handle_hole, mug_mesh
from objects.user_mesh import check_extents, user_mesh

# 48 facets: a lying can rocks by at most 3.75 degrees and its radius varies by 0.2 %, while a hull has only 96 vertices.
N_CAN_FACETS = 48


@dataclass(frozen=True, slots=True)
class Solid:
    """A watertight mesh in the object frame, the volumes that a mug must keep open, and what was changed of a user's mesh."""

    mesh: trimesh.Trimesh
    cavity: trimesh.Trimesh | None = None
    handle_hole: trimesh.Trimesh | None = None
    notes: tuple[str, ...] = ()


def solid_of(spec: ObjectSpec) -> Solid:
    """The solid of a catalogue entry.

    Raises:
        MeshError: a mesh file that is no single closed body of a plausible extent.
    """
    shape = spec.shape
    if isinstance(shape, CanShape):
        solid = Solid(trimesh.creation.cylinder(radius=shape.diameter_m / 2, height=shape.height_m, sections=N_CAN_FACETS))
    elif isinstance(shape, CuboidShape):
        solid = Solid(trimesh.creation.box(extents=shape.size_m))
    elif isinstance(shape, MeshShape):
        repaired = user_mesh(spec.object_id, shape)
        solid = Solid(repaired.mesh, notes=repaired.notes)
    else:
        solid = Solid(mug_mesh(shape), mug_cavity(shape), mug_handle_hole(shape))
    if not solid.mesh.is_watertight or solid.mesh.volume <= 0.0:
        raise MeshError(
            f"{spec.object_id}: mesh is not watertight ({n_open_edges(solid.mesh)} edges without exactly two faces, must be 0;"
            f" volume {solid.mesh.volume:.3g} m3, must be > 0)"
        )
    check_extents(spec.object_id, solid.mesh.extents)
    return solid
