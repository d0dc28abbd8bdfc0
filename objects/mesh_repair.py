"""Repairs of triangle meshes by trimesh and manifold3d, each with a note of what it did; user_mesh.py decides which are asked for.

Shells are mesh_shells.py's, holes mesh_holes.py's. Bodies that overlap are joined and faces saved by exact booleans (manifold3d). Of our
own is the test whether a mesh runs through itself: manifold3d takes it for granted that a mesh does not.
"""

from __future__ import annotations

from typing import Any

import manifold3d
import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int

# Vertices nearer than this, 0.01 mm, are one: a seam that a file in single precision, or one of rounded digits, leaves open.
WELD_DIGITS = 5
# By how much simplifying may move a surface, tried in turn: half a millimetre is what stands an object askew by a degree.
SIMPLIFY_M = (2e-5, 5e-5, 1e-4, 2e-4, 3e-4, 5e-4)
# A crossing counts where an edge passes a face by more than a micrometre: less is rounding where two parts touch.
_CROSSING_M = 1e-6
_MIN_SHELL_SHARE = 1e-9  # a shell of less of the volume of the largest is flat
_EDGES_AT_ONCE = 512
SLABS = (2, 3, 4, 6)  # along each axis, of a mesh that is taken apart where it runs through itself


def welded(mesh: trimesh.Trimesh) -> tuple[trimesh.Trimesh, list[str]]:
    """Equal vertices as one, and those of a seam too where edges are open; faces that collapse are gone."""
    mesh = mesh.copy()
    mesh.merge_vertices()
    _drop_collapsed(mesh)
    if not (n_open := n_open_edges(mesh)):
        return mesh, []
    seamless = mesh.copy()
    seamless.merge_vertices(digits_vertex=WELD_DIGITS)
    _drop_collapsed(seamless)
    n_left = n_open_edges(seamless)
    if n_left >= n_open:
        return mesh, []
    return seamless, [f"welded vertices within 0.01 mm, which closed {n_open - n_left} of {n_open} open edges"]


def joined(shells: list[trimesh.Trimesh]) -> tuple[list[trimesh.Trimesh], list[str]]:
    """The bodies that closed shells bound once those that overlap or touch are one."""
    notes: list[str] = []
    solids, voids_m3 = [], []
    sizes_m3 = [abs(volume_m3([shell])) for shell in shells]
    # manifold3d refuses a loose face with its cap, and all other bodies with it.
    shells = [shell for shell, size_m3 in zip(shells, sizes_m3, strict=True) if size_m3 > _MIN_SHELL_SHARE * max(sizes_m3)]
    for k, shell in enumerate(shells):
        if shell.volume < 0.0:
            # What lies within another adds nothing to the union, so that only the note depends on this.
            if any(_lies_within(shell, other) for j, other in enumerate(shells) if j != k and other.volume > 0.0):
                voids_m3.append(-float(shell.volume))
            else:
                notes = ["turned right side out"]
            shell = shell.copy()
            shell.invert()
        solids.append(shell)
    if voids_m3:
        several, cm3 = "s" if len(voids_m3) > 1 else "", sum(voids_m3) * 1e6
        notes.append(f"filled {len(voids_m3)} sealed void{several} of {cm3:.4g} cm3, so that its inertia is that of a solid")
    if len(solids) <= 1:
        return solids, notes
    union = manifold3d.Manifold.batch_boolean([to_manifold(solid) for solid in solids], manifold3d.OpType.Add)
    bodies = [body for body in map(from_manifold, union.decompose()) if body.volume > 0.0]
    n_solids = len(solids) - len(voids_m3)
    if len(bodies) < n_solids:
        notes.append(f"joined {n_solids} bodies that overlap or touch into {len(bodies)}")
    return bodies, notes


def simplified(mesh: trimesh.Trimesh, max_faces: int) -> tuple[trimesh.Trimesh, float]:
    """The mesh with its surface moved by no more than it takes to get to `max_faces`, and by how many metres; at most SIMPLIFY_M[-1]."""
    solid = to_manifold(mesh)
    fewer = solid
    for moved_m in SIMPLIFY_M:
        fewer = solid.simplify(moved_m)
        if fewer.num_tri() <= max_faces:
            break
    return from_manifold(fewer), moved_m


def uncrossed(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """A mesh that runs through itself as a union of its pieces, cut into ever more slabs along each axis until nothing crosses.

    Pieces that were far apart on the surface are separate bodies then, and their union is exact; a fold within one piece stays.
    """
    whole = mesh
    for n_slabs in SLABS:
        pieces = [to_manifold(mesh)]
        for axis in range(3):
            normal = np.eye(3)[axis].tolist()
            low_m, high_m = mesh.bounds[:, axis].tolist()
            for offset in np.linspace(low_m, high_m, n_slabs + 1)[1:-1]:
                halves = [half for piece in pieces for half in piece.split_by_plane(normal, float(offset))]
                pieces = [part for half in halves if not half.is_empty() for part in half.decompose()]
        union = manifold3d.Manifold.batch_boolean(pieces, manifold3d.OpType.Add)
        # The others are slivers without volume, left where cuts meet.
        whole = from_manifold(max(union.decompose(), key=lambda body: float(body.volume())).simplify(_CROSSING_M))
        if not crossed_edges(whole):
            break
    return whole


def volume_m3(shells: list[trimesh.Trimesh]) -> float:
    """Signed volume that closed shells bound; trimesh's own warns where it is nothing."""
    triangles = np.concatenate([shell.triangles for shell in shells])
    return float(np.linalg.det(triangles - triangles.mean(axis=(0, 1))).sum() / 6.0)


def n_open_edges(mesh: trimesh.Trimesh) -> int:
    """Edges that have not exactly two faces."""
    _, counts = np.unique(mesh.edges_sorted, axis=0, return_counts=True)
    return int(np.sum(counts != 2))


def crossed_edges(mesh: trimesh.Trimesh) -> int:
    """How many edges pass through a face that they have no vertex in common with."""
    edges, faces = mesh.edges_unique, mesh.faces
    edges = edges[np.argsort(mesh.vertices[edges, 0].min(axis=1), kind="stable")]
    low, high = mesh.triangles.min(axis=1), mesh.triangles.max(axis=1)
    n_crossed = 0
    for start in range(0, len(edges), _EDGES_AT_ONCE):
        some = edges[start : start + _EDGES_AT_ONCE]
        ends = mesh.vertices[some]
        edge_low, edge_high = ends.min(axis=1), ends.max(axis=1)
        near = np.flatnonzero(np.all((low <= edge_high.max(axis=0)) & (high >= edge_low.min(axis=0)), axis=1))
        meets = np.ones((len(some), len(near)), dtype=bool)
        for k in range(3):
            meets &= (low[near, k] <= edge_high[:, k, None]) & (high[near, k] >= edge_low[:, k, None])
        edge, face = np.nonzero(meets)
        face = near[face]
        apart = ~np.any(some[edge][:, :, None] == faces[face][:, None, :], axis=(1, 2))
        edge, face = edge[apart], face[apart]
        n_crossed += len(np.unique(edge[_passes(ends[edge], mesh.triangles[face])]))
    return n_crossed


def _passes(segments: Float[np.ndarray, "n 2 3"], triangles: Float[np.ndarray, "n 3 3"]) -> Bool[np.ndarray, "n"]:
    """Whether each segment passes through the inside of its triangle."""
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area = np.linalg.norm(normal, axis=1)
    unit = normal / np.maximum(area, 1e-30)[:, None]
    side_a, side_b = (np.einsum("ij,ij->i", segments[:, k] - triangles[:, 0], unit) for k in (0, 1))
    opposite = (np.minimum(side_a, side_b) < -_CROSSING_M) & (np.maximum(side_a, side_b) > _CROSSING_M)
    t = side_a / np.where(opposite, side_a - side_b, 1.0)
    point = segments[:, 0] + t[:, None] * (segments[:, 1] - segments[:, 0])
    inside = opposite & (area > 1e-16)
    for k in range(3):
        along = triangles[:, (k + 1) % 3] - triangles[:, k]
        inward = np.cross(unit, along / np.maximum(np.linalg.norm(along, axis=1), 1e-30)[:, None])
        inside &= np.einsum("ij,ij->i", point - triangles[:, k], inward) > -1e-9  # through a side counts: what is symmetric crosses there
    return np.asarray(inside)


def to_manifold(mesh: trimesh.Trimesh) -> Any:
    """The mesh as a manifold3d solid."""
    # Copies: trimesh hands out some arrays read-only, and those are refused.
    vertices: Float[np.ndarray, "v 3"] = np.array(mesh.vertices, dtype=np.float64, order="C")
    faces: Int[np.ndarray, "f 3"] = np.array(mesh.faces, dtype=np.uint64, order="C")
    return manifold3d.Manifold(manifold3d.Mesh64(vertices, faces))


def from_manifold(solid: Any) -> trimesh.Trimesh:
    """A manifold3d solid as a mesh."""
    content = solid.to_mesh64()
    return trimesh.Trimesh(np.asarray(content.vert_properties)[:, :3], np.asarray(content.tri_verts, dtype=np.int64), process=False)


def _lies_within(shell: trimesh.Trimesh, other: trimesh.Trimesh) -> bool:
    """Whether a shell inside out is in another, which winds round a point in it then (solid angle of Van Oosterom and Strackee, 1983)."""
    face = int(np.argmax(shell.area_faces))
    point = shell.triangles_center[face] + _CROSSING_M * shell.face_normals[face]
    a, b, c = np.moveaxis(other.triangles - point, 1, 0)
    la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
    dots = [np.einsum("ij,ij->i", p, q) * length for p, q, length in ((a, b, lc), (b, c, la), (c, a, lb))]
    angles = 2.0 * np.arctan2(np.einsum("ij,ij->i", a, np.cross(b, c)), la * lb * lc + dots[0] + dots[1] + dots[2])
    return bool(angles.sum() > 2.0 * np.pi)


def _drop_collapsed(mesh: trimesh.Trimesh) -> None:
    faces = mesh.faces
    mesh.update_faces((faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0]))
    mesh.remove_unreferenced_vertices()
