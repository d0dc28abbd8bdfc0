"""What depth cameras see of the initial scene, as typed points, and pictures of scenes for people; films are filmstrip's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from objects.kit import ObjectKit
from pipelines.physics.renderer import Photograph, Renderer, Rgb, View
from pipelines.scene import Row, Scene
from tables.identity import rng_for
from tables.vocabulary import PointType

TABLE_RGB: Rgb = (0.86, 0.84, 0.80)
OBSTACLE_RGB: Rgb = (0.62, 0.46, 0.30)
OBJECT_RGB: Rgb = (0.16, 0.42, 0.72)
GHOST_RGB: Rgb = (0.20, 0.72, 0.36)
_GHOST_OPACITY = 0.5
_PICTURE_SHARPNESS = 2  # rendered at twice the size and averaged: the renderer does not smooth edges


@dataclass(frozen=True, slots=True)
class CameraParams:
    """Two depth cameras on opposite corners of the table, and how many of their points are kept."""

    eyes_m: tuple[tuple[float, float, float], ...] = (
        (1.15, 0.75, 0.80),
        (-0.20, -0.80, 0.80),
    )  # together they see every side but the bottom
    look_at_m: tuple[float, float, float] = (0.42, 0.0, 0.05)  # the middle of the workspace
    fov_deg: float = 46.0  # the whole workspace, and 3 mm a pixel on the object
    width_px: int = 320
    height_px: int = 240
    n_points: int = 2048
    # Half of the points for the object: it is small in the image and everything is about it.
    n_object_points: int = 1024
    n_obstacle_points: int = 512
    max_radius_m: float = 0.95  # table beyond it is out of the arm's reach

    def __post_init__(self) -> None:
        if self.n_object_points + self.n_obstacle_points >= self.n_points:
            raise ValueError(
                f"n_points = {self.n_points}, must be above {self.n_object_points} object and {self.n_obstacle_points} obstacle points"
            )
        if not self.eyes_m or not 5.0 < self.fov_deg < 120.0:
            raise ValueError(f"{len(self.eyes_m)} eyes with fov_deg = {self.fov_deg}, must be at least one and in (5, 120)")


def scene_point_rows(kit: ObjectKit, scene: Scene, params: CameraParams, seed: int) -> list[Row]:
    """Rows of `scene_points`: `n_points` points of the initial scene without robot.

    Where object or obstacles show fewer pixels than their share, the table fills up.
    """
    clouds = _clouds(kit, scene, params)
    rng = rng_for(seed, "scene_points", scene.scene_id)
    kept = {
        PointType.OBJECT: _some(rng, clouds[PointType.OBJECT], params.n_object_points),
        PointType.OBSTACLE: _some(rng, clouds[PointType.OBSTACLE], params.n_obstacle_points),
    }
    n_left = params.n_points - sum(map(len, kept.values()))
    if len(clouds[PointType.ENVIRONMENT]) < n_left:
        raise ValueError(f"{scene.scene_id}: {len(clouds[PointType.ENVIRONMENT])} table points in view, must be at least {n_left}")
    kept = {PointType.ENVIRONMENT: _some(rng, clouds[PointType.ENVIRONMENT], n_left), **kept}
    typed = [(kind, point) for kind, points in kept.items() for point in points.tolist()]
    return [
        {"scene_id": scene.scene_id, "point": k, "point_type": kind.value, "x_m": x, "y_m": y, "z_m": z}
        for k, (kind, (x, y, z)) in enumerate(typed)
    ]


def render_scene(
    kit: ObjectKit,
    scene: Scene,
    size_px: tuple[int, int] = (640, 480),
    *,
    show_targets_as_ghosts: bool = True,
    robot_q: Float[np.ndarray, "7"] | None = None,
) -> UInt8[np.ndarray, "h w 3"]:
    """A picture of a scene for people: object blue, obstacles brown, targets as green ghosts.

    Args:
        size_px: width and height.
        robot_q: draw the arm at this configuration with an open hand.
    """
    view = picture_view(size_px)
    with Renderer() as renderer:
        _build(renderer, kit, scene)
        if robot_q is not None:
            renderer.pose_robot(renderer.add_robot(), robot_q, np.array([0.04, 0.04]))
        picture = renderer.photograph(view).rgb.astype(np.float64)
        if show_targets_as_ghosts:
            for target in scene.targets:
                renderer.add_mesh(kit.mesh, target.T_base_target, GHOST_RGB)
            ghosts = renderer.photograph(view)
            picture += _GHOST_OPACITY * (ghosts.rgb - picture)
    return shrunk(picture)


def picture_view(size_px: tuple[int, int], middle_xy: Float[np.ndarray, "2"] | None = None) -> View:
    """The view of every picture, from the front left: of the whole table, or nearer and of what happens around a spot."""
    width, height = (_PICTURE_SHARPNESS * n for n in size_px)
    if middle_xy is None:
        return View((1.35, 0.70, 0.80), (0.38, 0.0, 0.14), 39.0, width, height)
    x, y = (float(v) for v in middle_xy)
    return View((x + 0.90, y + 0.65, 0.70), (x, y, 0.16), 36.0, width, height)


def shrunk(picture: Float[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """Average blocks of pixels down to the asked size."""
    n = _PICTURE_SHARPNESS
    h, w, _ = picture.shape
    return np.clip(picture.reshape(h // n, n, w // n, n, 3).mean(axis=(1, 3)), 0, 255).round().astype(np.uint8)


def add_table(renderer: Renderer) -> int:
    """The table top."""
    T = np.eye(4)
    T[:3, 3] = 0.35, 0.0, -0.02
    return renderer.add_box(np.array([1.5, 1.8, 0.04]), T, TABLE_RGB)


def _build(renderer: Renderer, kit: ObjectKit, scene: Scene) -> dict[int, PointType]:
    """Table, object and obstacles; what each body's points are called."""
    types = {add_table(renderer): PointType.ENVIRONMENT, renderer.add_mesh(kit.mesh, scene.T_base_object, OBJECT_RGB): PointType.OBJECT}
    for obstacle in scene.obstacles:
        types[renderer.add_box(obstacle.size_m, obstacle.T_base_obstacle, OBSTACLE_RGB)] = PointType.OBSTACLE
    return types


def _clouds(kit: ObjectKit, scene: Scene, params: CameraParams) -> dict[PointType, Float[np.ndarray, "n 3"]]:
    """All back-projected points within reach, by what they lie on."""
    views = [View(eye, params.look_at_m, params.fov_deg, params.width_px, params.height_px) for eye in params.eyes_m]
    with Renderer() as renderer:
        types = _build(renderer, kit, scene)
        photographs = [renderer.photograph(view) for view in views]
    return {kind: np.concatenate([_points_of(p, types, kind, params) for p in photographs]) for kind in PointType}


def _points_of(photograph: Photograph, types: dict[int, PointType], kind: PointType, params: CameraParams) -> Float[np.ndarray, "n 3"]:
    bodies = [body for body, its_kind in types.items() if its_kind is kind]
    points = photograph.points_m[np.isin(photograph.body, bodies)]
    return points[np.linalg.norm(points[:, :2], axis=1) <= params.max_radius_m]


def _some(rng: np.random.Generator, points: Float[np.ndarray, "n 3"], n: int) -> Float[np.ndarray, "m 3"]:
    """At most n points, drawn without replacement, in image order."""
    return points if len(points) <= n else points[np.sort(rng.choice(len(points), n, replace=False))]
