"""Distances against slow references: corners, clamped points, sampled lines."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from scipy.spatial.transform import RigidTransform

from model.distances import box_distance_m, cloud_distance_m, lowest_corner_m, moved, segment_distance_m
from tests.strategies import transforms

_HALF_M = np.array([0.05, 0.10, 0.02])
_coordinate = st.floats(-0.3, 0.3, allow_subnormal=False)
_points = st.lists(st.tuples(_coordinate, _coordinate, _coordinate), min_size=1, max_size=12).map(lambda rows: np.array(rows))


@given(transforms(), _points)
def test_moved_agrees_with_scipy(T: np.ndarray, points: np.ndarray) -> None:
    # Poses of hypothesis are orthogonal to rounding; coordinates stay below 3 m.
    np.testing.assert_allclose(moved(T, points), RigidTransform.from_matrix(T).apply(points), rtol=0, atol=1e-14)


@given(_points, st.tuples(_coordinate, _coordinate, _coordinate))
def test_a_box_is_as_far_as_its_nearest_point_or_as_deep_as_its_nearest_face(points: np.ndarray, centre: tuple[float, ...]) -> None:
    found = box_distance_m(points[None], np.array([[centre]]), _HALF_M[None])[0, 0]
    expected = []
    for point in points - np.array(centre):
        faces = [half - sign * x for x, half in zip(point, _HALF_M, strict=True) for sign in (1.0, -1.0)]
        inside = min(faces) >= 0.0
        expected.append(-min(faces) if inside else float(np.linalg.norm(point - np.clip(point, -_HALF_M, _HALF_M))))
    assert found == pytest.approx(min(expected), abs=1e-15)


def test_a_box_is_as_far_as_trimesh_says() -> None:
    points = np.random.default_rng(5).uniform(-0.15, 0.15, (400, 3))
    mesh = trimesh.creation.box(extents=2 * _HALF_M)
    _, away, _ = trimesh.proximity.closest_point_naive(mesh, points)
    is_inside = np.all(np.einsum("pfi,fi->pf", points[:, None] - mesh.triangles_center, mesh.face_normals) < 0.0, axis=1)
    assert is_inside.any()
    found = [box_distance_m(point[None, None], np.zeros((1, 1, 3)), _HALF_M[None])[0, 0] for point in points]
    np.testing.assert_allclose(found, np.where(is_inside, -away, away), rtol=0, atol=1e-12)


@given(_points, _points)
def test_a_line_is_as_far_as_the_nearest_of_its_points(points: np.ndarray, ends: np.ndarray) -> None:
    start, end = ends[:1], ends[-1:]
    share = np.linspace(0.0, 1.0, 501)[:, None]
    sampled = float(cKDTree(start + share * (end - start)).query(points)[0].min())
    found = segment_distance_m(points, start, end)[0]
    # The foot of the perpendicular lies at most half a step from a sample, and a distance changes by no more than that.
    half_step = float(np.linalg.norm(end - start)) / 1000
    assert sampled - half_step - 1e-12 <= found <= sampled + 1e-12


@given(_points, _points)
def test_two_clouds_are_as_far_as_a_tree_says(a: np.ndarray, b: np.ndarray) -> None:
    assert cloud_distance_m(a, b) == pytest.approx(float(cKDTree(b).query(a)[0].min()), abs=1e-15)


@given(transforms(), st.tuples(_coordinate, _coordinate, _coordinate))
def test_the_lowest_corner_is_the_lowest_of_eight(T: np.ndarray, centre: tuple[float, ...]) -> None:
    corners = np.array(centre) + np.array(list(product((-1.0, 1.0), repeat=3))) * _HALF_M
    expected = RigidTransform.from_matrix(T).apply(corners)[:, 2].min()
    assert lowest_corner_m(T[None], np.array([[centre]]), _HALF_M[None])[0, 0] == pytest.approx(expected, abs=1e-14)
