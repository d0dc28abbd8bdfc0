"""Convex parts of a solid by CoACD, the fewest that pass the gates; see solids.py for the solid itself.

CoACD cuts only along the coordinate planes, which wastes parts on a ring: 20 parts fill 5 % of the cavity of a mug. So it gets a
hint, how the mug is made: floor, wall sectors and handle are handed to it one by one, and it decides how many hulls each needs. 12 sectors
fill 4.5 % (1 - sin(a)/a for sectors of angle a), 10 fill 6.5 %, 16 fill 2.6 %.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
from scipy.spatial import ConvexHull

from objects.catalogue import CanShape, CuboidShape, MugShape, ObjectSpec
from objects.coacd_process import CoacdProcess
from objects.errors import MeshError, ObjectParamsError
from objects.mug import floor_piece, handle_segments, wall_sectors
from objects.object_model import TriangleMesh
from objects.solids import Solid

# Of a round part, what may stick out of the vertices that are kept: less than the gate below, which is for all parts together.
LEAN_M = 0.0004
# What is left out makes the parts of a round mesh a little smaller than it; with less than this they are no likeness of it.
MIN_MESH_VOLUME_RATIO = 0.95


@dataclass(frozen=True, slots=True)
class DecompositionParams:
    """Settings of the search, tried from few parts to many, and the gates that end it."""

    # Wall sectors of a mug; all but 8 divide the 60 facets of the body.
    wall_sectors: tuple[int, ...] = (8, 10, 12, 15, 20)
    # Segments of the handle of a mug, cut where it has turned by equal angles.
    handle_segments: tuple[int, ...] = (3, 4, 5, 6, 8)
    # Concavity threshold of CoACD: the first for the pieces of a mug, all in turn for the mesh of a user.
    thresholds: tuple[float, ...] = (0.2, 0.15, 0.1, 0.07, 0.05, 0.03, 0.02)
    # A third of the default search of CoACD: the same parts on these solids in a third of the time.
    mcts_iterations: int = 60
    mcts_nodes: int = 10
    resolution: int = 1000
    max_hull_vertices: int = 128  # a disc of 60 facets has 120: with 64 a thin floor lost its lower ring, and the mug leaned 3.7 degrees
    # A finger must go in: a fill of 5 % moves the inner wall of a mug by at most 1.3 mm (12 sectors of a 74 mm cavity). Physics does not
    # ask for fewer: a pick-lift of the 11 oz mug costs 54 to 67 ms with 12, 14, 17, 20 or 27 parts.
    max_cavity_fill: float = 0.05
    max_handle_hole_fill: float = 0.10
    # Sum of hull volumes over mesh volume. Thin walls make it large (a 2.5 mm wall of 12 sectors: 1.27) while the cavity stays open.
    max_volume_ratio: float = 1.40
    # The mesh of a user has no named cavity to check: its parts must stay this close to it, or fingers would meet what is not there.
    max_mesh_volume_ratio: float = 1.08
    # A can or cuboid is its own hull: anything else is a broken solid.
    max_convex_volume_ratio: float = 1.0001
    max_parts: int = 32
    # How far the convex hull of the solid may stick out of the convex hull of the parts: an object stands on it, and half a millimetre
    # tilts a mug by a degree.
    max_missing_m: float = 0.0005

    def __post_init__(self) -> None:
        for name, low, high in (
            ("max_cavity_fill", 0.0, 1.0),
            ("max_handle_hole_fill", 0.0, 1.0),
            ("max_volume_ratio", 1.0, 10.0),
            ("max_mesh_volume_ratio", 1.0, 10.0),
            ("max_convex_volume_ratio", 1.0, 1.1),
            ("max_parts", 1, 256),
            ("max_missing_m", 0.0, 0.01),
            ("max_hull_vertices", 8, 256),
            ("mcts_iterations", 60, 2000),
            ("mcts_nodes", 10, 40),
            ("resolution", 1000, 10000),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise ObjectParamsError(f"DecompositionParams.{name} = {value}, must be in [{low}, {high}]")
        for name in ("wall_sectors", "handle_segments"):
            counts = getattr(self, name)
            if not counts or min(counts) < 3 or list(counts) != sorted(counts):
                raise ObjectParamsError(f"DecompositionParams.{name} = {counts}, must be ascending numbers >= 3")
        if not self.thresholds or list(self.thresholds) != sorted(self.thresholds, reverse=True) or self.thresholds[-1] <= 0.0:
            raise ObjectParamsError(f"DecompositionParams.thresholds = {self.thresholds}, must be descending numbers > 0")


@dataclass(frozen=True, slots=True)
class Decomposition:
    """Convex parts in the object frame and how well they stand for the solid."""

    parts: tuple[TriangleMesh, ...]
    volume_ratio: float
    cavity_fill: float | None
    handle_hole_fill: float | None
    sha256: str


def decompose(
    spec: ObjectSpec, solid: Solid, params: DecompositionParams, coacd_seed: int, progress: Callable[[str], Any] | None = None
) -> Decomposition:
    """The fewest convex parts that pass the gates.

    Args:
        coacd_seed: seed of the tree search in CoACD, in [0, 2**31).
        progress: is told what the search for the parts of a user's mesh has come to.

    Raises:
        MeshError: no setting passes; names the value that misses its bound, and the bound.
    """
    min_ratio = 0.0
    if isinstance(spec.shape, (CanShape, CuboidShape)):
        hulls = [solid.mesh.convex_hull]
        max_ratio = params.max_convex_volume_ratio
    elif isinstance(spec.shape, MugShape):
        with CoacdProcess(spec.object_id) as child:
            hulls = _mug_hulls(child, spec.shape, solid, params, coacd_seed)
        max_ratio = params.max_volume_ratio
    else:
        with CoacdProcess(spec.object_id, progress) as child:
            hulls = _mesh_hulls(child, spec.object_id, solid.mesh, params, coacd_seed, progress or _tell_nobody)
        min_ratio, max_ratio = MIN_MESH_VOLUME_RATIO, params.max_mesh_volume_ratio
    made = _made(solid, hulls)
    for said, value, low, high in (
        ("it takes {} convex parts", len(hulls), 1, params.max_parts),
        ("its convex parts have {} times its volume", made.volume_ratio, min_ratio, max_ratio),
        ("its convex parts fill {} of its cavity", made.cavity_fill, 0.0, params.max_cavity_fill),
        ("its convex parts fill {} of its handle hole", made.handle_hole_fill, 0.0, params.max_handle_hole_fill),
        ("its convex parts leave out {} mm of its outside", _missing_m(solid.mesh, hulls) * 1e3, 0.0, params.max_missing_m * 1e3),
    ):
        if value is not None and not low <= value <= high:
            raise MeshError(f"{spec.object_id}: {said.format(f'{value:.4g}')}, must be in [{low:.4g}, {high:.4g}]")
    return made


def _made(solid: Solid, hulls: Sequence[trimesh.Trimesh]) -> Decomposition:
    parts = tuple(TriangleMesh(np.array(h.vertices, dtype=np.float64), np.array(h.faces, dtype=np.int64)) for h in hulls)
    fills = fill_of(solid.cavity, hulls), fill_of(solid.handle_hole, hulls)
    return Decomposition(parts, _volume_ratio(solid.mesh, hulls), *fills, mesh_sha256(parts))


def _tell_nobody(_: str) -> None:
    pass


def fill_of(volume: trimesh.Trimesh | None, hulls: Sequence[trimesh.Trimesh]) -> float | None:
    """Share of a volume that the union of hulls covers, by exact booleans; None without a volume."""
    if volume is None:
        return None
    inside = [trimesh.boolean.intersection([volume, hull], engine="manifold", check_volume=False) for hull in hulls]
    inside = [piece for piece in inside if len(piece.faces)]
    if not inside:
        return 0.0
    return float(trimesh.boolean.union(inside, engine="manifold", check_volume=False).volume / volume.volume)


def _missing_m(mesh: trimesh.Trimesh, hulls: Sequence[trimesh.Trimesh]) -> float:
    planes = ConvexHull(np.concatenate([hull.vertices for hull in hulls])).equations
    return max(0.0, float((mesh.vertices @ planes[:, :3].T + planes[:, 3]).max()))


def mesh_sha256(meshes: Sequence[TriangleMesh]) -> str:
    """SHA-256 of vertices (to the bit) and faces of meshes in order."""
    digest = hashlib.sha256()
    for mesh in meshes:
        digest.update(np.ascontiguousarray(mesh.vertices_m, dtype="<f8").tobytes())
        digest.update(np.ascontiguousarray(mesh.faces, dtype="<i8").tobytes())
    return digest.hexdigest()


def _mug_hulls(child: CoacdProcess, shape: MugShape, solid: Solid, params: DecompositionParams, coacd_seed: int) -> list[trimesh.Trimesh]:
    """Fewest hulls of the body that keep the cavity open, then fewest hulls of the handle that keep its hole open."""
    body: list[trimesh.Trimesh] = []
    for n_sectors in params.wall_sectors:
        body = _hulls(child, [floor_piece(shape), *wall_sectors(shape, n_sectors)], params.thresholds[0], params, coacd_seed)
        if (fill_of(solid.cavity, body) or 0.0) <= params.max_cavity_fill:
            break
    handle: list[trimesh.Trimesh] = []
    for n_segments in params.handle_segments:
        handle = _hulls(child, handle_segments(shape, n_segments), params.thresholds[0], params, coacd_seed)
        if (fill_of(solid.handle_hole, handle) or 0.0) <= params.max_handle_hole_fill:
            break
    return [*body, *handle]


def _mesh_hulls(
    child: CoacdProcess,
    object_id: str,
    mesh: trimesh.Trimesh,
    params: DecompositionParams,
    coacd_seed: int,
    progress: Callable[[str], Any],
) -> list[trimesh.Trimesh]:
    """Fewest hulls of the mesh of a user whose volume is close enough; the hull of the whole mesh where that already is."""
    if _volume_ratio(mesh, [mesh.convex_hull]) <= params.max_convex_volume_ratio:
        return [_lean(mesh.convex_hull, params.max_hull_vertices)]
    hulls: list[trimesh.Trimesh] = []
    for threshold in params.thresholds:
        # Its own decimation takes 7 % of a ball away.
        hulls = _hulls(child, [mesh], threshold, params, coacd_seed, decimate=False)
        hulls = [_lean(hull, params.max_hull_vertices) for hull in hulls]
        ratio = _volume_ratio(mesh, hulls)
        progress(f"{object_id}: {len(hulls)} convex parts at threshold {threshold} have {ratio:.3f} times the volume of the mesh")
        # A finer threshold takes more parts.
        if ratio <= params.max_mesh_volume_ratio or len(hulls) > params.max_parts:
            break
    return hulls


def _lean(hull: trimesh.Trimesh, max_vertices: int) -> trimesh.Trimesh:
    """A convex hull of too many vertices by those farthest along evenly spread directions, as many as it takes to get within LEAN_M."""
    vertices = np.asarray(hull.vertices)
    n_directions = max_vertices
    while n_directions < len(vertices):
        z = 1.0 - (2.0 * np.arange(n_directions) + 1.0) / n_directions  # Fibonacci's lattice on the sphere
        turn, radius = np.arange(n_directions) * np.pi * (3.0 - 5.0**0.5), np.sqrt(1.0 - z**2)
        along = vertices @ np.stack([radius * np.cos(turn), radius * np.sin(turn), z])
        lean: trimesh.Trimesh = trimesh.convex.convex_hull(vertices[np.unique(along.argmax(axis=0))])
        if _missing_m(hull, [lean]) <= LEAN_M:
            return lean
        n_directions = n_directions * 5 // 4
    return hull


def _hulls(
    child: CoacdProcess,
    meshes: Sequence[trimesh.Trimesh],
    threshold: float,
    params: DecompositionParams,
    coacd_seed: int,
    decimate: bool = True,
) -> list[trimesh.Trimesh]:
    """Hulls that CoACD splits each mesh into."""
    parts = child.split(
        meshes,
        threshold=threshold,
        preprocess_mode="off",  # its voxel remeshing would round the edges off; the solid is watertight already
        resolution=params.resolution,
        mcts_iterations=params.mcts_iterations,
        mcts_nodes=params.mcts_nodes,
        decimate=decimate,
        max_ch_vertex=params.max_hull_vertices,
        seed=coacd_seed,
    )
    return [trimesh.convex.convex_hull(vertices) for vertices in parts]


def _volume_ratio(mesh: trimesh.Trimesh, hulls: Sequence[trimesh.Trimesh]) -> float:
    return float(sum(hull.volume for hull in hulls) / mesh.volume)
