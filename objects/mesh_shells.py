"""The connected surfaces of a welded mesh: faces there twice, bodies glued where they touch, faces wound both ways; holes stay.

Bodies that touch along an edge or a side are glued by welding: more than two faces share an edge then. Round the edge, faces where a solid
begins and where one ends take turns, and each goes with the next; where they do not take turns, the edge stays as it is.
"""

from __future__ import annotations

import numpy as np
import trimesh
from jaxtyping import Bool, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

# Two faces at an edge that are nearer than this, radians, lie on each other: single precision moves a face of a millimetre by less.
_SAME_ANGLE = 1e-3


def shells_of(mesh: trimesh.Trimesh) -> tuple[list[trimesh.Trimesh], list[str]]:
    """The connected surfaces of a mesh, the faces of each wound alike."""
    mesh, notes = _parted(mesh)
    shells = list(mesh.split(only_watertight=False))
    if len(shells) == 1:
        shells = [mesh]
    twisted = [shell for shell in shells if not shell.is_winding_consistent]
    for shell in twisted:
        trimesh.repair.fix_winding(shell)
    return shells, [*notes, "turned faces so that neighbours face the same side"] if twisted else notes


def _parted(mesh: trimesh.Trimesh) -> tuple[trimesh.Trimesh, list[str]]:
    """The mesh with two faces at an edge at most, as far as that goes."""
    if _n_shared(mesh.faces) == 0:
        return _unglued(mesh), []
    # Without faces there twice, however wound; then with those wound both ways, since the sides of two boxes that touch are no doubles.
    for alike in (np.sort(mesh.faces, axis=1), _turned_to_least(mesh.faces)):
        once = np.sort(np.unique(alike, axis=0, return_index=True)[1])
        parted = _unglued(trimesh.Trimesh(mesh.vertices, mesh.faces[once], process=False))
        if _n_shared(parted.faces) == 0:
            n_twice = len(mesh.faces) - len(once)
            return parted, [f"left out {n_twice} faces that were there twice"] if n_twice else []
    return mesh, []


def _unglued(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Faces joined two by two at their edges; those that then meet in a vertex only have each its own."""
    edges = mesh.edges
    _, group, counts = np.unique(mesh.edges_sorted, axis=0, return_inverse=True, return_counts=True)
    if np.all(counts == 2):
        return mesh
    rows = np.split(np.argsort(group, kind="stable"), np.cumsum(counts)[:-1])  # row r: the edge from corner r of all faces to the next
    outward = bool(np.linalg.det(mesh.triangles).sum() >= 0.0)
    pairs = []
    for some in rows:
        if len(some) == 2:
            pairs.append(some)
        elif len(some) > 2:
            pairs.extend(_wedges(mesh, some, outward) or [some[[0, k]] for k in range(1, len(some))])
    if not pairs:
        return mesh
    a, b = np.array(pairs).T
    a_next, b_next = (3 * (r // 3) + (r + 1) % 3 for r in (a, b))
    opposed = edges[a, 0] != edges[b, 0]
    one = np.concatenate([a, a_next])
    other = np.concatenate([np.where(opposed, b_next, b), np.where(opposed, b, b_next)])
    n_corners = len(edges)
    _, label = connected_components(coo_matrix((np.ones(len(one)), (one, other)), shape=(n_corners, n_corners)), directed=False)
    _, first = np.unique(label, return_index=True)
    return trimesh.Trimesh(mesh.vertices[mesh.faces.ravel()[first]], label.reshape(-1, 3), process=False)


def _wedges(mesh: trimesh.Trimesh, rows: Int[np.ndarray, "n"], outward: bool) -> list[Int[np.ndarray, "2"]]:
    """The faces at an edge in pairs that have solid between them; none where faces do not begin and end one in turn."""
    start, end = mesh.edges_sorted[rows[0]]
    along = mesh.vertices[end] - mesh.vertices[start]
    along /= np.linalg.norm(along)
    out = mesh.vertices[mesh.faces.ravel()[3 * (rows // 3) + (rows + 2) % 3]] - mesh.vertices[start]
    x = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
    angle = np.arctan2(out @ np.cross(along, x), out @ x)
    # A face that runs from the lesser vertex to the greater looks to greater angles: solid ends there.
    begins: Bool[np.ndarray, "n"] = (mesh.edges[rows, 0] != start) == outward
    order = np.argsort(angle)
    gaps = np.diff(angle[order], append=angle[order[0]] + 2 * np.pi)
    order, gaps = (np.roll(values, -int(np.argmax(gaps)) - 1) for values in (order, gaps))
    place = np.concatenate([[0], np.cumsum(gaps[:-1] > _SAME_ANGLE)])
    order = order[np.lexsort((begins[order], place))]  # of two that lie on each other, one solid ends before the next begins
    if len(rows) % 2 or np.any(begins[order] == np.roll(begins[order], 1)):
        return []
    if not begins[order[0]]:
        order = np.roll(order, -1)
    return list(rows[order].reshape(-1, 2))


def _turned_to_least(faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "f 3"]:
    """Faces from their least vertex on, wound as they were."""
    at = (np.argmin(faces, axis=1)[:, None] + np.arange(3)) % 3
    return np.take_along_axis(faces, at, axis=1)


def _n_shared(faces: Int[np.ndarray, "f 3"]) -> int:
    """Edges of more than two faces."""
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    return int(np.sum(np.unique(edges, axis=0, return_counts=True)[1] > 2))
