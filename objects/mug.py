"""The solid of a mug from its shape, and the same solid in pieces for the decomposition; other solids are in solids.

Object frame: origin at the middle of the axis of the body, z up when upright, the handle in the xz plane along +x.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import trimesh
from jaxtyping import Float

from objects.catalogue import MugShape

# 60 divides into 10, 12, 15 and 20 equal sectors of whole facets: the decomposition cuts the wall along them.
N_BODY_FACETS = 60
N_HANDLE_RINGS = 25
N_HANDLE_SIDES = 8


def mug_mesh(shape: MugShape) -> trimesh.Trimesh:
    """Body of revolution and swept handle, joined to one watertight mesh."""
    outer, inner = _profiles(shape)
    mesh = joined([_revolved([*outer, *inner]), _swept(_handle_path(shape), shape)])
    mesh.merge_vertices()
    return mesh


def mug_cavity(shape: MugShape) -> trimesh.Trimesh:
    """The inside of the body, filled to the brim."""
    _, inner = _profiles(shape)
    return _revolved([*reversed(inner), (0.0, shape.height_m / 2)])


def mug_handle_hole(shape: MugShape) -> trimesh.Trimesh:
    """What a finger can pass through: the space between handle and wall, half the width of the handle deep."""
    outer, _ = _profiles(shape)
    path = _handle_path(shape)
    inside = path - shape.handle_thickness_m / 2 * _outward(path)
    wall_x = shape.base_diameter_m / 2 - shape.wall_m / 2
    inside = inside[inside[:, 0] > wall_x]
    outline = np.vstack([[wall_x, inside[0, 1]], inside, [wall_x, inside[-1, 1]]])
    plate = _plate(outline, shape.handle_width_m / 2)
    solid_body = _revolved([*outer, (0.0, shape.height_m / 2)])
    hole: trimesh.Trimesh = trimesh.boolean.difference([plate, solid_body], engine="manifold", check_volume=False)
    return hole


def floor_piece(shape: MugShape) -> trimesh.Trimesh:
    """The slab below the cavity; it is convex."""
    outer, inner = _profiles(shape)
    return _revolved([*outer[:2], _floor_rim(shape), inner[-1]])


def wall_sectors(shape: MugShape, n_sectors: int) -> list[trimesh.Trimesh]:
    """The wall above the floor in equal sectors, the first centred on the handle."""
    outer, inner = _profiles(shape)
    rim = _floor_rim(shape)
    wall = _revolved([rim, outer[-1], *inner[:2], rim])
    reach, tall = shape.diameter_m, shape.height_m
    pieces = []
    for k in range(n_sectors):
        edges = (np.array([k, k + 1]) - 0.5) * 2 * np.pi / n_sectors
        corners = np.vstack([[0.0, 0.0], reach * np.column_stack([np.cos(edges), np.sin(edges)])])
        wedge = trimesh.convex.convex_hull(np.vstack([np.column_stack([corners, np.full(3, z)]) for z in (-tall, tall)]))
        pieces.append(trimesh.boolean.intersection([wall, wedge], engine="manifold", check_volume=False))
    return pieces


def handle_segments(shape: MugShape, n_segments: int) -> list[trimesh.Trimesh]:
    """The handle cut across its centre line where that has turned by equal angles: straight stretches stay whole."""
    path = _handle_path(shape)
    outward = _outward(path)
    turned = np.unwrap(np.arctan2(outward[:, 1], outward[:, 0]))
    wanted = np.linspace(turned[0], turned[-1], n_segments + 1)[1:-1]
    cuts = [0, *(int(np.argmin(np.abs(turned - angle))) for angle in wanted), len(path) - 1]
    return [_swept(path, shape, slice(a, b + 1)) for a, b in pairwise(cuts) if b > a]


def joined(meshes: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    """Boolean union."""
    union: trimesh.Trimesh = trimesh.boolean.union(meshes, engine="manifold", check_volume=False)
    return union


def _profiles(shape: MugShape) -> tuple[list[tuple[float, float]], list[tuple[float, float]]]:
    """Outline (radius, z) of the body outside, from the axis up to the brim, and inside, from the brim down to the axis."""
    half, floor_z = shape.height_m / 2, shape.base_m - shape.height_m / 2
    outer = [(0.0, -half), (shape.base_diameter_m / 2, -half), (shape.diameter_m / 2, half)]
    inner = [(shape.diameter_m / 2 - shape.wall_m, half), (_floor_rim(shape)[0] - shape.wall_m, floor_z), (0.0, floor_z)]
    return outer, inner


def _floor_rim(shape: MugShape) -> tuple[float, float]:
    foot, brim = shape.base_diameter_m / 2, shape.diameter_m / 2
    return foot + (brim - foot) * shape.base_m / shape.height_m, shape.base_m - shape.height_m / 2


def _revolved(profile: list[tuple[float, float]]) -> trimesh.Trimesh:
    return trimesh.creation.revolve(np.array(profile), sections=N_BODY_FACETS)


def _handle_path(shape: MugShape) -> Float[np.ndarray, "n 2"]:
    """Centre line (x, z) of the handle: half a superellipse whose ends are buried in the middle of the wall."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, N_HANDLE_RINGS)
    power = 2.0 / shape.handle_squareness
    across = np.abs(np.cos(angle)) ** power
    along = np.sign(np.sin(angle)) * np.abs(np.sin(angle)) ** power
    z = shape.handle_z_m + (shape.handle_height_m - shape.handle_thickness_m) / 2 * along
    foot, brim = shape.base_diameter_m / 2, shape.diameter_m / 2
    buried_x = foot + (brim - foot) * (z + shape.height_m / 2) / shape.height_m - shape.wall_m / 2
    grip_x = brim + shape.handle_reach_m - shape.handle_thickness_m / 2
    return np.column_stack([buried_x + (grip_x - buried_x) * across, z])


def _outward(path: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """Unit normals of an (x, z) path that runs from bottom to top, pointing away from the mug."""
    tangent = np.gradient(path, axis=0)
    normal = np.column_stack([tangent[:, 1], -tangent[:, 0]])
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


def _swept(path: Float[np.ndarray, "n 2"], shape: MugShape, rings: slice = slice(None)) -> trimesh.Trimesh:
    """Oval tube around some rings of an (x, z) path, closed by flat caps."""
    # Half a step off the axes and widened, so that flat facets, not ridges, face the pads and lie at the stated width.
    angle = (np.arange(N_HANDLE_SIDES) + 0.5) * 2 * np.pi / N_HANDLE_SIDES
    widen = 0.5 / np.cos(np.pi / N_HANDLE_SIDES)
    centres, outward = path[rings], _outward(path)[rings]
    n_rings, n_sides = len(centres), N_HANDLE_SIDES
    xz = centres[:, None] + outward[:, None] * (widen * shape.handle_thickness_m * np.cos(angle))[None, :, None]
    y = np.broadcast_to(widen * shape.handle_width_m * np.sin(angle), (n_rings, n_sides))
    points = np.stack([xz[..., 0], y, xz[..., 1]], axis=-1).reshape(-1, 3)
    ends = np.array([[centres[k, 0], 0.0, centres[k, 1]] for k in (0, -1)])
    first, last, top = len(points), len(points) + 1, (n_rings - 1) * n_sides
    faces = []
    for k in range(n_sides):
        n = (k + 1) % n_sides
        for r in range(0, top, n_sides):
            faces += [(r + k, r + n, r + n_sides + n), (r + k, r + n_sides + n, r + n_sides + k)]
        faces += [(first, n, k), (last, top + k, top + n)]
    return _outside_out(trimesh.Trimesh(np.vstack([points, ends]), faces, process=False))


def _plate(outline: Float[np.ndarray, "n 2"], width_m: float) -> trimesh.Trimesh:
    """An (x, z) outline that is star-shaped about its mean, thickened along y."""
    n = len(outline)
    points = np.vstack([outline, outline.mean(axis=0)])
    layers = [np.column_stack([points[:, 0], np.full(n + 1, side * width_m / 2), points[:, 1]]) for side in (-1.0, 1.0)]
    faces = []
    for k in range(n):
        m = (k + 1) % n
        faces += [(n, k, m), (2 * n + 1, n + 1 + m, n + 1 + k), (k, n + 1 + k, n + 1 + m), (k, n + 1 + m, m)]
    return _outside_out(trimesh.Trimesh(np.vstack(layers), faces, process=False))


def _outside_out(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    if mesh.volume < 0.0:
        mesh.invert()
    return mesh
