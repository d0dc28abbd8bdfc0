"""Caps over the holes of a mesh where a cap can hardly be wrong; user_mesh.py refuses what stays open or may have held too much.

The volume of an open mesh is not known: a sum over its faces depends on the origin. So a hole is judged by its rim alone. A rim that lies
in a plane is capped there; one that is bent, such as that of two faces gone across an edge of a box, has caps of several volumes. What was
over a hole is not known either: a half ball is reckoned, which is more than a smooth surface or a corner has there.
"""

from __future__ import annotations

from dataclasses import dataclass

import manifold3d
import numpy as np
import trimesh
from jaxtyping import Float, Int

# Of the diagonal of the bounding box. The rim of two neighbours of the 320 faces of a ball is bent by 0.8 %, of the 4212 of a scanned duck
# by 0.4 %, of two across the edge of a can or of a mug by 2.5 % and more.
MAX_BEND_SHARE = 0.01
# Of the diagonal squared: a face of a cap that is turned over by less is one of rounding, where the rim runs straight.
_TURNED_SHARE = 1e-9


@dataclass(frozen=True, slots=True)
class Closing:
    """Shells with the caps that could be made, and how sure that is.

    Attributes:
        why_not: why some holes were left open, empty where none was.
        doubt_m3: what all holes may have held: half balls over them, and what bent rims leave open.
    """

    shells: list[trimesh.Trimesh]
    notes: list[str]
    why_not: str = ""
    doubt_m3: float = 0.0


def closed(shells: list[trimesh.Trimesh]) -> Closing:
    """Each shell with flat caps over its holes; the same caps in whatever order faces and vertices come."""
    n_open = sum(len(_rim_edges(shell)) for shell in shells)
    if not n_open:
        return Closing(shells, [])
    bounds = np.array([shell.bounds for shell in shells])
    size_m = float(np.linalg.norm(bounds[:, 1].max(axis=0) - bounds[:, 0].min(axis=0)))
    whole, areas, doubts, bends, n_crossed = [], [], [], [], 0
    for shell in shells:
        rims = _rims(shell)
        if rims is None:
            return Closing(shells, [], f"{n_open} open edges, some of which form no closed loop")
        caps = []
        for rim in rims:
            cap = _cap(shell.vertices[rim])
            n_crossed += cap.turned_m2 > _TURNED_SHARE * size_m**2
            bends.append(cap.bend_m)
            areas.append(cap.area_m2)
            doubts.append(cap.area_m2 * (cap.bend_m + 2.0 / 3.0 * np.sqrt(cap.area_m2 / np.pi)))
            caps.append(rim[cap.faces][:, ::-1])  # a neighbour runs along the common edge the other way
        whole.append(trimesh.Trimesh(shell.vertices, np.concatenate([shell.faces, *caps]), process=False))
    where = f"{n_open} open edges in {len(bends)} loop{'s' if len(bends) > 1 else ''}"
    n_bent = int(np.sum(np.array(bends) > MAX_BEND_SHARE * size_m))
    if n_bent:
        limit_mm = MAX_BEND_SHARE * size_m * 1e3
        return Closing(shells, [], f"{where}, {n_bent} bent by up to {max(bends) * 1e3:.3g} mm, must be flat within {limit_mm:.3g} mm")
    if n_crossed:
        return Closing(shells, [], f"{where}, {n_crossed} of which run over themselves")
    share = sum(areas) / sum(float(shell.area) for shell in whole)
    return Closing(whole, [f"closed holes along {n_open} open edges, {share:.2%} of the surface"], doubt_m3=float(sum(doubts)))


@dataclass(frozen=True, slots=True)
class _Cap:
    """A flat cap over a rim, its faces as places in the rim and running along it; `turned_m2` tells of a rim that crosses itself."""

    faces: Int[np.ndarray, "f 3"]
    area_m2: float
    bend_m: float
    turned_m2: float


def _cap(rim: Float[np.ndarray, "n 3"]) -> _Cap:
    """The cap in the plane that the rim is nearest to."""
    # From the least vertex to the lesser of its neighbours, so that neither the file's order nor the side that is out decides.
    order = np.roll(np.arange(len(rim)), -int(np.lexsort(rim.T[::-1])[0]))
    if tuple(rim[order[-1]]) < tuple(rim[order[1]]):
        order = np.roll(order[::-1], 1)
    centred = rim[order] - rim[order].mean(axis=0)
    axes = np.linalg.eigh(centred.T @ centred)[1].T[::-1]
    flat = centred @ axes[:2].T
    area_m2 = _area_m2(flat)
    if area_m2 < 0.0:
        flat = flat * [-1.0, 1.0]
    places = np.array(manifold3d.triangulate([np.ascontiguousarray(flat)]), dtype=np.int64).reshape(-1, 3)
    turned_m2 = sum(max(-_area_m2(flat[face]), 0.0) for face in places)
    faces = order[places]
    runs_on = (order[1] - order[0]) % len(rim) == 1
    return _Cap(faces if runs_on else faces[:, ::-1], abs(area_m2), float(np.ptp(centred @ axes[2])), turned_m2)


def _area_m2(polygon: Float[np.ndarray, "n 2"]) -> float:
    x, y = polygon.T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2.0


def _rim_edges(shell: trimesh.Trimesh) -> Int[np.ndarray, "n 2"]:
    """The edges of one face only, as the face runs along them."""
    _, first, counts = np.unique(shell.edges_sorted, axis=0, return_index=True, return_counts=True)
    return np.asarray(shell.edges[np.sort(first[counts == 1])])


def _rims(shell: trimesh.Trimesh) -> list[Int[np.ndarray, "n"]] | None:
    """The vertices along each hole, as its faces run; nothing where edges form no loops that pass each vertex once."""
    edges = _rim_edges(shell)
    following = {int(a): int(b) for a, b in edges}
    if len(following) < len(edges) or set(following) != set(following.values()):
        return None
    rims = []
    while following:
        rim = [min(following)]
        while (vertex := following.pop(rim[-1])) != rim[0]:
            rim.append(vertex)
        rims.append(np.array(rim))
    return rims
