"""A small release whose labels follow from geometry by a rule that fits on one page; nothing here plans or simulates.

The rule: a candidate can be planned when the hand at the place pose is within reach, above the table, clear of the obstacles and does not
point back at the robot; a planned one succeeds when the grasp holds the object near its middle and the object needs little turning. What
only just ends valid has slipped in the hand, which is no success.
So a ranker that reads the poses and the cloud can learn it, and one that cannot is broken.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tables import schemas
from tables.columns import joint_columns
from tables.identity import candidate_id_of, rng_for, scene_id_of
from tables.poses import inverse, pose_columns, pose_of, rotation_angle_rad
from tables.store import table_from_rows, write_table
from tables.tolerances import Tolerances
from tables.vocabulary import AdmissionStatus, ExecStatus, LiftStatus, PlanStatus, Split, SplitScheme

Row = dict[str, Any]

N_TARGETS = 8
HAND_OFFSET_M = 0.08  # from the TCP back to the middle of the hand
# What the synthetic labels are judged by.
TOLERANCES = Tolerances(position_m=0.020, rotation_rad=math.radians(10.0), slip_m=0.002, slip_rad=math.radians(2.0))
SLIPPED_MARGIN = 0.02  # ends as near to the tolerance as this have slipped in the hand
RELEASE_SCHEMAS = (
    schemas.OBJECTS, schemas.SCENES, schemas.OBSTACLES, schemas.TARGETS, schemas.SCENE_POINTS, schemas.GRASP_POOL, schemas.GRASPS,
    schemas.CANDIDATES, schemas.SPLITS, schemas.POLICY_FEATURES, schemas.TIMINGS,
)  # fmt: skip

_OBJECTS = {  # id: (category, symmetry, size)
    "can_01": ("can", "revolution_z", (0.066, 0.066, 0.122)),
    "mug_01": ("mug", "none", (0.070, 0.070, 0.095)),
    "cuboid_01": ("cuboid", "box", (0.060, 0.040, 0.150)),
    "can_02": ("can", "revolution_z", (0.053, 0.053, 0.090)),
    "mug_02": ("mug", "none", (0.062, 0.062, 0.110)),
    "cuboid_02": ("cuboid", "box", (0.050, 0.070, 0.070)),
}
_RESTING = ("upright", "inverted", "lying")
_OBSTACLE_SIZE_M = np.array([0.10, 0.08, 0.12])


def write_synthetic_release(directory: Path, n_scenes: int, seed: int, n_points: int = 600) -> Path:
    """Write every table of a release into `directory` and return it.

    Args:
        n_scenes: scenes `full-0000` and on, about 70 candidates each; k mod 5 of 3 is validation, 4 is test, the rest train.
        seed: decides every draw; the same arguments give the same bytes.
        n_points: points in each scene's cloud.
    """
    rows: dict[str, list[Row]] = {schema.name: [] for schema in RELEASE_SCHEMAS}
    for object_id in _OBJECTS:
        rows["objects"].append(_object_row(object_id))
        rows["grasp_pool"].extend(_pool_row(object_id, grasp_id, kind, T) for grasp_id, (kind, T) in enumerate(_pool(object_id)))
    for index in range(n_scenes):
        _add_scene(rows, index, seed, n_points)
    for schema in RELEASE_SCHEMAS:
        write_table(schema, table_from_rows(schema, rows[schema.name]), directory / f"{schema.name}.parquet")
    return directory


def _add_scene(rows: dict[str, list[Row]], index: int, seed: int, n_points: int) -> None:
    scene_id = scene_id_of("full", index)
    object_id = list(_OBJECTS)[index % len(_OBJECTS)]
    category, _, size = _OBJECTS[object_id]
    n_obstacles = (index + index // len(_OBJECTS)) % 3
    rng = rng_for(seed, "synthetic-scene", scene_id)
    T_base_object = _resting_pose(rng, "upright", size)
    targets = []
    for target_id in range(N_TARGETS):
        resting = _RESTING[rng.integers(3)]
        targets.append((target_id, resting, _resting_pose(rng, resting, size)))
    obstacles = [_obstacle_pose(rng, T_base_object) for _ in range(n_obstacles)]

    split = {3: Split.VALIDATION, 4: Split.TEST}.get(index % 5, Split.TRAIN)
    scene = {"scene_id": scene_id, "object_id": object_id, "category": category, "n_obstacles": n_obstacles}
    rows["splits"].append({"scene_id": scene_id, **_split_columns(index, scene, split)})
    rows["scenes"].append({**scene, "scene_index": index, "stable_pose_id": 0, "n_attempts": 1, **_pose_row("object", T_base_object)})
    for obstacle_id, T in enumerate(obstacles):
        size_row = dict(zip(("size_x_m", "size_y_m", "size_z_m"), _OBSTACLE_SIZE_M.tolist(), strict=True))
        rows["obstacles"].append({"scene_id": scene_id, "obstacle_id": obstacle_id, **_pose_row("obstacle", T), **size_row})
    for target_id, resting, T in targets:
        row = {"scene_id": scene_id, "target_id": target_id, "stable_pose_id": _RESTING.index(resting), "resting": resting}
        rows["targets"].append({**row, "rest_drift_m": 0.0, "rest_drift_rad": 0.0, **_pose_row("target", T)})
    rows["scene_points"].extend(_point_rows(rng, scene_id, T_base_object, size, obstacles, n_points))

    for grasp_id, (kind, T_object_grasp) in enumerate(_pool(object_id)):
        T_base_grasp = T_base_object @ T_object_grasp
        free = _hand_is_free(T_base_grasp, obstacles)
        reachable = _is_reachable(T_base_grasp)
        is_lifted = free and reachable and rng_for(seed, "synthetic-lift", scene_id, grasp_id).random() < 0.95
        rows["grasps"].append(_grasp_row(scene, grasp_id, kind, T_base_grasp, free, reachable, is_lifted, inverse(T_object_grasp)))
        for target_id, _, T_base_target in targets if is_lifted else []:
            labels = _labels(seed, candidate_id_of(scene_id, target_id, grasp_id), T_base_object, T_base_target, T_object_grasp, obstacles)
            rows["candidates"].append({**scene, "target_id": target_id, "grasp_id": grasp_id, **labels})
            place = T_base_target @ T_object_grasp
            feature_row = {"ik_feasible": _is_reachable(place), "gripper_free": _hand_is_free(place, obstacles)}
            rows["policy_features"].append({"candidate_id": labels["candidate_id"], **feature_row})
            for stage, core_ms in (("policy_ik", 0.4), ("policy_gripper", 2.0), ("planning", 8.0), ("execution", 120.0)):
                if stage != "execution" or labels["y_plan"]:
                    rows["timings"].append({"stage": stage, "item_id": labels["candidate_id"], "core_ms": core_ms})


def _split_columns(index: int, scene: Row, split: Split) -> Row:
    """The scene's split under every scheme: of the six objects the last is test and the one before it validation."""
    held_out = {
        SplitScheme.CATEGORY_CAN: scene["category"] == "can",
        SplitScheme.CATEGORY_MUG: scene["category"] == "mug",
        SplitScheme.CATEGORY_CUBOID: scene["category"] == "cuboid",
        SplitScheme.LAYOUT: scene["n_obstacles"] == 2,
    }
    seen = Split.VALIDATION if split is Split.VALIDATION else Split.TRAIN
    by_object = {4: Split.VALIDATION, 5: Split.TEST}.get(index % len(_OBJECTS), Split.TRAIN)
    schemes = {SplitScheme.SCENE: split, SplitScheme.OBJECT: by_object}
    schemes |= {scheme: Split.TEST if is_held_out else seen for scheme, is_held_out in held_out.items()}
    return {scheme.column: own.value for scheme, own in schemes.items()}


def _labels(
    seed: int,
    candidate_id: str,
    T_base_object: np.ndarray,
    T_base_target: np.ndarray,
    T_object_grasp: np.ndarray,
    obstacles: list[np.ndarray],
) -> Row:
    """Both labels of a candidate and every column that goes with them."""
    row: Row = {column.name: None for column in schemas.CANDIDATES.columns if column.nullable}
    T_base_place = T_base_target @ T_object_grasp
    if not _hand_is_free(T_base_place, obstacles):
        status = PlanStatus.PLACE_COLLISION
    elif not _is_reachable(T_base_place):
        status = PlanStatus.NO_IK
    else:
        status = PlanStatus.SOLVED
    y_plan = status is PlanStatus.SOLVED
    row |= {"candidate_id": candidate_id, "y_plan": y_plan, "plan_status": status.value, "used_search": False}
    row |= {"n_goals": 4 if y_plan else 0, "n_checks": 120 if y_plan else 3}
    if not y_plan:
        return row

    noise = float(rng_for(seed, "synthetic-execution", candidate_id).normal(0.0, 0.05))
    turn_rad = float(rotation_angle_rad(T_base_object[:3, :3], T_base_target[:3, :3]))
    off_middle_m = abs(float(T_object_grasp[2, 3]))
    margin = 0.75 - off_middle_m / 0.06 - 0.12 * turn_rad + noise
    y_pipe = margin >= SLIPPED_MARGIN
    ends = ((-0.5, ExecStatus.DROPPED), (-0.2, ExecStatus.OFF_TARGET), (0.0, ExecStatus.TOPPLED), (SLIPPED_MARGIN, ExecStatus.SLIPPED))
    exec_status = next((status for below, status in ends if margin < below), ExecStatus.SUCCESS)
    distance_m = float(np.linalg.norm(T_base_target[:3, 3] - T_base_object[:3, 3]))
    row |= {"min_clearance_m": 0.02, "plan_duration_s": 2.0 + 3.0 * distance_m, "path_length_rad": 1.0 + distance_m, "n_waypoints": 2}
    row |= {"y_pipe": y_pipe, "exec_status": exec_status.value, "tolerance_margin": margin}
    row |= {"final_position_error_m": 0.02 * (1.0 - margin), "final_rotation_error_rad": 0.1 * (1.0 - margin)}
    row |= {"transport_slip_m": 0.003 if exec_status is ExecStatus.SLIPPED else 0.001, "transport_slip_rad": 0.01}
    row |= {"release_position_error_m": 0.002, "release_rotation_error_rad": 0.01}
    row |= {"retreat_drag_m": 0.0005, "n_physics_steps": 800, **_pose_row("final", T_base_target)}
    return row


def _is_reachable(T_base_tcp: np.ndarray) -> bool:
    """Stands in for inverse kinematics: not too near or far, never reaching upwards or back towards the robot."""
    approach = T_base_tcp[:3, 2]
    hand_m = T_base_tcp[:3, 3] - HAND_OFFSET_M * approach
    reach_m = float(np.linalg.norm(hand_m[:2]))
    outwards = float(approach[:2] @ hand_m[:2]) / reach_m
    return bool(0.25 <= reach_m <= 0.75 and approach[2] < 0.3 and outwards > -0.6)


def _hand_is_free(T_base_tcp: np.ndarray, obstacles: list[np.ndarray]) -> bool:
    """Stands in for collision checking: the middle of the hand is 4 cm above the table and 5 cm from every obstacle's faces."""
    hand_m = T_base_tcp[:3, 3] - HAND_OFFSET_M * T_base_tcp[:3, 2]
    if hand_m[2] < 0.04:
        return False
    return all(bool(np.any(np.abs((inverse(T) @ np.append(hand_m, 1.0))[:3]) > _OBSTACLE_SIZE_M / 2 + 0.05)) for T in obstacles)


def _pool(object_id: str) -> list[tuple[str, np.ndarray]]:
    """Sixteen grasps in the object frame: from four sides at three heights, from above at four yaws."""
    size = np.array(_OBJECTS[object_id][2])
    grasps = []
    for height in (-0.3, 0.0, 0.3):
        for azimuth_rad in np.arange(4) * np.pi / 2:
            approach = -np.array([np.cos(azimuth_rad), np.sin(azimuth_rad), 0.0])
            grasps.append(("side", _frame(approach, np.array([0.0, 0.0, height * size[2]]))))
    for yaw_rad in np.arange(4) * np.pi / 4:
        T = _frame(np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 0.25 * size[2]]))
        grasps.append(("top", _turn_z(yaw_rad) @ T))
    return grasps


def _frame(approach: np.ndarray, origin_m: np.ndarray) -> np.ndarray:
    """TCP frame with z along the approach and a horizontal jaw axis y."""
    jaw = np.array([0.0, 1.0, 0.0]) if abs(approach[2]) > 0.9 else np.cross([0.0, 0.0, 1.0], approach)
    T = np.eye(4)
    T[:3, 1], T[:3, 2], T[:3, 3] = jaw, approach, origin_m
    T[:3, 0] = np.cross(jaw, approach)
    return T


def _resting_pose(rng: np.random.Generator, resting: str, size: tuple[float, ...]) -> np.ndarray:
    tilt_rad = {"upright": 0.0, "inverted": np.pi, "lying": np.pi / 2}[resting]
    T = _turn_z(rng.uniform(-np.pi, np.pi)) @ _turn_x(tilt_rad)
    height_m = (size[1] if resting == "lying" else size[2]) / 2
    T[:3, 3] = rng.uniform(0.35, 0.70), rng.uniform(-0.35, 0.35), height_m
    return T


def _obstacle_pose(rng: np.random.Generator, T_base_object: np.ndarray) -> np.ndarray:
    """A box anywhere in the workspace that leaves 16 cm around the initial object."""
    while True:
        position_m = np.array([rng.uniform(0.35, 0.70), rng.uniform(-0.35, 0.35), _OBSTACLE_SIZE_M[2] / 2])
        if np.linalg.norm(position_m[:2] - T_base_object[:2, 3]) > 0.16:
            T = _turn_z(rng.uniform(-np.pi, np.pi))
            T[:3, 3] = position_m
            return T


def _turn_z(angle_rad: float) -> np.ndarray:
    T = np.eye(4)
    T[:2, :2] = [[np.cos(angle_rad), -np.sin(angle_rad)], [np.sin(angle_rad), np.cos(angle_rad)]]
    return T


def _turn_x(angle_rad: float) -> np.ndarray:
    T = np.eye(4)
    T[1:3, 1:3] = [[np.cos(angle_rad), -np.sin(angle_rad)], [np.sin(angle_rad), np.cos(angle_rad)]]
    return T


def _point_rows(
    rng: np.random.Generator, scene_id: str, T_base_object: np.ndarray, size: tuple[float, ...], obstacles: list[np.ndarray], n_points: int
) -> list[Row]:
    """Half of the points on the table, a quarter on the object's box, the rest on the obstacles' (on the table where there are none)."""
    n_object = n_points // 4
    n_obstacle = n_points // 4 // max(len(obstacles), 1)
    clouds = [("object", _box_points(rng, T_base_object, np.array(size), n_object))]
    clouds += [("obstacle", _box_points(rng, T, _OBSTACLE_SIZE_M, n_obstacle)) for T in obstacles]
    n_table = n_points - sum(len(points) for _, points in clouds)
    table = np.column_stack([rng.uniform(0.2, 0.9, n_table), rng.uniform(-0.5, 0.5, n_table), np.zeros(n_table)])
    clouds.insert(0, ("environment", table))
    rows: list[Row] = []
    for point_type, points_m in clouds:
        for x, y, z in points_m.tolist():
            rows.append({"scene_id": scene_id, "point": len(rows), "point_type": point_type, "x_m": x, "y_m": y, "z_m": z})
    return rows


def _box_points(rng: np.random.Generator, T_base_box: np.ndarray, size_m: np.ndarray, n: int) -> np.ndarray:
    points = rng.uniform(-0.5, 0.5, (n, 3))
    face = rng.integers(3, size=n)
    points[np.arange(n), face] = np.where(rng.random(n) < 0.5, -0.5, 0.5)
    return (points * size_m) @ T_base_box[:3, :3].T + T_base_box[:3, 3]


def _grasp_row(
    scene: Row, grasp_id: int, kind: str, T_base_grasp: np.ndarray, free: bool, reachable: bool, is_lifted: bool, T_tcp_object: np.ndarray
) -> Row:
    row: Row = {column.name: None for column in schemas.GRASPS.columns if column.nullable}
    status = AdmissionStatus.SCENE_COLLISION if not free else AdmissionStatus.NO_IK if not reachable else AdmissionStatus.ADMITTED
    row |= {"scene_id": scene["scene_id"], "object_id": scene["object_id"], "grasp_id": grasp_id, "grasp_kind": kind}
    row |= {"admission_status": status.value, **_pose_row("grasp", T_base_grasp)}
    if status is not AdmissionStatus.ADMITTED:
        return row
    row |= {"n_ik": 4, "lift_status": (LiftStatus.LIFTED if is_lifted else LiftStatus.SLIPPED).value}
    row |= {name: 0.1 for prefix in ("pregrasp_q", "grasp_q", "lifted_q") for name in joint_columns(prefix)}
    row |= {"lift_slip_m": 0.001 if is_lifted else 0.03, "lift_slip_rad": 0.01}
    row |= {"lifted_finger_left_m": 0.02, "lifted_finger_right_m": 0.02}
    T_base_lifted = T_base_grasp @ T_tcp_object
    T_base_lifted[2, 3] += 0.12
    return row | _pose_row("lifted", T_base_lifted) | _pose_row("inhand", T_tcp_object)


def _object_row(object_id: str) -> Row:
    category, symmetry, size = _OBJECTS[object_id]
    row: Row = {column.name: 0.0 for column in schemas.OBJECTS.columns}
    row |= {"object_id": object_id, "category": category, "symmetry": symmetry, "name": object_id, "source": "synthetic"}
    row |= dict(zip(("size_x_m", "size_y_m", "size_z_m"), size, strict=True))
    row |= {
        "mass_kg": 0.3,
        "friction": 0.8,
        "ixx_kg_m2": 1e-4,
        "iyy_kg_m2": 1e-4,
        "izz_kg_m2": 1e-4,
        "mesh_volume_m3": float(np.prod(size)),
    }
    return row | {"hull_volume_ratio": 1.0, "min_graspable_width_m": min(size), "mesh_sha256": "0" * 64, "parts_sha256": "0" * 64}


def _pool_row(object_id: str, grasp_id: int, kind: str, T_object_grasp: np.ndarray) -> Row:
    row: Row = {"object_id": object_id, "grasp_id": grasp_id, "grasp_kind": kind, **_pose_row("objectgrasp", T_object_grasp)}
    return row | {"jaw_width_m": 0.05, "cone_margin_rad": 0.3, "com_distance_m": abs(float(T_object_grasp[2, 3]))}


def _pose_row(prefix: str, T: np.ndarray) -> Mapping[str, float]:
    return dict(zip(pose_columns(prefix), pose_of(T).tolist(), strict=True))
