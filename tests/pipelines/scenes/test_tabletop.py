"""Gaps between outlines against brute force, and spots where they were asked for."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from pipelines.scenes.tabletop import beside, box_footprint, footprint, gap_m, is_in_sector, spot_in_sector, standing
from tests.pipelines.engines.physics.object_models import can_model

_SPOT = st.floats(-0.5, 0.5)


def _sampled_distance_m(a: np.ndarray, b: np.ndarray, n: int = 400) -> float:
    """Distance between two outlines by sampling their edges."""
    edges = [np.concatenate([p + s * (np.roll(p, -1, axis=0) - p) for s in np.linspace(0, 1, n // len(p))]) for p in (a, b)]
    return float(np.linalg.norm(edges[0][:, None] - edges[1][None], axis=-1).min())


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 9999), _SPOT, _SPOT, st.floats(-3, 3))
def test_gap_is_the_distance_or_a_little_less_and_never_more(seed: int, x: float, y: float, yaw: float) -> None:
    points = np.random.default_rng(seed).normal(scale=0.04, size=(12, 2))
    outline = points[ConvexHull(points).vertices]
    box = box_footprint(standing(np.array([x, y]), yaw, 0.12), np.array([0.10, 0.08, 0.12]))
    gap, distance = gap_m(outline, box), _sampled_distance_m(outline, box)
    assert gap == pytest.approx(gap_m(box, outline), abs=1e-12)
    if gap > 0.0:
        assert gap <= distance + 1e-9
        # Two corners facing each other diagonally are the worst case of separating axes.
        assert gap >= distance / math.sqrt(2.0) - 1e-3
    else:
        # Outlines that overlap: some corner of one is in the other, or edges cross and the sampled distance is next to nothing.
        axes = [p[k] - p[k - 1] for p in (outline, box) for k in range(len(p))]
        normals = np.array([[e[1], -e[0]] for e in axes])
        assert all((outline @ n).max() >= (box @ n).min() - 1e-12 and (box @ n).max() >= (outline @ n).min() - 1e-12 for n in normals)


@settings(max_examples=40, deadline=None)
@given(st.floats(-3.1, 3.1), st.floats(0.02, 0.12), st.floats(-3.1, 3.1))
def test_beside_leaves_the_gap_that_was_asked_for(angle: float, wanted_m: float, yaw: float) -> None:
    object_model = can_model()
    centre = np.array([0.5, 0.1])
    fixed = footprint(object_model, standing(centre, 0.0) @ object_model.stable_poses[0].T_plane_object)
    size = np.array([0.10, 0.08, 0.12])
    xy = beside(centre, fixed, lambda at: box_footprint(standing(at, yaw), size), angle, wanted_m)
    assert gap_m(fixed, box_footprint(standing(xy, yaw), size)) == pytest.approx(wanted_m, abs=3e-4)
    assert np.dot(xy - centre, [math.cos(angle), math.sin(angle)]) == pytest.approx(float(np.linalg.norm(xy - centre)))


def test_spots_fill_the_sector_evenly() -> None:
    rng = np.random.default_rng(0)
    radius, angle = (0.3, 0.7), (-1.2, 1.2)
    spots = np.array([spot_in_sector(rng, radius, angle) for _ in range(4000)])
    assert all(is_in_sector(spot, radius, angle) for spot in spots)
    # Half of the area lies beyond the root-mean-square of the radii; 4,000 draws are within 3 standard deviations.
    beyond = (np.linalg.norm(spots, axis=1) > math.sqrt((0.3**2 + 0.7**2) / 2)).mean()
    assert beyond == pytest.approx(0.5, abs=3 * 0.5 / math.sqrt(4000))
    assert not is_in_sector(np.array([0.0, 0.5]), radius, angle)
    assert not is_in_sector(np.array([0.1, 0.0]), radius, angle)


def test_a_footprint_is_the_shadow_of_the_mesh() -> None:
    object_model = can_model()
    T = standing(np.array([0.4, 0.2]), 1.0) @ object_model.stable_poses[2].T_plane_object
    outline = footprint(object_model, T)
    vertices = (object_model.mesh.vertices_m @ T[:3, :3].T + T[:3, 3])[:, :2]
    assert outline.min(axis=0) == pytest.approx(vertices.min(axis=0))
    assert outline.max(axis=0) == pytest.approx(vertices.max(axis=0))
    x, y = outline.T
    area = 0.5 * float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))
    assert area == pytest.approx(
        0.066 * 0.115, rel=0.01
    )  # a lying can's shadow is its diameter times its height; positive: counter-clockwise
