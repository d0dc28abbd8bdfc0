"""Catalogue entries made by hand for the tests of the objects room."""

from __future__ import annotations

from pathlib import Path

from objects.catalogue import CanShape, CuboidShape, MeshShape, MugShape, ObjectSpec, Shape
from tables.vocabulary import Category, Symmetry

MUG_SHAPE = MugShape(
    diameter_m=0.082, height_m=0.095, wall_m=0.0045, base_m=0.007, handle_reach_m=0.036, handle_height_m=0.070,
    handle_thickness_m=0.010, handle_width_m=0.014, base_diameter_m=0.082,
)  # fmt: skip

_CATEGORY = {CanShape: Category.CAN, MugShape: Category.MUG, CuboidShape: Category.CUBOID, MeshShape: Category.MESH}
_SYMMETRY = {CanShape: Symmetry.REVOLUTION_Z, MugShape: Symmetry.NONE, CuboidShape: Symmetry.BOX, MeshShape: Symmetry.NONE}


def spec_of(shape: Shape, object_id: str = "thing", mass_kg: float = 0.2, com_z_m: float = 0.0) -> ObjectSpec:
    return ObjectSpec(object_id, _CATEGORY[type(shape)], "name", "source", shape, mass_kg, 0.8, _SYMMETRY[type(shape)], (0.0, 0.0, com_z_m))


def mesh_spec(path: Path, scale: float = 1.0, object_id: str = "own") -> ObjectSpec:
    return spec_of(MeshShape(path, scale), object_id)
