"""Derived geometry of a candidate: what follows from the five inputs and the hand's dimensions alone; features.py says what each is.

Nothing here knows a label, a plan or the scene's true shapes: object and obstacles are their points, the table is its points' height.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyarrow as pa
from jaxtyping import Float

from model.distances import box_distance_m, cloud_distance_m, lowest_corner_m, moved, segment_distance_m
from model.errors import InputError
from model.features import CANDIDATE_GEOMETRY, FEATURES, FURTHEST_M, PHASES
from model.hand import PAD_HALF_M, SHOULDER_M, WRIST_FROM_TCP_M, WRIST_OFFSET_M, hand_boxes, open_jaw_m
from model.inputs import ENVIRONMENT, OBJECT, OBSTACLE, ReleaseInputs, SceneCloud
from tables.poses import inverse, rotation_angle_rad
from tables.store import table_from_columns

Columns = dict[str, Float[np.ndarray, "c"]]

_OFFSETS_M = {"above5": 0.05, "above15": 0.15}
_BACK_M = 0.15


def candidate_geometry(inputs: ReleaseInputs) -> Float[np.ndarray, "c f"]:
    """Every feature of every candidate, columns as in FEATURES.

    Raises:
        InputError: a feature that is not finite.
    """
    geometry = np.empty((len(inputs.candidate_ids), len(FEATURES)))
    points = [_ScenePoints.of(cloud) for cloud in inputs.clouds]
    for group, scene in enumerate(inputs.group_scene):
        mine = np.flatnonzero(inputs.candidate_group == group)
        columns = _of_group(points[scene], inputs.T_base_grasp[mine], inputs.T_grasp_object[mine], inputs.T_base_target[group])
        geometry[mine] = np.column_stack([columns.pop(feature.name) for feature in FEATURES])
        if columns:
            raise InputError(f"geometry {sorted(columns)[0]}: is no feature, must be one of FEATURES")
    for row, column in np.argwhere(~np.isfinite(geometry))[:1]:
        raise InputError(f"{inputs.candidate_ids[row]}: {FEATURES[column].name} is {geometry[row, column]}, must be finite")
    return geometry


def geometry_table(inputs: ReleaseInputs, geometry: Float[np.ndarray, "c f"]) -> pa.Table:
    """Table `candidate_geometry`: a row a candidate."""
    columns = {feature.name: geometry[:, k] for k, feature in enumerate(FEATURES)}
    return table_from_columns(CANDIDATE_GEOMETRY, {"candidate_id": list(inputs.candidate_ids), **columns})


@dataclass(frozen=True, slots=True)
class _ScenePoints:
    """The points of a scene by type, in an order that does not depend on how they were stored, so that sums do not either."""

    object_m: Float[np.ndarray, "n 3"]
    obstacle_m: Float[np.ndarray, "m 3"]
    table_m: float
    T_base_object: Float[np.ndarray, "4 4"]

    @classmethod
    def of(cls, cloud: SceneCloud) -> _ScenePoints:
        of_type = {}
        for number in (ENVIRONMENT, OBJECT, OBSTACLE):
            points_m = cloud.points_m[cloud.point_types == number].astype(np.float64)
            of_type[number] = points_m[np.lexsort(points_m.T[::-1])]
        table_m = float(np.median(of_type[ENVIRONMENT][:, 2]))
        return cls(of_type[OBJECT], of_type[OBSTACLE], table_m, cloud.T_base_object)


def _of_group(
    scene: _ScenePoints,
    T_base_grasp: Float[np.ndarray, "c 4 4"],
    T_grasp_object: Float[np.ndarray, "c 4 4"],
    T_base_target: Float[np.ndarray, "4 4"],
) -> Columns:
    """Features of the candidates of one target."""
    n = len(T_base_grasp)
    T_base_place = place_pose(T_base_target, scene.T_base_object, T_base_grasp)
    hand_of = hand_poses(T_base_grasp, T_base_place)

    poses = {"grasp": T_base_grasp, "relative": T_grasp_object, "composed": T_base_place}
    columns = {name: values for prefix, T in poses.items() for name, values in pose_geometry(prefix, T).items()}
    columns |= pose_geometry("target", np.broadcast_to(T_base_target, (n, 4, 4)))
    for phase in ("pick", "place"):
        columns |= arm_geometry(phase, hand_of[phase], scene.table_m)
    for phase in ("pick", "place", "above15", "back15"):
        columns |= reach_geometry(phase, hand_of[phase])
    columns |= swing_geometry(hand_of)

    inhand_m = moved(inverse(T_base_grasp), np.broadcast_to(scene.object_m, (n, *scene.object_m.shape)))
    held = _held_columns(inhand_m)
    boxes = hand_boxes(open_jaw_m(held["held_width_m"]))
    to_object = box_distance_m(inhand_m, *boxes)
    columns |= held | {"hand_object_m": to_object[:, 0], "fingers_object_m": to_object[:, 1:].min(axis=1)}
    columns |= _object_columns(scene, T_base_target, n) | grasp_in_object(T_grasp_object)
    for phase in ("pick", "place"):
        columns |= weight_geometry(phase, hand_of[phase], inhand_m.mean(axis=1))
    for phase in ("pick", "place", "back15"):
        low_m = lowest_corner_m(hand_of[phase], *boxes) - scene.table_m
        columns |= {f"{phase}_hand_low_m": low_m[:, 0], f"{phase}_fingers_low_m": low_m[:, 1:].min(axis=1)}
    for phase in PHASES:
        columns |= _obstacle_columns(phase, scene, hand_of[phase], boxes)
    return columns


def place_pose(
    T_base_target: Float[np.ndarray, "*c 4 4"], T_base_object: Float[np.ndarray, "*c 4 4"], T_base_grasp: Float[np.ndarray, "*c 4 4"]
) -> Float[np.ndarray, "*c 4 4"]:
    """T_base_place of the TCP: where the hand is when the object, grasped as it stands, is at the target."""
    T_base_place: Float[np.ndarray, "*c 4 4"] = np.einsum(
        "...ij,...jk->...ik", np.einsum("...ij,...jk->...ik", T_base_target, inverse(T_base_object)), T_base_grasp
    )
    return T_base_place


def hand_poses(T_base_grasp: Float[np.ndarray, "c 4 4"], T_base_place: Float[np.ndarray, "c 4 4"]) -> dict[str, Float[np.ndarray, "c 4 4"]]:
    """Where the TCP is in each of PHASES, base frame."""
    hand_of = {"pick": T_base_grasp, "place": T_base_place, "back15": T_base_place.copy()}
    for phase, offset_m in _OFFSETS_M.items():
        hand_of[phase] = T_base_place.copy()
        hand_of[phase][:, 2, 3] += offset_m
    hand_of["back15"][:, :3, 3] -= _BACK_M * T_base_place[:, :3, 2]
    return hand_of


def pose_geometry(prefix: str, T: Float[np.ndarray, "c 4 4"]) -> Columns:
    columns = {f"{prefix}_{axis}_m": T[:, k, 3] for k, axis in enumerate("xyz")}
    return columns | {f"{prefix}_{of}{axis}": T[:, k, column] for column, of in ((1, "y"), (2, "z")) for k, axis in enumerate("xyz")}


def wrist_point_m(T: Float[np.ndarray, "c 4 4"]) -> Float[np.ndarray, "c 3"]:
    wrist_m: Float[np.ndarray, "c 3"] = T[:, :3, 3] - WRIST_FROM_TCP_M * T[:, :3, 2]
    return wrist_m


def arm_geometry(phase: str, T: Float[np.ndarray, "c 4 4"], table_m: float) -> Columns:
    """Wrist, approach and jaw in the vertical plane of the base axis and the TCP."""
    wrist_m = wrist_point_m(T)
    azimuth_rad = np.arctan2(T[:, 1, 3], T[:, 0, 3])
    cos, sin = np.cos(azimuth_rad), np.sin(azimuth_rad)
    columns = {
        f"{phase}_azimuth_rad": azimuth_rad,
        f"{phase}_tcp_radius_m": np.hypot(T[:, 0, 3], T[:, 1, 3]),
        f"{phase}_wrist_radius_m": np.hypot(wrist_m[:, 0], wrist_m[:, 1]),
        f"{phase}_wrist_height_m": wrist_m[:, 2] - table_m,
    }
    for name, axis in (("jaw", T[:, :3, 1]), ("approach", T[:, :3, 2])):
        columns[f"{phase}_{name}_out"] = cos * axis[:, 0] + sin * axis[:, 1]
        columns[f"{phase}_{name}_left"] = cos * axis[:, 1] - sin * axis[:, 0]
        columns[f"{phase}_{name}_up"] = axis[:, 2]
    return columns


def reach_geometry(phase: str, T: Float[np.ndarray, "c 4 4"]) -> Columns:
    """Joint 7 turns the axis of joint 6 on a circle about the approach: its nearest and furthest distance from the shoulder."""
    to_shoulder_m = np.array(SHOULDER_M) - wrist_point_m(T)
    along_m = np.sum(to_shoulder_m * T[:, :3, 2], axis=1)
    across_m = np.linalg.norm(to_shoulder_m - along_m[:, None] * T[:, :3, 2], axis=1)
    return {
        f"{phase}_reach_near_m": np.hypot(along_m, across_m - WRIST_OFFSET_M),
        f"{phase}_reach_far_m": np.hypot(along_m, across_m + WRIST_OFFSET_M),
    }


def _held_columns(inhand_m: Float[np.ndarray, "c n 3"]) -> Columns:
    columns: Columns = {}
    low_m, high_m, mean_m = inhand_m.min(axis=1), inhand_m.max(axis=1), inhand_m.mean(axis=1)
    for k, axis in enumerate("xyz"):
        columns |= {f"inhand_{axis}_low_m": low_m[:, k], f"inhand_{axis}_high_m": high_m[:, k], f"inhand_{axis}_mean_m": mean_m[:, k]}
    is_between = np.all(np.abs(inhand_m) <= np.array(PAD_HALF_M), axis=2)
    columns["held_width_m"] = 2 * np.max(np.abs(inhand_m[..., 1]) * is_between, axis=1)
    columns["held_share"] = is_between.mean(axis=1)
    return columns


def _object_columns(scene: _ScenePoints, T_base_target: Float[np.ndarray, "4 4"], n: int) -> Columns:
    T_to_target = T_base_target @ inverse(scene.T_base_object)
    moved_m = moved(T_to_target, scene.object_m)
    values = _extents(moved(inverse(scene.T_base_object), scene.object_m))
    for when, points_m in (("initial", scene.object_m), ("moved", moved_m)):
        mean_m = points_m.mean(axis=0)
        values[f"{when}_height_m"] = points_m[:, 2].max() - scene.table_m
        values[f"{when}_mean_height_m"] = mean_m[2] - scene.table_m
        values[f"{when}_spread_m"] = np.hypot(*(points_m - mean_m)[:, :2].T).max()
    values["turn_rad"] = float(rotation_angle_rad(scene.T_base_object[:3, :3], T_base_target[:3, :3]))
    values["tilt_rad"] = float(np.arctan2(np.hypot(T_to_target[0, 2], T_to_target[1, 2]), T_to_target[2, 2]))
    values["carry_m"] = float(np.hypot(*(T_base_target[:2, 3] - scene.T_base_object[:2, 3])))
    values["target_obstacle_m"] = FURTHEST_M
    if len(scene.obstacle_m):
        values["target_obstacle_m"] = min(FURTHEST_M, cloud_distance_m(moved_m, scene.obstacle_m))
    return {name: np.full(n, value) for name, value in values.items()}


def _extents(points_m: Float[np.ndarray, "n 3"]) -> dict[str, float]:
    low_m, high_m = points_m.min(axis=0), points_m.max(axis=0)
    return {f"object_{axis}_{of}_m": float(m[k]) for k, axis in enumerate("xyz") for of, m in (("low", low_m), ("high", high_m))}


def grasp_in_object(T_grasp_object: Float[np.ndarray, "c 4 4"]) -> Columns:
    T_object_grasp = inverse(T_grasp_object)
    return {f"object_grasp_{axis}_m": T_object_grasp[:, k, 3] for k, axis in enumerate("xyz")}


def swing_geometry(hand_of: dict[str, Float[np.ndarray, "c 4 4"]]) -> Columns:
    (x, y), (to_x, to_y) = (hand_of[phase][:, :2, 3].T for phase in ("pick", "place"))
    return {"swing_rad": np.arctan2(x * to_y - y * to_x, x * to_x + y * to_y)}


def weight_geometry(phase: str, T: Float[np.ndarray, "c 4 4"], mean_inhand_m: Float[np.ndarray, "c 3"]) -> Columns:
    """Lever of a weight at the mean of the object's points; only its part about the jaw axis turns the object between the pads."""
    from_tcp_m = moved(T, mean_inhand_m[:, None])[:, 0] - T[:, :3, 3]
    torque = np.cross(from_tcp_m, np.array([0.0, 0.0, -1.0]))
    return {
        f"{phase}_lever_jaw_m": np.abs(np.sum(torque * T[:, :3, 1], axis=1)),
        f"{phase}_lever_m": np.hypot(from_tcp_m[:, 0], from_tcp_m[:, 1]),
        f"{phase}_above_m": -from_tcp_m[:, 2],
    }


def _obstacle_columns(
    phase: str, scene: _ScenePoints, T: Float[np.ndarray, "c 4 4"], boxes: tuple[Float[np.ndarray, "c b 3"], Float[np.ndarray, "b 3"]]
) -> Columns:
    names = [f"{phase}_{name}_obstacle_m" for name in ("hand", "fingers", "wrist", "arm")]
    if not len(scene.obstacle_m):
        return {name: np.full(len(T), FURTHEST_M) for name in names}
    to_boxes = box_distance_m(moved(inverse(T), np.broadcast_to(scene.obstacle_m, (len(T), *scene.obstacle_m.shape))), *boxes)
    wrist_m = wrist_point_m(T)
    to_wrist = segment_distance_m(scene.obstacle_m, wrist_m, wrist_m)
    to_arm = segment_distance_m(scene.obstacle_m, np.broadcast_to(SHOULDER_M, wrist_m.shape), wrist_m)
    nearest = (to_boxes[:, 0], to_boxes[:, 1:].min(axis=1), to_wrist, to_arm)
    return {name: np.minimum(values, FURTHEST_M) for name, values in zip(names, nearest, strict=True)}
