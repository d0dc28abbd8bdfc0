"""Draws a scene: the object at rest, obstacles in its way, targets where it would stay; see grasps/admission.py for which grasps work."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from functools import partial

from objects.object_model import ObjectModel
from pipelines import laws
from pipelines.codecs import Row, pose_row
from pipelines.engines.physics.params import PhysicsParams
from pipelines.engines.physics.world import PhysicsWorld
from pipelines.scenes.draws import Arrangement, Draws, Placed, SceneSamplingParams, draw_object, draw_obstacle, draw_target, is_relevant
from pipelines.scenes.reach import OpenHands
from pipelines.stage import Stage, Unit, UnitResult, timing_row
from tables.errors import PlaceBenchError
from tables.identity import parse_scene_id
from tables.poses import pose_columns
from tables.schemas import OBSTACLES, SCENE_ATTEMPTS, SCENES, TARGETS

__all__ = ["SceneError", "SceneSamplingParams", "SceneTables", "sample_scene"]


class SceneError(PlaceBenchError, RuntimeError):
    """No valid scene within the attempts; names the scene and what was rejected last."""


@dataclass(slots=True)
class SceneTables:
    """Rows of one scene for the four tables of scene sampling."""

    scenes: list[Row] = field(default_factory=list)
    scene_attempts: list[Row] = field(default_factory=list)
    obstacles: list[Row] = field(default_factory=list)
    targets: list[Row] = field(default_factory=list)


def sample_scene(
    object_model: ObjectModel, scene_id: str, n_obstacles: int, params: SceneSamplingParams, physics: PhysicsParams, seed: int
) -> SceneTables:
    """One valid scene and the record of everything that was rejected on the way.

    Every draw has its own generator, from the recipe seed, the scene, the attempt, the item and the number of the draw.

    Raises:
        SceneError: no valid scene in `max_attempts`.
    """
    tables, hands = SceneTables(), OpenHands(object_model, params.n_q7)
    with PhysicsWorld(object_model, (), physics) as world:
        for attempt in range(params.max_attempts):
            scene = _attempt(Draws(object_model, scene_id, attempt, params, seed, world, hands, tables.scene_attempts), n_obstacles)
            if scene is None:
                continue
            _add_rows(tables, object_model, scene_id, attempt, scene)
            return tables
    last = tables.scene_attempts[-1]
    raise SceneError(
        f"{scene_id} ({object_model.object_id}): no valid scene in {params.max_attempts} attempts; last {last['item']}: {last['reason']}"
    )


def _add_rows(tables: SceneTables, object_model: ObjectModel, scene_id: str, attempt: int, scene: Arrangement) -> None:
    tables.scenes.append(
        {
            "scene_id": scene_id,
            "scene_index": parse_scene_id(scene_id)[1],
            "object_id": object_model.object_id,
            "category": object_model.category,
            "n_obstacles": len(scene.obstacles),
            "stable_pose_id": scene.start.rest.stable_pose_id,
            **_pose_columns("object", scene.start),
            "n_attempts": attempt + 1,
        }
    )
    for obstacle in scene.obstacles:
        size = dict(zip(("size_x_m", "size_y_m", "size_z_m"), obstacle.size_m.tolist(), strict=True))
        pose = pose_row("obstacle", obstacle.T_base_obstacle)
        tables.obstacles.append({"scene_id": scene_id, "obstacle_id": obstacle.obstacle_id, **pose, **size})
    for target_id, target in enumerate(scene.targets):
        tables.targets.append(
            {
                "scene_id": scene_id,
                "target_id": target_id,
                "stable_pose_id": target.rest.stable_pose_id,
                "resting": target.rest.resting,
                **_pose_columns("target", target),
                "rest_drift_m": target.drift[0],
                "rest_drift_rad": target.drift[1],
            }
        )


def _pose_columns(prefix: str, placed: Placed) -> Row:
    return dict(zip(pose_columns(prefix), placed.pose.tolist(), strict=True))


def _attempt(draws: Draws, n_obstacles: int) -> Arrangement | None:
    """Object, then obstacles around it, then targets around both; None where one of them finds no place."""
    start = draws.first_valid("object", partial(draw_object, draws))
    if start is None:
        return None
    scene = Arrangement(start)
    for k in range(n_obstacles):
        obstacle = draws.first_valid(f"obstacle-{k}", partial(draw_obstacle, draws.params, scene))
        if obstacle is None:
            return None
        scene.obstacles.append(obstacle)
    for k in range(draws.params.n_targets):
        target = draws.first_valid(f"target-{k}", partial(draw_target, draws, scene))
        if target is None:
            return None
        scene.targets.append(target)
    for obstacle in scene.obstacles:
        if not is_relevant(obstacle, scene, draws.params):
            draws.reject(f"obstacle-{obstacle.obstacle_id}", draws.params.max_draws, "in nobody's way")
            return None
    return scene


def run(unit: Unit) -> UnitResult:
    """The four tables of one scene."""
    start = time.process_time_ns()
    scene_id, n_obstacles = unit.allocation.scene_id, unit.allocation.n_obstacles
    made = sample_scene(unit.object_model, scene_id, n_obstacles, unit.params(SceneSamplingParams), unit.params(PhysicsParams), unit.seed)
    rows = {"scenes": made.scenes, "scene_attempts": made.scene_attempts, "obstacles": made.obstacles, "targets": made.targets}
    return UnitResult(rows, [timing_row("scenes", scene_id, start)])


STAGE = Stage(
    name="scenes",
    group="scenes",
    description="Draws scenes: an object settled at a stable pose, box obstacles in the way, eight targets that hold the object at rest.",
    code_version="2",
    inputs=(),
    objects=("objects", "object_meshes", "object_parts", "stable_poses", "grasp_pool"),
    outputs=(SCENES, SCENE_ATTEMPTS, OBSTACLES, TARGETS),
    sections=(SceneSamplingParams, PhysicsParams),
    engines=("pybullet", "frankik", "numpy", "scipy"),
    run=run,
    law=laws.scenes_law,
    time_share=0.05,
)
