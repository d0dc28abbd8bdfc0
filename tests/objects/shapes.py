"""Catalogue entries made by hand for the tests of the objects room."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
import trimesh

from objects.catalogue import CanShape, CuboidShape, MeshShape, MugShape, ObjectSpec, Shape
from objects.errors import MeshError
from objects.user_mesh import user_mesh
from tables.vocabulary import Category, Symmetry

MUG_SHAPE = MugShape(
    diameter_m=0.082, height_m=0.095, wall_m=0.0045, base_m=0.007, handle_reach_m=0.036, handle_height_m=0.070,
    handle_thickness_m=0.010, handle_width_m=0.014, base_diameter_m=0.082,
)  # fmt: skip

FORMATS = ("stl", "ply", "obj")

_CATEGORY = {CanShape: Category.CAN, MugShape: Category.MUG, CuboidShape: Category.CUBOID, MeshShape: Category.MESH}
_SYMMETRY = {CanShape: Symmetry.REVOLUTION_Z, MugShape: Symmetry.NONE, CuboidShape: Symmetry.BOX, MeshShape: Symmetry.NONE}


def spec_of(shape: Shape, object_id: str = "thing", mass_kg: float = 0.2, com_z_m: float = 0.0) -> ObjectSpec:
    return ObjectSpec(object_id, _CATEGORY[type(shape)], "name", "source", shape, mass_kg, 0.8, _SYMMETRY[type(shape)], (0.0, 0.0, com_z_m))


def mesh_spec(path: Path, scale: float = 1.0, object_id: str = "own") -> ObjectSpec:
    return spec_of(MeshShape(path, scale), object_id)


def figure_eight(radius_m: float, reach_m: float = 0.04, n_along: int = 64, n_around: int = 16) -> trimesh.Trimesh:
    """A closed tube of one piece whose middle line is an eight: it runs through itself in the middle."""
    t, s = np.linspace(0, 2 * np.pi, n_along, endpoint=False), np.linspace(0, 2 * np.pi, n_around, endpoint=False)
    middle = reach_m * np.stack([np.sin(t), np.sin(t) * np.cos(t), 0 * t], axis=1)
    across = np.stack([-np.cos(2 * t), np.cos(t), 0 * t], axis=1)
    across /= np.linalg.norm(across, axis=1)[:, None]
    ring = np.cos(s)[:, None] * across[:, None] + np.sin(s)[:, None] * [0.0, 0.0, 1.0]
    i, j = (k.ravel() for k in np.meshgrid(np.arange(n_along), np.arange(n_around), indexing="ij"))
    along, around = (i + 1) % n_along, (j + 1) % n_around
    a, b, c, d = (p * n_around + q for p, q in ((i, j), (along, j), (i, around), (along, around)))
    faces = np.concatenate([np.stack([a, c, b], axis=1), np.stack([b, c, d], axis=1)])
    return trimesh.Trimesh((middle[:, None] + radius_m * ring).reshape(-1, 3), faces, process=False)


def bumpy_ball(subdivisions: int) -> trimesh.Trimesh:
    """A ball whose every vertex stands in or out by up to a tenth: no few convex parts are near it."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.03)
    ball.vertices *= np.random.default_rng(0).uniform(0.9, 1.1, (len(ball.vertices), 1))
    return ball


def outcome(mesh: trimesh.Trimesh, suffix: str, seed: int = 0) -> float | str:
    """The volume in cm3, or why not, of a file of the mesh with its faces in random order."""
    rng = np.random.default_rng(seed)
    faces = np.array([np.roll(face, rng.integers(3)) for face in mesh.faces[rng.permutation(len(mesh.faces))]])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"own.{suffix}"
        trimesh.Trimesh(mesh.vertices, faces, process=False).export(path)
        try:
            return float(user_mesh("own", MeshShape(path)).mesh.volume) * 1e6
        except MeshError as error:
            return str(error).replace(str(path), "")


def agreed(mesh: trimesh.Trimesh, n_orders: int = 2) -> float | str:
    """The outcome that all formats and orders come to."""
    found = [outcome(mesh, suffix, seed) for suffix in FORMATS for seed in range(n_orders)]
    if isinstance(found[0], str):
        assert all(isinstance(one, str) and one.split(",")[0] == found[0].split(",")[0] for one in found), found
    else:
        assert found == pytest.approx([found[0]] * len(found), rel=1e-4)  # STL and PLY hold single precision
    return found[0]
