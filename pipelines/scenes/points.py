"""What depth cameras see of the initial scene, as typed points; pictures for people are in pictures.views."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from objects.object_model import ObjectModel
from pipelines import laws
from pipelines.codecs import Row
from pipelines.engines.bounds import BoundsError, bounded, check_bounds
from pipelines.pictures.renderer import Photograph, Renderer, View
from pipelines.pictures.views import build_scene
from pipelines.stage import Stage, Unit, UnitResult, timing_row
from pipelines.values import Scene
from tables.identity import rng_for
from tables.schemas import OBSTACLES, SCENE_POINTS, SCENES, TARGETS
from tables.vocabulary import PointType


@dataclass(frozen=True, slots=True)
class CameraParams:
    """Two depth cameras on opposite corners of the table, and how many of their points are kept."""

    # Together they see every side but the bottom.
    eyes_m: tuple[tuple[float, float, float], ...] = bounded(((1.15, 0.75, 0.80), (-0.20, -0.80, 0.80)), -5.0, 5.0)
    look_at_m: tuple[float, float, float] = bounded((0.42, 0.0, 0.05), -5.0, 5.0)  # the middle of the workspace
    fov_deg: float = bounded(46.0, 5.0, 120.0)  # the whole workspace, and 3 mm a pixel on the object
    width_px: int = bounded(320, 16, 4096)
    height_px: int = bounded(240, 16, 4096)
    n_points: int = bounded(2048, 2, 1_000_000)
    # Half of the points for the object: it is small in the image and everything is about it.
    n_object_points: int = bounded(1024, 1, 1_000_000)
    n_obstacle_points: int = bounded(512, 0, 1_000_000)
    max_radius_m: float = bounded(0.95, 0.1, 5.0)  # table beyond it is out of the reach of the arm
    # Points are rounded to it: 1/8192 m = 0.12 mm, beside pixels 3 mm apart. What is finer is the arithmetic of the renderer, which made
    # up 55 % of a point's bytes. A power of two, so that float32 holds every coordinate exactly.
    grid_m: float = bounded(2.0**-13, 2.0**-20, 0.01)

    def __post_init__(self) -> None:
        check_bounds(self)
        if math.frexp(self.grid_m)[0] != 0.5:
            raise BoundsError(f"grid_m = {self.grid_m!r}, must be a power of two")
        if self.n_object_points + self.n_obstacle_points >= self.n_points:
            raise BoundsError(
                f"n_points = {self.n_points}, must be above n_object_points + n_obstacle_points"
                f" = {self.n_object_points} + {self.n_obstacle_points}"
            )


def scene_point_rows(object_model: ObjectModel, scene: Scene, params: CameraParams, seed: int) -> list[Row]:
    """Rows of `scene_points`: `n_points` points of the initial scene without robot, on a grid of `grid_m`.

    Where object or obstacles show fewer pixels than their share, the table fills up.
    """
    clouds = _clouds(object_model, scene, params)
    rng = rng_for(seed, "scene_points", scene.scene_id)
    kept = {
        PointType.OBJECT: _some(rng, clouds[PointType.OBJECT], params.n_object_points),
        PointType.OBSTACLE: _some(rng, clouds[PointType.OBSTACLE], params.n_obstacle_points),
    }
    n_left = params.n_points - sum(map(len, kept.values()))
    if len(clouds[PointType.ENVIRONMENT]) < n_left:
        raise ValueError(f"{scene.scene_id}: {len(clouds[PointType.ENVIRONMENT])} table points in view, must be at least {n_left}")
    kept = {PointType.ENVIRONMENT: _some(rng, clouds[PointType.ENVIRONMENT], n_left), **kept}
    typed = [(kind, point) for kind, points in kept.items() for point in _on_grid(points, params.grid_m).tolist()]
    return [
        {"scene_id": scene.scene_id, "point": k, "point_type": kind.value, "x_m": x, "y_m": y, "z_m": z}
        for k, (kind, (x, y, z)) in enumerate(typed)
    ]


def _clouds(object_model: ObjectModel, scene: Scene, params: CameraParams) -> dict[PointType, Float[np.ndarray, "n 3"]]:
    """All back-projected points within reach, by what they lie on."""
    views = [View(eye, params.look_at_m, params.fov_deg, params.width_px, params.height_px) for eye in params.eyes_m]
    with Renderer() as renderer:
        types = build_scene(renderer, object_model, scene)
        photographs = [renderer.photograph(view) for view in views]
    return {kind: np.concatenate([_points_of(p, types, kind, params) for p in photographs]) for kind in PointType}


def _points_of(photograph: Photograph, types: dict[int, PointType], kind: PointType, params: CameraParams) -> Float[np.ndarray, "n 3"]:
    bodies = [body for body, its_kind in types.items() if its_kind is kind]
    points = photograph.points_m[np.isin(photograph.body, bodies)]
    within_reach: Float[np.ndarray, "n 3"] = points[np.linalg.norm(points[:, :2], axis=1) <= params.max_radius_m]
    return within_reach


def _some(rng: np.random.Generator, points: Float[np.ndarray, "n 3"], n: int) -> Float[np.ndarray, "m 3"]:
    """At most n points, drawn without replacement, in image order."""
    return points if len(points) <= n else points[np.sort(rng.choice(len(points), n, replace=False))]


def _on_grid(points: Float[np.ndarray, "n 3"], grid_m: float) -> Float[np.ndarray, "n 3"]:
    """The nearest points of the grid. Zero is added because minus zero, to which -1 um is rounded, is another value to a hash."""
    nearest: Float[np.ndarray, "n 3"] = np.rint(points / grid_m) * grid_m + 0.0
    return nearest


def run(unit: Unit) -> UnitResult:
    """The typed cloud of one scene."""
    start = time.process_time_ns()
    rows = scene_point_rows(unit.object_model, unit.scene, unit.params(CameraParams), unit.seed)
    return UnitResult({"scene_points": rows}, [timing_row("scene_points", unit.item_id, start)])


STAGE = Stage(
    name="scene_points",
    group="scenes",
    description="Renders two depth views of each initial scene and keeps a typed point cloud: environment, object, obstacle.",
    code_version="2",
    inputs=(SCENES, OBSTACLES, TARGETS),
    objects=("object_meshes",),
    outputs=(SCENE_POINTS,),
    sections=(CameraParams,),
    engines=("pybullet", "numpy"),
    run=run,
    law=laws.scene_points_law,
    time_share=0.02,
)
