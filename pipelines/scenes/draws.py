"""One draw of an object, an obstacle or a target, and why it is rejected; see sampling.py for how a scene is put together."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from objects.object_model import ObjectModel, StablePose
from pipelines.codecs import Row
from pipelines.engines.bounds import BoundsError, bounded, check_bounds
from pipelines.engines.physics.resting import rest_drift
from pipelines.engines.physics.world import PhysicsWorld
from pipelines.scenes.reach import OpenHands
from pipelines.scenes.tabletop import Polygon, beside, box_footprint, footprint, gap_m, is_in_sector, spot_in_sector, standing
from pipelines.values import Obstacle
from tables.identity import N_TARGETS, rng_for
from tables.poses import matrix_of, pose_of

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class SceneSamplingParams:
    """Where things are put and when a draw is rejected. These are the knobs of task difficulty."""

    n_targets: int = bounded(N_TARGETS, 1, N_TARGETS)
    # Where the object and targets stand: distance from the robot base, and angle to its front (70 degrees to each side).
    radius_m: tuple[float, float] = bounded((0.30, 0.78), 0.05, 3.0, is_increasing=True)
    angle_rad: tuple[float, float] = bounded((-1.2217304763960306, 1.2217304763960306), -math.pi, math.pi, is_increasing=True)
    obstacle_size_m: tuple[float, float, float] = bounded((0.10, 0.08, 0.12), 0.005, 1.0)
    # Near enough to be in the way of a target.
    obstacle_radius_m: tuple[float, float] = bounded((0.28, 0.72), 0.05, 3.0, is_increasing=True)
    obstacle_gap_m: float = bounded(0.03, 0.001, 1.0)  # between obstacles: less would be one obstacle
    # Of targets, those that ask for the resting pose that the object has; the others take turns, however barely stable, so that a
    # lying target needs another grasp than an upright one.
    share_same_rest: float = bounded(0.1, 0.0, 1.0)
    # Of the obstacles, those between object and workspace; the others stand beside the object.
    share_between: float = bounded(0.6, 0.0, 1.0)
    share_beside_obstacle: float = bounded(0.9, 0.0, 1.0)  # of the targets, where there is an obstacle: those placed next to one
    near_gap_m: tuple[float, float] = bounded((0.015, 0.05), 0.001, 1.0, is_increasing=True)  # "next to": target to obstacle
    object_gap_m: float = bounded(0.05, 0.001, 1.0)  # object to obstacle: fingers fit on every side, else that side admits no grasp
    target_gap_m: float = bounded(0.015, 0.001, 1.0)  # target to obstacle, at least
    min_move_m: float = bounded(0.10, 0.0, 1.0)  # target to object: a placement, not a nudge
    min_target_distance_m: float = bounded(0.05, 0.0, 1.0)  # between targets, or they must be turned:
    min_target_turn_rad: float = bounded(0.5235987755982988, 0.0, math.pi)  # 30 degrees modulo symmetry
    # Pool grasps that clear the table and that the arm reaches, at the initial pose of the object and at a target.
    min_initial_grasps: int = bounded(26, 1, 100)
    min_target_grasps: int = bounded(1, 1, 100)
    n_q7: int = bounded(8, 1, 4096)  # grid of joint 7; a reach test, finer ones follow
    rest_s: float = bounded(1.0, 0.01, 60.0)  # an unstable pose has left its place by then
    max_drift_m: float = bounded(0.005, 1e-5, 0.1)
    max_drift_rad: float = bounded(0.05235987755982988, 1e-4, 1.0)  # 3 degrees
    draws_per_rest: int = bounded(12, 1, 10_000)  # places tried for the resting pose of a target before another pose is drawn
    max_draws: int = bounded(100, 1, 10_000)  # of one item before the whole scene is drawn anew
    max_attempts: int = bounded(50, 1, 10_000)

    def __post_init__(self) -> None:
        check_bounds(self)
        if self.target_gap_m > self.near_gap_m[0]:
            raise BoundsError(f"target_gap_m = {self.target_gap_m}, must be at most near_gap_m[0] = {self.near_gap_m[0]}")
        if self.object_gap_m > self.near_gap_m[1]:
            raise BoundsError(f"object_gap_m = {self.object_gap_m}, must be at most near_gap_m[1] = {self.near_gap_m[1]}")


@dataclass(frozen=True, slots=True)
class Placed:
    """The object at a resting pose, its footprint, and how far physics moved it."""

    rest: StablePose
    pose: Float[np.ndarray, "7"]
    T: Float[np.ndarray, "4 4"]
    outline: Polygon
    drift: tuple[float, float]


@dataclass(slots=True)
class Arrangement:
    """What stands in a scene so far."""

    start: Placed
    obstacles: list[Obstacle] = field(default_factory=list)
    targets: list[Placed] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Draws:
    """What an attempt draws from and where it records rejections."""

    object_model: ObjectModel
    scene_id: str
    attempt: int
    params: SceneSamplingParams
    seed: int
    world: PhysicsWorld
    hands: OpenHands
    rejected: list[Row]

    def first_valid(self, item: str, draw_one: Callable[[np.random.Generator, int], _T | str]) -> _T | None:
        """The first draw that is not a reason for rejection; None where all `max_draws` are."""
        for draw in range(self.params.max_draws):
            drawn = draw_one(self.rng(item, draw), draw)
            if not isinstance(drawn, str):
                return drawn
            self.reject(item, draw, drawn)
        return None

    def rng(self, item: str, draw: int) -> np.random.Generator:
        return rng_for(self.seed, "scene_sampling", self.scene_id, self.attempt, item, draw)

    def reject(self, item: str, draw: int, reason: str) -> None:
        self.rejected.append({"scene_id": self.scene_id, "attempt": self.attempt, "item": item, "draw": draw, "reason": reason})


def draw_object(draws: Draws, rng: np.random.Generator, draw: int) -> Placed | str:
    """Any resting pose (people stand things up far more often than a drop would), anywhere in the workspace, settled in physics."""
    object_model, params = draws.object_model, draws.params
    rest = object_model.stable_poses[int(rng.integers(len(object_model.stable_poses)))]
    xy = spot_in_sector(rng, params.radius_m, params.angle_rad)
    T_nominal = standing(xy, rng.uniform(-math.pi, math.pi)) @ rest.T_plane_object
    if not draws.hands.allows(T_nominal, params.min_initial_grasps):
        return f"fewer than {params.min_initial_grasps} grasps within reach ({rest.resting})"
    rested = _rested(draws, "object", rest, T_nominal)
    if isinstance(rested, str):
        return rested
    pose = pose_of(rested[0])
    return Placed(rest, pose, matrix_of(pose), footprint(object_model, rested[0]), rested[1])


def draw_obstacle(params: SceneSamplingParams, scene: Arrangement, rng: np.random.Generator, draw: int) -> Obstacle | str:
    """A box on the way from the object to a random spot of the workspace, or one beside the object."""
    size_m, start = np.array(params.obstacle_size_m), scene.start
    yaw_rad, object_xy = rng.uniform(-math.pi, math.pi), start.T[:2, 3]
    if rng.random() < params.share_between:
        xy = object_xy + rng.uniform(0.3, 0.7) * (spot_in_sector(rng, params.radius_m, params.angle_rad) - object_xy)
    else:
        angle_rad, wanted_m = rng.uniform(-math.pi, math.pi), rng.uniform(params.object_gap_m, params.near_gap_m[1])
        xy = beside(object_xy, start.outline, lambda at: box_footprint(standing(at, yaw_rad), size_m), angle_rad, wanted_m)
    obstacle = Obstacle(len(scene.obstacles), standing(xy, yaw_rad, size_m[2]), size_m)
    box = box_footprint(obstacle.T_base_obstacle, size_m)
    if not is_in_sector(xy, params.obstacle_radius_m, (-math.pi, math.pi)):
        return "outside the workspace"
    if gap_m(box, start.outline) < params.object_gap_m - 1e-3:
        return "too near to the object"
    if any(gap_m(box, box_footprint(o.T_base_obstacle, o.size_m)) < params.obstacle_gap_m for o in scene.obstacles):
        return "too near to another obstacle"
    return obstacle


def draw_target(draws: Draws, scene: Arrangement, rng: np.random.Generator, draw: int) -> Placed | str:
    """A resting pose beside an obstacle or anywhere; cheap rejections first, physics last."""
    object_model, params, target_id = draws.object_model, draws.params, len(scene.targets)
    rest = _draw_rest(draws, scene.start.rest, target_id, draw)
    yaw_rad = rng.uniform(-math.pi, math.pi)
    if scene.obstacles and rng.random() < params.share_beside_obstacle:
        near = scene.obstacles[int(rng.integers(len(scene.obstacles)))]
        box, angle_rad, wanted_m = _outline(near), rng.uniform(-math.pi, math.pi), rng.uniform(*params.near_gap_m)
        placed = partial(_outline_at, object_model, rest, yaw_rad)
        xy = beside(near.T_base_obstacle[:2, 3], box, placed, angle_rad, wanted_m)
    else:
        xy = spot_in_sector(rng, params.radius_m, params.angle_rad)
    pose = pose_of(standing(xy, yaw_rad) @ rest.T_plane_object)
    # As a reader of its row sees it, so that what rests here is what is asked for later, to the bit.
    T = matrix_of(pose)
    outline = footprint(object_model, T)
    if not is_in_sector(xy, params.radius_m, params.angle_rad):
        return "outside the workspace"
    if np.linalg.norm(T[:3, 3] - scene.start.T[:3, 3]) < params.min_move_m:
        return "too near to the object's initial pose"
    if any(gap_m(outline, _outline(obstacle)) < params.target_gap_m - 1e-3 for obstacle in scene.obstacles):
        return "too near to an obstacle"
    if any(_is_same(object_model, T, other.T, params) for other in scene.targets):
        return "too like another target"
    if not draws.hands.allows(T, params.min_target_grasps):
        return f"fewer than {params.min_target_grasps} grasps within reach ({rest.resting})"
    rested = _rested(draws, f"target {target_id}", rest, T)
    return rested if isinstance(rested, str) else Placed(rest, pose, T, outline, rested[1])


def _rested(
    draws: Draws, item: str, rest: StablePose, T: Float[np.ndarray, "4 4"]
) -> tuple[Float[np.ndarray, "4 4"], tuple[float, float]] | str:
    """Where the object is after it was left alone there, and its drift."""
    T_rested, drift = rest_drift(draws.world, f"{draws.scene_id} {item}", T, draws.params.rest_s)
    if T_rested is None or drift[0] > draws.params.max_drift_m or drift[1] > draws.params.max_drift_rad:
        return f"did not stay at rest ({rest.resting})"
    return T_rested, drift


def _draw_rest(draws: Draws, initial: StablePose, target: int, draw: int) -> StablePose:
    """The resting pose of a target, by the shares of the recipe.

    It is kept over several draws of the place: drawn anew with every rejection, easy poses would crowd out the others.
    """
    rng = draws.rng(f"rest-{target}", draw // draws.params.draws_per_rest)
    others = [pose for pose in draws.object_model.stable_poses if pose.stable_pose_id != initial.stable_pose_id]
    if not others or rng.random() < draws.params.share_same_rest:
        return initial
    return others[int(rng.integers(len(others)))]


def _is_same(object_model: ObjectModel, T_a: Float[np.ndarray, "4 4"], T_b: Float[np.ndarray, "4 4"], params: SceneSamplingParams) -> bool:
    is_near = float(np.linalg.norm(T_a[:3, 3] - T_b[:3, 3])) < params.min_target_distance_m
    return is_near and object_model.rotation_error_rad(T_a[:3, :3], T_b[:3, :3]) < params.min_target_turn_rad


def is_relevant(obstacle: Obstacle, scene: Arrangement, params: SceneSamplingParams) -> bool:
    """Next to a target, or across the straight way from the object to one (the width of the object counts)."""
    box = _outline(obstacle)
    if any(gap_m(box, target.outline) <= params.near_gap_m[1] for target in scene.targets):
        return True
    half_width_m = 0.5 * float(np.ptp(scene.start.outline, axis=0).min())
    return any(gap_m(box, np.stack([scene.start.T[:2, 3], target.T[:2, 3]])) <= half_width_m for target in scene.targets)


def _outline(obstacle: Obstacle) -> Polygon:
    return box_footprint(obstacle.T_base_obstacle, obstacle.size_m)


def _outline_at(object_model: ObjectModel, rest: StablePose, yaw_rad: float, xy: Float[np.ndarray, "2"]) -> Polygon:
    return footprint(object_model, standing(xy, yaw_rad) @ rest.T_plane_object)
