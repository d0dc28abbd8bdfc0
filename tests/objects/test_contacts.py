"""Contact pairs: rays against closed forms, cones and widths recomputed, edges against brute force."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from objects.contacts import antipodal_pairs, perpendicular, ray_exits, sharp_edge_distance, surface_points
from objects.mug import mug_mesh
from tests.objects.shapes import MUG_SHAPE


@given(st.integers(0, 10_000))
def test_a_ray_from_inside_a_box_leaves_where_the_slab_test_says(seed: int) -> None:
    rng = np.random.default_rng(seed)
    size = rng.uniform(0.02, 0.2, 3)
    origin, direction = rng.uniform(-0.49, 0.49, 3) * size, rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    ray, point, _ = ray_exits(trimesh.creation.box(extents=size), origin[None], direction[None])
    distance = ((np.sign(direction) * size / 2 - origin) / direction).min()
    assert ray.tolist() == [0]
    assert point[0] == pytest.approx(origin + distance * direction, abs=1e-9)


def test_a_ray_across_a_mug_leaves_wall_by_wall() -> None:
    mesh = mug_mesh(MUG_SHAPE)
    # Along +y, clear of the handle, from outside the mug through both walls at half height.
    ray, point, face = ray_exits(mesh, np.array([[0.0, -0.2, 0.0]]), np.array([[0.0, 1.0, 0.0]]))
    inner, outer = MUG_SHAPE.diameter_m / 2 - MUG_SHAPE.wall_m, MUG_SHAPE.diameter_m / 2
    assert ray.tolist() == [0, 0]
    assert point[:, 1] == pytest.approx([-inner, outer], rel=2e-3)
    assert np.all(mesh.face_normals[face][:, 1] > 0.99)


def test_rays_through_shared_edges_and_corners_leave_once() -> None:
    box = trimesh.creation.box(extents=(0.1, 0.1, 0.1))
    directions = np.array([[1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [1.0, 1.0, 1.0]])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ray, _, _ = ray_exits(box, np.zeros((3, 3)), directions)
    assert ray.tolist() == [0, 1, 2]


def test_rays_that_miss_leave_nowhere() -> None:
    ray, point, face = ray_exits(trimesh.creation.box(extents=(0.1, 0.1, 0.1)), np.array([[0.0, 0.0, 0.2]]), np.array([[1.0, 0.0, 0.0]]))
    assert len(ray) == len(point) == len(face) == 0


def test_pairs_lie_on_the_surface_inside_both_cones_and_the_jaw() -> None:
    mesh = mug_mesh(MUG_SHAPE)
    cone = np.arctan(0.4)
    pairs, narrowest = antipodal_pairs(mesh, 300, cone, 0.1, 0.075, np.random.default_rng(0))
    assert len(pairs.a_m) > 100
    assert narrowest == pytest.approx(MUG_SHAPE.wall_m, rel=0.01)
    assert pairs.width_m.max() <= 0.075
    for points, normals in ((pairs.a_m, pairs.normal_a), (pairs.b_m, pairs.normal_b)):
        # Every contact lies in the plane of some face with the very normal that the pair names.
        offset = np.einsum("fj,nfj->nf", mesh.face_normals, points[:, None] - mesh.triangles[:, 0][None])
        same = (np.abs(offset) < 1e-7) & (normals @ mesh.face_normals.T > 1 - 1e-9)
        assert np.all(same.any(axis=1))
    line = (pairs.b_m - pairs.a_m) / np.linalg.norm(pairs.b_m - pairs.a_m, axis=1, keepdims=True)
    angles = [np.arccos(np.clip(np.abs(np.sum(line * n, axis=1)), 0, 1)) for n in (pairs.normal_a, pairs.normal_b)]
    assert np.max(angles) <= cone + 1e-9
    assert pairs.contact_angle_rad() == pytest.approx(np.max(angles, axis=0), abs=1e-7)
    assert np.all(np.sum(line * pairs.normal_b, axis=1) > 0), "a finger inside the wall"


def test_straight_rays_find_the_three_widths_of_a_box() -> None:
    pairs, _ = antipodal_pairs(trimesh.creation.box(extents=(0.03, 0.05, 0.07)), 400, 0.38, 0.0, 0.075, np.random.default_rng(1))
    assert sorted(set(pairs.width_m.round(9))) == [0.03, 0.05, 0.07]


def test_a_box_too_wide_for_the_jaw_has_no_pairs_and_says_how_wide() -> None:
    pairs, narrowest = antipodal_pairs(trimesh.creation.box(extents=(0.1, 0.12, 0.14)), 200, 0.38, 0.1, 0.075, np.random.default_rng(1))
    assert len(pairs.a_m) == 0
    assert narrowest == pytest.approx(0.1, rel=1e-6)


def test_the_same_draws_give_the_same_pairs() -> None:
    mesh = mug_mesh(MUG_SHAPE)
    one, two = (antipodal_pairs(mesh, 100, 0.38, 0.1, 0.075, np.random.default_rng(5))[0] for _ in range(2))
    assert one.a_m.tobytes() == two.a_m.tobytes()
    assert one.b_m.tobytes() == two.b_m.tobytes()


def test_surface_points_fall_on_faces_in_proportion_to_area() -> None:
    box = trimesh.creation.box(extents=(0.02, 0.04, 0.08))
    points, face = surface_points(box, 20_000, np.random.default_rng(0))
    assert np.abs(np.einsum("ij,ij->i", points - box.triangles[face, 0], box.face_normals[face])).max() < 1e-12
    share = np.bincount(face, minlength=12) / 20_000
    # Four standard errors of 20,000 draws.
    assert share == pytest.approx(box.area_faces / box.area, abs=4 * np.sqrt(0.25 / 20_000))


@settings(max_examples=30)
@given(st.integers(0, 10_000))
def test_edge_distance_of_a_box_is_the_distance_to_its_nearest_edge(seed: int) -> None:
    rng = np.random.default_rng(seed)
    half = rng.uniform(0.01, 0.1, 3)
    point = rng.uniform(-1, 1, 3) * half
    gaps = half - np.abs(point)
    expected = min(np.hypot(gaps[i], gaps[j]) for i, j in ((0, 1), (0, 2), (1, 2)))
    assert sharp_edge_distance(trimesh.creation.box(extents=2 * half), point[None])[0] == pytest.approx(expected)


def test_the_round_side_of_a_can_is_no_edge_and_its_rim_is() -> None:
    can = trimesh.creation.cylinder(radius=0.033, height=0.1, sections=48)
    side = np.array([[0.033, 0.0, 0.0], [0.0, 0.033, 0.03]])
    # The rim's chord lies up to 0.07 mm inside the circle.
    assert sharp_edge_distance(can, side) == pytest.approx([0.05, 0.02], abs=1e-4)


def test_a_smooth_ball_has_no_edge() -> None:
    assert sharp_edge_distance(trimesh.creation.icosphere(subdivisions=2, radius=0.03), np.zeros((1, 3)))[0] == np.inf


@given(st.integers(0, 10_000))
def test_perpendicular_completes_a_right_handed_frame(seed: int) -> None:
    axes = np.random.default_rng(seed).normal(size=(5, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    side_1, side_2 = perpendicular(axes)
    frames = np.stack([side_1, side_2, axes], axis=2)
    assert np.einsum("nij,nik->njk", frames, frames) == pytest.approx(np.tile(np.eye(3), (5, 1, 1)), abs=1e-9)
    assert np.linalg.det(frames) == pytest.approx(np.ones(5))
