"""A view that keeps points in the picture is the old one where that does, and moves by no more than it takes."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pipelines.pictures.renderer import View
from pipelines.pictures.views import keeping_in_view, picture_view

NEAR = picture_view((240, 180), np.array([0.4, 0.0]))
POINT = st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(0, 1))


def in_picture(view: View, points_m: np.ndarray) -> np.ndarray:
    """Where points are in the picture, from -1 to 1 across and up; nan behind the eye. Projected with matrices, as a renderer does."""
    forward = np.subtract(view.look_at_m, view.eye_m)
    z = -forward / np.linalg.norm(forward)
    x = np.cross([0, 0, 1], z) / np.linalg.norm(np.cross([0, 0, 1], z))
    T_base_camera = np.eye(4)
    T_base_camera[:3, :3], T_base_camera[:3, 3] = np.stack([x, np.cross(z, x), z], axis=1), view.eye_m
    f = 1 / np.tan(np.deg2rad(view.fov_deg) / 2)
    lens = np.diag([f * view.height_px / view.width_px, f, -1.0])
    seen = (lens @ (np.linalg.inv(T_base_camera) @ np.c_[points_m, np.ones(len(points_m))].T)[:3]).T
    return np.where(seen[:, 2:] > 0, seen[:, :2] / seen[:, 2:], np.nan)


@given(st.lists(POINT, min_size=1, max_size=8))
def test_all_points_are_in_the_picture_of_a_view_that_is_not_turned(made: list[tuple[float, float, float]]) -> None:
    points_m = np.array(made)
    view = keeping_in_view(NEAR, points_m)
    assert np.all(np.abs(in_picture(view, points_m)) < 0.97)
    turned = np.subtract(view.look_at_m, view.eye_m) - np.subtract(NEAR.look_at_m, NEAR.eye_m)
    np.testing.assert_allclose(turned, 0.0, atol=1e-12)
    assert (view.fov_deg, view.width_px, view.height_px) == (NEAR.fov_deg, NEAR.width_px, NEAR.height_px)
    again = keeping_in_view(view, points_m)
    np.testing.assert_allclose(again.eye_m, view.eye_m, atol=1e-9)


def test_what_is_in_the_picture_moves_nothing_and_what_is_not_ends_at_its_edge() -> None:
    assert keeping_in_view(NEAR, np.array([[0.4, 0.0, 0.2], [0.5, 0.1, 0.0]])) == NEAR
    points_m = np.array([[0.4, 0.0, 0.2], [0.2, 0.0, 0.9]])
    assert np.abs(in_picture(NEAR, points_m)).max() > 1.0
    moved = np.abs(in_picture(keeping_in_view(NEAR, points_m), points_m)).max()
    np.testing.assert_allclose(moved, 0.96, atol=1e-9)
