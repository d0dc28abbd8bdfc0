"""What every sampled scene must be, whatever the object and the number of obstacles; and that it depends on its identity alone."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from objects.gripper import gripper_boxes, open_jaw_m
from objects.object_model import ObjectModel
from pipelines.codecs import scenes_from_tables
from pipelines.engines.physics.params import PhysicsParams
from pipelines.engines.physics.resting import rest_drift
from pipelines.engines.physics.world import PhysicsWorld
from pipelines.engines.robot.arm import ik
from pipelines.scenes.reach import OpenHands
from pipelines.scenes.sampling import SceneError, SceneSamplingParams, SceneTables, sample_scene
from pipelines.scenes.tabletop import box_footprint, footprint, gap_m, is_in_sector
from pipelines.values import Scene
from tables import schemas
from tables.store import table_from_rows
from tests.pipelines.engines.physics.object_models import can_model, cuboid_model, mug_model

PHYSICS = PhysicsParams()
# The hand-built objects have a dozen grasps where those of the catalogue have 64.
PARAMS = SceneSamplingParams(min_initial_grasps=2)
# All grasps of the hand-built mug are at its rim: upside down, where nine of ten targets of the recipe would have it, none is in reach.
RIM_PARAMS = dataclasses.replace(PARAMS, share_same_rest=0.5)
_CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
CASES = [(can_model(), 0, PARAMS), (can_model(), 2, PARAMS), (cuboid_model(), 1, PARAMS), (mug_model(), 2, RIM_PARAMS)]


def _sampled(
    object_model: ObjectModel, n_obstacles: int, params: SceneSamplingParams = PARAMS, seed: int = 42
) -> tuple[SceneTables, Scene]:
    tables = sample_scene(object_model, f"full-{n_obstacles:04d}", n_obstacles, params, PHYSICS, seed)
    arrow = [
        table_from_rows(schema, rows)
        for schema, rows in ((schemas.SCENES, tables.scenes), (schemas.OBSTACLES, tables.obstacles), (schemas.TARGETS, tables.targets))
    ]
    table_from_rows(schemas.SCENE_ATTEMPTS, tables.scene_attempts)
    return tables, scenes_from_tables(*arrow)[f"full-{n_obstacles:04d}"]


@pytest.mark.parametrize(("object_model", "n_obstacles", "params"), CASES, ids=["can-0", "can-2", "cuboid-1", "mug-2"])
def test_laws_of_a_scene(object_model: ObjectModel, n_obstacles: int, params: SceneSamplingParams) -> None:
    tables, scene = _sampled(object_model, n_obstacles, params)
    assert len(scene.targets) == params.n_targets
    assert len(scene.obstacles) == n_obstacles
    boxes = [box_footprint(o.T_base_obstacle, o.size_m) for o in scene.obstacles]
    start = footprint(object_model, scene.T_base_object)
    for k, box in enumerate(boxes):
        assert gap_m(box, start) >= params.object_gap_m - 1e-3
        assert all(gap_m(box, other) >= params.obstacle_gap_m for other in boxes[:k])
        assert scene.obstacles[k].T_base_obstacle[2, 3] == params.obstacle_size_m[2] / 2
    for target, row in zip(scene.targets, tables.targets, strict=True):
        T = target.T_base_target
        assert is_in_sector(T[:2, 3], params.radius_m, params.angle_rad)
        assert np.linalg.norm(T[:3, 3] - scene.T_base_object[:3, 3]) >= params.min_move_m
        assert all(gap_m(box, footprint(object_model, T)) >= params.target_gap_m - 1e-3 for box in boxes)
        assert row["rest_drift_m"] <= params.max_drift_m
        assert row["rest_drift_rad"] <= params.max_drift_rad
        # The stored drift is what a world of its own finds.
        with PhysicsWorld(object_model, (), PHYSICS) as world:
            assert rest_drift(world, "again", T, params.rest_s)[1] == (row["rest_drift_m"], row["rest_drift_rad"])
        for other in scene.targets[: target.target_id]:
            distance_m = np.linalg.norm(T[:3, 3] - other.T_base_target[:3, 3])
            turn_rad = object_model.rotation_error_rad(T[:3, :3], other.T_base_target[:3, :3])
            assert distance_m >= params.min_target_distance_m or turn_rad >= params.min_target_turn_rad


def test_obstacles_matter() -> None:
    """Each stands next to a target, or across the straight way from the object to one."""
    for n_obstacles in (1, 2):
        _, scene = _sampled(can_model(), n_obstacles)
        start = scene.T_base_object[:2, 3]
        for obstacle in scene.obstacles:
            box = box_footprint(obstacle.T_base_obstacle, obstacle.size_m)
            next_to = min(gap_m(box, footprint(can_model(), t.T_base_target)) for t in scene.targets) <= PARAMS.near_gap_m[1]
            way = min(gap_m(box, np.stack([start, t.T_base_target[:2, 3]])) for t in scene.targets) <= 0.033 + 1e-3
            assert next_to or way


def test_a_scene_depends_on_its_identity_alone() -> None:
    object_model = can_model()
    first = sample_scene(object_model, "full-0003", 1, PARAMS, PHYSICS, 42)
    sample_scene(cuboid_model(), "full-0004", 2, PARAMS, PHYSICS, 42)
    assert sample_scene(object_model, "full-0003", 1, PARAMS, PHYSICS, 42) == first
    assert sample_scene(object_model, "full-0003", 1, PARAMS, PHYSICS, 43).targets != first.targets
    assert sample_scene(object_model, "full-0005", 1, PARAMS, PHYSICS, 42).targets[0]["target_x_m"] != first.targets[0]["target_x_m"]


def test_the_share_of_resting_poses_is_the_recipe_s() -> None:
    object_model = can_model()
    same = dataclasses.replace(PARAMS, share_same_rest=1.0)
    other = dataclasses.replace(PARAMS, share_same_rest=0.0)
    tables, scene = _sampled(object_model, 0, same)
    assert {row["stable_pose_id"] for row in tables.targets} == {scene.stable_pose_id}
    tables, scene = _sampled(object_model, 0, other)
    assert scene.stable_pose_id not in {row["stable_pose_id"] for row in tables.targets}


def test_rejections_are_recorded_under_the_draw_that_failed() -> None:
    crowded = dataclasses.replace(PARAMS, radius_m=(0.35, 0.55), angle_rad=(-0.5, 0.5))
    tables, _ = _sampled(can_model(), 2, crowded)
    assert tables.scenes[0]["n_attempts"] == max(row["attempt"] for row in tables.scene_attempts) + 1 or tables.scenes[0]["n_attempts"] == 1
    draws = [row["draw"] for row in tables.scene_attempts if row["item"] == "target-0" and row["attempt"] == 0]
    assert draws == list(range(len(draws)))
    assert all(row["reason"] for row in tables.scene_attempts)
    assert tables.scene_attempts


def test_an_impossible_scene_ends_with_an_error_that_names_it() -> None:
    nowhere = dataclasses.replace(PARAMS, radius_m=(2.0, 2.1), max_attempts=2, max_draws=3)
    with pytest.raises(SceneError, match=r"full-0000 \(test_can\): no valid scene in 2 attempts; last object: fewer than 2 grasps"):
        sample_scene(can_model(), "full-0000", 0, nowhere, PHYSICS, 42)


@pytest.mark.parametrize("resting", ["upright", "lying"])
def test_reach_counts_hands_above_the_table_that_the_arm_reaches(resting: str) -> None:
    """Against brute force: every corner of every box of the hand, every grasp."""
    object_model = can_model()
    hands = OpenHands(object_model, 8)
    T = next(pose for pose in object_model.stable_poses if pose.resting == resting).T_plane_object.copy()
    T[:2, 3] = 0.5, 0.0
    n = 0
    for grasp in object_model.grasps:
        T_boxes, size_m = gripper_boxes(open_jaw_m(grasp.jaw_width_m))
        corners = (
            T
            @ grasp.T_object_grasp
            @ T_boxes
            @ np.concatenate([_CORNERS[:, None] * size_m / 2, np.ones((8, len(size_m), 1))], -1)[..., None]
        )
        n += bool(corners[:, :, 2].min() > 0.0 and len(ik(T @ grasp.T_object_grasp, 8)))
    assert n > 0
    assert hands.allows(T, n)
    assert not hands.allows(T, n + 1)
    T[0, 3] = 1.5
    assert not hands.allows(T, 1)


@pytest.mark.parametrize(
    ("field", "value"),
    [("radius_m", (0.7, 0.3)), ("share_same_rest", 1.5), ("n_targets", 0), ("target_gap_m", 0.05), ("near_gap_m", (0.2, 0.1))],
)
def test_params_are_valid_from_birth(field: str, value: object) -> None:
    with pytest.raises(ValueError, match=field):
        SceneSamplingParams(**{field: value})  # type: ignore[arg-type]
