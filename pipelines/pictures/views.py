"""Pictures of scenes for people, and what stands in them; the depth cameras of the dataset are in scenes.points, films in filmstrip.py."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float, UInt8

from objects.object_model import ObjectModel
from pipelines.pictures.renderer import Renderer, Rgb, View
from pipelines.values import TABLE_X_M, TABLE_Y_M, Scene
from tables.vocabulary import PointType

TABLE_RGB: Rgb = (0.86, 0.84, 0.80)
OBSTACLE_RGB: Rgb = (0.62, 0.46, 0.30)
OBJECT_RGB: Rgb = (0.16, 0.42, 0.72)
GHOST_RGB: Rgb = (0.20, 0.72, 0.36)
_GHOST_OPACITY = 0.5
_USED_SHARE = 0.96  # of half a picture: what has to be in view is not cut at the edge
_PICTURE_SHARPNESS = 2  # rendered at twice the size and averaged: the renderer does not smooth edges


def render_scene(object_model: ObjectModel, scene: Scene, size_px: tuple[int, int] = (640, 480)) -> UInt8[np.ndarray, "h w 3"]:
    """A picture of a scene for people: object blue, obstacles brown, targets as green ghosts.

    Args:
        size_px: width and height.
    """
    view = picture_view(size_px)
    with Renderer() as renderer:
        build_scene(renderer, object_model, scene)
        picture = renderer.photograph(view).rgb.astype(np.float64)
        for target in scene.targets:
            renderer.add_mesh(object_model.mesh, target.T_base_target, GHOST_RGB)
        ghosts = renderer.photograph(view)
        picture += _GHOST_OPACITY * (ghosts.rgb - picture)
    return shrunk(picture)


def picture_view(size_px: tuple[int, int], middle_xy: Float[np.ndarray, "2"] | None = None) -> View:
    """The view of every picture, from the front left: of the whole table, or nearer and of what happens around a spot."""
    width, height = (_PICTURE_SHARPNESS * n for n in size_px)
    if middle_xy is None:
        return View((1.35, 0.70, 0.80), (0.38, 0.0, 0.14), 39.0, width, height)
    x, y = (float(v) for v in middle_xy)
    return View((x + 1.00, y + 0.72, 0.80), (x, y, 0.20), 38.0, width, height)


def keeping_in_view(view: View, points_m: Float[np.ndarray, "n 3"]) -> View:
    """The same view where it shows all points, else moved sideways and back, and turned by nothing, as little as that takes.

    In the axes of the camera a point at depth z is in the picture where |x| <= z tan(half the field of view), and so for y: planes
    through the eye, so each bounds where the eye may be by the outermost point alone.
    """
    eye, look_at = np.array(view.eye_m), np.array(view.look_at_m)
    forward = (look_at - eye) / np.linalg.norm(look_at - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(forward, [0.0, 0.0, 1.0]))
    axes = np.stack([right, np.cross(right, forward), forward])
    points = (points_m - eye) @ axes.T
    slope_y = _USED_SHARE * np.tan(np.deg2rad(view.fov_deg) / 2)
    slopes = np.array([slope_y * view.width_px / view.height_px, slope_y])
    above = (slopes * points[:, 2:] - points[:, :2]).min(axis=0)  # slope * z - x of the eye is at most this, and
    below = (slopes * points[:, 2:] + points[:, :2]).min(axis=0)  # slope * z + x at most that
    z = min(0.0, float(((above + below) / (2 * slopes)).min()))
    x, y = np.clip(0.0, slopes * z - above, below - slopes * z)
    moved = np.array([x, y, z]) @ axes
    return replace(view, eye_m=_xyz(eye + moved), look_at_m=_xyz(look_at + moved))


def _xyz(point: Float[np.ndarray, "3"]) -> tuple[float, float, float]:
    x, y, z = point.tolist()
    return x, y, z


def shrunk(picture: Float[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """Average blocks of pixels down to the asked size."""
    n = _PICTURE_SHARPNESS
    h, w, _ = picture.shape
    small: UInt8[np.ndarray, "h w 3"] = np.clip(picture.reshape(h // n, n, w // n, n, 3).mean(axis=(1, 3)), 0, 255).round().astype(np.uint8)
    return small


def add_table(renderer: Renderer) -> int:
    """The table top."""
    T = np.eye(4)
    (x0, x1), (y0, y1), thickness_m = TABLE_X_M, TABLE_Y_M, 0.04
    T[:3, 3] = (x0 + x1) / 2, (y0 + y1) / 2, -thickness_m / 2
    return renderer.add_box(np.array([x1 - x0, y1 - y0, thickness_m]), T, TABLE_RGB)


def build_scene(renderer: Renderer, object_model: ObjectModel, scene: Scene) -> dict[int, PointType]:
    """Table, object and obstacles; what each body's points are called."""
    types = {
        add_table(renderer): PointType.ENVIRONMENT,
        renderer.add_mesh(object_model.mesh, scene.T_base_object, OBJECT_RGB): PointType.OBJECT,
    }
    for obstacle in scene.obstacles:
        types[renderer.add_box(obstacle.size_m, obstacle.T_base_obstacle, OBSTACLE_RGB)] = PointType.OBSTACLE
    return types
