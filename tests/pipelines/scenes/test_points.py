"""Points lie on what they are said to lie on; pictures show what is there."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from pipelines.codecs import Row
from pipelines.engines.robot.arm import HOME_Q_RAD, fk
from pipelines.pictures.renderer import Renderer, View
from pipelines.pictures.views import render_scene
from pipelines.scenes.points import CameraParams, scene_point_rows
from pipelines.scenes.tabletop import standing
from pipelines.values import Obstacle
from tables import schemas
from tables.store import table_from_rows
from tests.pipelines.engines.physics.lifted import scene_of
from tests.pipelines.engines.physics.object_models import cuboid_model

SIZE = np.array([0.10, 0.08, 0.12])
OBSTACLES = (Obstacle(0, standing(np.array([0.62, -0.15]), 0.5, 0.12), SIZE),)
OBJECT_MODEL = cuboid_model()
SCENE = scene_of(OBJECT_MODEL, OBSTACLES)
# The renderer's depth buffer is 32 bits wide: some micrometres at a metre.
ON_SURFACE_M = 2e-5
# As good as no grid: what the renderer says.
AS_RENDERED = CameraParams(grid_m=2.0**-20)


def _points(rows: list[Row], kind: str) -> np.ndarray:
    return np.array([[row["x_m"], row["y_m"], row["z_m"]] for row in rows if row["point_type"] == kind])


def _off_box_m(points: np.ndarray, T: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Distance from the surface of a box, by hand."""
    local = np.abs((points - T[:3, 3]) @ T[:3, :3]) - size / 2
    outside = np.linalg.norm(np.maximum(local, 0.0), axis=1)
    return np.maximum(outside, np.where(outside > 0, 0.0, np.abs(local.max(axis=1))))


def test_points_lie_on_what_they_are_called() -> None:
    params = AS_RENDERED
    rows = scene_point_rows(OBJECT_MODEL, SCENE, params, 42)
    table_from_rows(schemas.SCENE_POINTS, rows)
    assert len(rows) == params.n_points
    points = {kind: _points(rows, kind) for kind in ("object", "obstacle", "environment")}
    assert len(points["object"]) <= params.n_object_points
    assert len(points["obstacle"]) == params.n_obstacle_points
    assert _off_box_m(points["object"], SCENE.T_base_object, np.array([0.06, 0.09, 0.14])).max() < ON_SURFACE_M
    assert _off_box_m(points["obstacle"], OBSTACLES[0].T_base_obstacle, SIZE).max() < ON_SURFACE_M
    assert np.abs(points["environment"][:, 2]).max() < ON_SURFACE_M
    assert np.linalg.norm(points["environment"][:, :2], axis=1).max() <= params.max_radius_m + params.grid_m
    # Two opposite views see all four sides and the top, hence nearly the whole extent.
    local = (points["object"] - SCENE.T_base_object[:3, 3]) @ SCENE.T_base_object[:3, :3]
    assert np.ptp(local, axis=0) == pytest.approx([0.06, 0.09, 0.14], abs=0.01)


def test_points_are_those_of_the_renderer_on_the_grid() -> None:
    params = CameraParams()
    made, rendered = (scene_point_rows(OBJECT_MODEL, SCENE, some, 42) for some in (params, AS_RENDERED))
    points, exact = (np.array([[row["x_m"], row["y_m"], row["z_m"]] for row in rows]) for rows in (made, rendered))
    assert [row["point_type"] for row in made] == [row["point_type"] for row in rendered]
    # Half a step on each axis, and half of the fine grid's.
    assert np.abs(points - exact).max() <= params.grid_m / 2 + AS_RENDERED.grid_m / 2
    assert np.array_equal(points, np.rint(points * 8192) / 8192)
    stored = table_from_rows(schemas.SCENE_POINTS, made)
    assert np.array_equal(np.column_stack([stored[name].to_numpy() for name in ("x_m", "y_m", "z_m")]).astype(np.float64), points)
    assert np.array_equal(
        points[np.array([row["point_type"] for row in made]) == "environment", 2], np.zeros(len(_points(made, "environment")))
    )
    assert not np.signbit(points[points == 0.0]).any()


def test_points_depend_on_seed_and_scene_alone() -> None:
    rows = scene_point_rows(OBJECT_MODEL, SCENE, CameraParams(), 42)
    assert scene_point_rows(OBJECT_MODEL, SCENE, CameraParams(), 42) == rows
    other = scene_point_rows(OBJECT_MODEL, SCENE, CameraParams(), 43)
    assert other != rows
    assert len(other) == len(rows)


def test_without_obstacles_the_table_fills_up() -> None:
    rows = scene_point_rows(OBJECT_MODEL, scene_of(OBJECT_MODEL), CameraParams(), 42)
    assert len(rows) == CameraParams().n_points
    assert len(_points(rows, "obstacle")) == 0


def test_a_camera_that_sees_no_table_is_an_error_that_names_the_scene() -> None:
    away = CameraParams(eyes_m=((1.0, 0.0, 0.5),), look_at_m=(2.0, 0.0, 2.0))
    with pytest.raises(ValueError, match="full-0000: 0 table points"):
        scene_point_rows(OBJECT_MODEL, SCENE, away, 42)


def test_back_projection_inverts_the_lens() -> None:
    """A small ball's pixels, taken back, are centred where the ball is."""
    at = np.array([0.45, 0.12, 0.30])
    T = np.eye(4)
    T[:3, 3] = at
    with Renderer() as renderer:
        ball = renderer.add_box(np.full(3, 0.01), T, (1.0, 0.0, 0.0))
        photograph = renderer.photograph(View((1.1, -0.4, 0.7), (0.4, 0.0, 0.1), 30.0, 640, 480))
    points = photograph.points_m[photograph.body == ball]
    assert len(points) > 50
    assert np.abs(points - at).max() < 0.005 + ON_SURFACE_M


def test_pictures_show_targets_as_ghosts() -> None:
    plain = render_scene(OBJECT_MODEL, dataclasses.replace(SCENE, targets=()), (160, 120))
    ghosts = render_scene(OBJECT_MODEL, SCENE, (160, 120))
    assert plain.shape == (120, 160, 3)
    assert plain.dtype == np.uint8
    assert 0.005 < np.any(plain != ghosts, axis=-1).mean() < 0.5


def test_the_robot_is_drawn_where_its_joints_put_it() -> None:
    """The hand, seen from the side, covers the pixels around the TCP."""
    view = View((1.4, -0.9, 0.8), (0.3, 0.0, 0.3), 45.0, 160, 120)
    with Renderer() as renderer:
        robot = renderer.add_robot()
        renderer.pose_robot(robot, HOME_Q_RAD, np.array([0.04, 0.04]))
        photograph = renderer.photograph(view)
    points = photograph.points_m[photograph.body == robot]
    assert len(points) > 500
    assert np.linalg.norm(points - fk(HOME_Q_RAD)[:3, 3], axis=1).min() < 0.05


@pytest.mark.parametrize(("field", "value"), [("n_points", 100), ("fov_deg", 200.0), ("eyes_m", ()), ("grid_m", 1e-4)])
def test_params_are_valid_from_birth(field: str, value: object) -> None:
    with pytest.raises(ValueError, match=field.removesuffix("_m")):
        CameraParams(**{field: value})  # type: ignore[arg-type]
