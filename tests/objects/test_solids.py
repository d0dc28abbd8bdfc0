"""Solids: exact volumes, open cavities and handle holes, see test_user_mesh.py for mesh files."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from objects.catalogue import CanShape, CuboidShape, MugShape, load_catalogue
from objects.mug import N_BODY_FACETS, mug_cavity, mug_handle_hole, mug_mesh
from objects.solids import N_CAN_FACETS, solid_of
from tests.objects.shapes import spec_of


@st.composite
def mugs(draw: st.DrawFn) -> MugShape:
    diameter, height = draw(st.floats(0.055, 0.095)), draw(st.floats(0.055, 0.13))
    thickness, wall = draw(st.floats(0.006, 0.012)), draw(st.floats(0.002, 0.007))
    handle_height = draw(st.floats(0.5, 0.8)) * height
    return MugShape(
        diameter_m=diameter,
        height_m=height,
        wall_m=wall,
        base_m=draw(st.floats(0.003, 0.01)),
        handle_reach_m=draw(st.floats(2.2, 3.5)) * thickness,
        handle_height_m=handle_height,
        handle_thickness_m=thickness,
        handle_width_m=draw(st.floats(0.008, 0.016)),
        base_diameter_m=draw(st.floats(0.7, 1.0)) * diameter,
        handle_z_m=draw(st.floats(-0.4, 0.4)) * (height - handle_height),
        handle_squareness=draw(st.floats(2.0, 6.0)),
    )


def overlap_m3(a: trimesh.Trimesh, b: trimesh.Trimesh) -> float:
    return float(trimesh.boolean.intersection([a, b], engine="manifold", check_volume=False).volume)


@given(st.floats(0.045, 0.075), st.floats(0.03, 0.17))
def test_a_can_is_a_prism_of_the_stated_size(diameter: float, height: float) -> None:
    mesh = solid_of(spec_of(CanShape(diameter, height))).mesh
    area = N_CAN_FACETS / 2 * (diameter / 2) ** 2 * math.sin(2 * math.pi / N_CAN_FACETS)
    assert mesh.volume == pytest.approx(area * height, rel=1e-9)
    assert mesh.bounds == pytest.approx(np.array([[-1, -1, -1], [1, 1, 1]]) * [diameter / 2, diameter / 2, height / 2], rel=2e-3)


@given(st.tuples(*[st.floats(0.02, 0.2)] * 3))
def test_a_cuboid_is_a_box_about_its_centre(size: tuple[float, float, float]) -> None:
    mesh = solid_of(spec_of(CuboidShape(size))).mesh
    assert mesh.volume == pytest.approx(np.prod(size))
    assert mesh.bounds == pytest.approx(np.array([[-0.5] * 3, [0.5] * 3]) * size)


@settings(max_examples=25)
@given(mugs())
def test_a_mug_is_one_watertight_body_whose_cavity_and_handle_hole_are_empty(shape: MugShape) -> None:
    mesh, cavity, hole = mug_mesh(shape), mug_cavity(shape), mug_handle_hole(shape)
    for solid in (mesh, cavity, hole):
        assert solid.is_watertight
        assert solid.volume > 0
    assert mesh.body_count == 1
    # Rounding where the floor of one and the ceiling of the other are the same plane, and the facets of handle against hole.
    assert overlap_m3(mesh, cavity) < 1e-3 * cavity.volume
    assert overlap_m3(mesh, hole) < 2e-2 * hole.volume


@settings(max_examples=25)
@given(mugs())
def test_a_mug_has_its_stated_body_volume_and_extent(shape: MugShape) -> None:
    mesh, cavity = mug_mesh(shape), mug_cavity(shape)

    def frustum(r0: float, r1: float, height: float) -> float:
        facet = N_BODY_FACETS / (2 * math.pi) * math.sin(2 * math.pi / N_BODY_FACETS)
        return facet * math.pi * height / 3 * (r0 * r0 + r0 * r1 + r1 * r1)

    foot, brim = shape.base_diameter_m / 2, shape.diameter_m / 2
    full = trimesh.boolean.union([mesh, cavity], engine="manifold", check_volume=False)
    body = trimesh.boolean.intersection(
        [full, trimesh.creation.cylinder(radius=0.98 * foot, height=1.0, sections=64)], engine="manifold", check_volume=False
    )
    prism = 32 * (0.98 * foot) ** 2 * math.sin(2 * math.pi / 64) * shape.height_m
    assert body.volume == pytest.approx(prism, rel=2e-3), "the body, its cavity filled, has a hole"
    inner_foot = foot + (brim - foot) * shape.base_m / shape.height_m - shape.wall_m
    assert cavity.volume == pytest.approx(frustum(inner_foot, brim - shape.wall_m, shape.height_m - shape.base_m), rel=1e-6)
    assert mesh.bounds[:, 2] == pytest.approx([-shape.height_m / 2, shape.height_m / 2])
    assert mesh.bounds[0][0] == pytest.approx(-brim, rel=2e-3)
    # The widened octagon of the handle reaches 8 % of its thickness beyond the stated oval only at its ridges, never at a facet.
    assert mesh.bounds[1][0] == pytest.approx(brim + shape.handle_reach_m, abs=0.05 * shape.handle_thickness_m)
    assert mesh.bounds[:, 1] == pytest.approx([-brim, brim], rel=2e-3)


def test_every_packaged_solid_is_watertight_and_within_its_extent() -> None:
    for spec in load_catalogue():
        solid = solid_of(spec)
        assert solid.mesh.is_winding_consistent
        assert solid.mesh.body_count == 1
        assert (solid.cavity is not None) == (spec.category == "mug")
