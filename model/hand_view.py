"""What the hand of a candidate meets at the place: the nearest typed points in its frame, and the features of geometry.py, made fast.

Geometry.py is the slow, exact twin: every point, one target after the other, float64. Here all candidates of a scene are looked at
together in float32, what depends on the grasp alone is computed once a grasp, and obstacles are thinned to a well-spread few.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int

from model.clouds import farthest_points
from model.distances import lowest_corner_m, segment_distance_m
from model.features import FEATURES, FURTHEST_M, PHASES, POSE_FEATURES
from model.geometry import (
    Columns,
    arm_geometry,
    grasp_in_object,
    hand_poses,
    place_pose,
    pose_geometry,
    reach_geometry,
    swing_geometry,
    weight_geometry,
    wrist_point_m,
)
from model.hand import PAD_HALF_M, SHOULDER_M, folded_hand_boxes, hand_boxes, open_jaw_m
from model.inputs import ENVIRONMENT, OBJECT, OBSTACLE, SceneCloud
from model.local_settings import LocalSettings
from tables.poses import inverse, rotation_angle_rad

# Phases in which a near point is measured from the hand; the pick is known to be free.
NEAR_PHASES = ("place", "above5", "above15", "back15")
N_NEAR_VALUES = 3 + len(NEAR_PHASES)

Gaps = dict[
    str, tuple[Float[np.ndarray, "c n"], Float[np.ndarray, "c n"]]
]  # by phase: signed distances to the hand's body and to its fingers
Axes = list[Float[np.ndarray, "c n"]]  # x, y and z of n points in c frames: numpy is several times slower along a last axis of 3


@dataclass(frozen=True, slots=True)
class HandView:
    """What is seen of the candidates of one scene.

    A near point is its place in the TCP frame at the place, and its signed distances from the hand in NEAR_PHASES. Where a scene has
    fewer points of a type than asked for, the rest repeat the last one; where it has none, they are of type -1.
    """

    features: Float32[np.ndarray, "c f"]
    near_m: Float32[np.ndarray, "c m 7"]
    near_types: Int[np.ndarray, "c m"]


def hand_view(
    cloud: SceneCloud, T_base_grasp: Float[np.ndarray, "c 4 4"], T_base_target: Float[np.ndarray, "c 4 4"], settings: LocalSettings
) -> HandView:
    """View of the candidates of one scene; a target is given once a candidate."""
    points = _ThinnedPoints.of(cloud, settings)
    first, grasp = _distinct(T_base_grasp)
    first_target, target = _distinct(T_base_target)
    hands = hand_poses(T_base_grasp, place_pose(T_base_target, cloud.T_base_object, T_base_grasp))

    in_hand = _into(T_base_grasp[first], points.object_m)
    held = _held_columns(in_hand)
    jaw_m = open_jaw_m(held["held_width_m"])
    held |= dict(zip(("hand_object_m", "fingers_object_m"), (gap.min(axis=1) for gap in _hand_gaps(in_hand, jaw_m)), strict=True))
    of_target = _object_columns(points, cloud.T_base_object, T_base_target[first_target])

    columns = {name: values[grasp] for name, values in held.items()} | {name: values[target] for name, values in of_target.items()}
    T_grasp_object = inverse(T_base_grasp) @ cloud.T_base_object
    columns |= pose_features(T_base_grasp, T_grasp_object, T_base_target, hands, points.table_m) | grasp_in_object(T_grasp_object)
    mean_inhand_m = np.column_stack([columns[f"inhand_{axis}_mean_m"] for axis in "xyz"])
    for phase in ("pick", "place"):
        columns |= weight_geometry(phase, hands[phase], mean_inhand_m)
    columns |= low_columns(hands, jaw_m[grasp], points.table_m)
    gaps: Gaps = {phase: _hand_gaps(_into(hands[phase], points.obstacle_m), jaw_m[grasp]) for phase in PHASES if phase != "pick"}
    to_body, to_fingers = _hand_gaps(_into(T_base_grasp[first], points.obstacle_m), jaw_m)
    gaps["pick"] = to_body[grasp], to_fingers[grasp]
    columns |= _obstacle_columns(points.obstacle_m, hands, gaps)
    near_m, near_types = _nearest(points, hands, gaps, jaw_m[grasp], settings)
    return HandView(
        features=np.column_stack([columns[feature.name] for feature in FEATURES]).astype(np.float32),
        near_m=near_m,
        near_types=near_types,
    )


def pose_view(
    T_base_object: Float[np.ndarray, "4 4"], T_base_grasp: Float[np.ndarray, "c 4 4"], T_base_target: Float[np.ndarray, "c 4 4"]
) -> HandView:
    """View of the candidates of one scene by their poses alone: POSE_FEATURES, heights over z = 0, and no point."""
    hands = hand_poses(T_base_grasp, place_pose(T_base_target, T_base_object, T_base_grasp))
    columns = pose_features(T_base_grasp, inverse(T_base_grasp) @ T_base_object, T_base_target, hands, table_m=0.0)
    n = len(T_base_grasp)
    return HandView(
        features=np.column_stack([columns[feature.name] for feature in POSE_FEATURES]).astype(np.float32),
        near_m=np.zeros((n, 0, N_NEAR_VALUES), dtype=np.float32),
        near_types=np.zeros((n, 0), dtype=np.int8),
    )


def pose_features(
    T_base_grasp: Float[np.ndarray, "c 4 4"],
    T_grasp_object: Float[np.ndarray, "c 4 4"],
    T_base_target: Float[np.ndarray, "c 4 4"],
    hands: dict[str, Float[np.ndarray, "c 4 4"]],
    table_m: float,
) -> Columns:
    """The features that follow from poses alone."""
    poses = {"grasp": T_base_grasp, "relative": T_grasp_object, "target": T_base_target, "composed": hands["place"]}
    columns = {name: values for prefix, T in poses.items() for name, values in pose_geometry(prefix, T).items()}
    for phase in ("pick", "place"):
        columns |= arm_geometry(phase, hands[phase], table_m)
    for phase in ("pick", "place", "above15", "back15"):
        columns |= reach_geometry(phase, hands[phase])
    return columns | swing_geometry(hands)


def low_columns(hands: dict[str, Float[np.ndarray, "c 4 4"]], jaw_m: Float[np.ndarray, "c"], table_m: float) -> Columns:
    """Lowest points of the hand over the table."""
    columns: Columns = {}
    boxes = hand_boxes(jaw_m)
    for phase in ("pick", "place", "back15"):
        low_m = lowest_corner_m(hands[phase], *boxes) - table_m
        columns |= {f"{phase}_hand_low_m": low_m[:, 0], f"{phase}_fingers_low_m": low_m[:, 1:].min(axis=1)}
    return columns


@dataclass(frozen=True, slots=True)
class _ThinnedPoints:
    """Points of a scene by type, base frame, float32; all of the object, and a well-spread few of the rest."""

    object_m: Float32[np.ndarray, "n 3"]
    few_object_m: Float32[np.ndarray, "k 3"]
    obstacle_m: Float32[np.ndarray, "m 3"]
    environment_m: Float32[np.ndarray, "e 3"]
    table_m: float

    @classmethod
    def of(cls, cloud: SceneCloud, settings: LocalSettings) -> _ThinnedPoints:
        of_type = {number: cloud.points_m[cloud.point_types == number] for number in (ENVIRONMENT, OBJECT, OBSTACLE)}
        environment_m, object_m = of_type[ENVIRONMENT], of_type[OBJECT]
        return cls(
            # Sorted, so that a mean does not depend on how the points were stored.
            object_m=object_m[np.lexsort(object_m.T[::-1])],
            few_object_m=farthest_points(object_m, settings.n_object_points),
            obstacle_m=farthest_points(of_type[OBSTACLE], min(settings.n_obstacle_points, len(of_type[OBSTACLE]))),
            environment_m=farthest_points(environment_m, min(settings.n_environment_points, len(environment_m))),
            table_m=float(np.median(environment_m[:, 2])),
        )


def _distinct(T: Float[np.ndarray, "c 4 4"]) -> tuple[Int[np.ndarray, "k"], Int[np.ndarray, "c"]]:
    """(row of the first of each distinct pose, number of the pose of each row); poses of one grasp or target are equal to the bit."""
    _, first, number = np.unique(T[:, :3].reshape(len(T), 12), axis=0, return_index=True, return_inverse=True)
    return first, number.reshape(-1)


def _into(T: Float[np.ndarray, "c 4 4"], points_m: Float32[np.ndarray, "n 3"]) -> Axes:
    """Points of frame a in frame b, for T_a_b, axis by axis."""
    # Written out, not as a matrix product: BLAS may add in another order when it has another number of threads.
    T = T.astype(np.float32)
    x, y, z = (points_m[None, :, k] - T[:, k, 3, None] for k in range(3))
    return [T[:, 0, k, None] * x + T[:, 1, k, None] * y + T[:, 2, k, None] * z for k in range(3)]


def _hand_gaps(in_hand_m: Axes, jaw_m: Float[np.ndarray, "c"]) -> tuple[Float[np.ndarray, "c n"], Float[np.ndarray, "c n"]]:
    """Signed distance of each point to (body of the hand, nearest finger), for points in the TCP frame."""
    # The hand is its own mirror image, so points are folded onto +x and +y, where one pad and one finger are.
    x, y, z = np.abs(in_hand_m[0]), np.abs(in_hand_m[1]), in_hand_m[2]
    gaps = []
    for (centre_y, centre_z), half in folded_hand_boxes():
        apart_y = y if centre_y is None else np.abs(y - (np.float32(centre_y) + jaw_m.astype(np.float32) / 2)[:, None])
        outside = (x - np.float32(half[0]), apart_y - np.float32(half[1]), np.abs(z - np.float32(centre_z)) - np.float32(half[2]))
        deepest = np.maximum(np.maximum(outside[0], outside[1]), outside[2])
        away2 = sum(np.square(np.maximum(gap, np.float32(0.0))) for gap in outside)
        gaps.append(np.sqrt(away2) + np.minimum(deepest, np.float32(0.0)))
    return gaps[0], np.minimum(*gaps[1:])


def _held_columns(in_hand_m: Axes) -> Columns:
    columns: Columns = {}
    for axis, values in zip("xyz", in_hand_m, strict=True):
        columns |= {f"inhand_{axis}_{name}_m": getattr(values, name_of)(axis=1) for name, name_of in _BOUNDS}
    is_between = np.ones(in_hand_m[0].shape, dtype=bool)
    for values, half_m in zip(in_hand_m, PAD_HALF_M, strict=True):
        is_between &= np.abs(values) <= np.float32(half_m)
    columns["held_width_m"] = 2 * np.max(np.abs(in_hand_m[1]) * is_between, axis=1)
    columns["held_share"] = is_between.mean(axis=1)
    return columns


_BOUNDS = (("low", "min"), ("high", "max"), ("mean", "mean"))


def _object_columns(points: _ThinnedPoints, T_base_object: Float[np.ndarray, "4 4"], T_base_target: Float[np.ndarray, "g 4 4"]) -> Columns:
    """Features of the object at each target."""
    columns: Columns = {}
    for axis, values in zip("xyz", _into(T_base_object[None], points.object_m), strict=True):
        columns |= {f"object_{axis}_{name}_m": np.repeat(getattr(values, of)(), len(T_base_target)) for name, of in _BOUNDS[:2]}
    T_to_target = T_base_target @ inverse(T_base_object)
    # A frame in which the object stands still while the world moves: its points at the target are those that `inverse` brings there.
    moved = _into(inverse(T_to_target), points.object_m)
    initial = [points.object_m[None, :, k] for k in range(3)]
    for when, (x, y, z) in (("initial", initial), ("moved", moved)):
        across2 = np.square(x - x.mean(axis=1, keepdims=True)) + np.square(y - y.mean(axis=1, keepdims=True))
        told = (z.max(axis=1) - points.table_m, z.mean(axis=1) - points.table_m, np.sqrt(across2.max(axis=1)))
        for name, value in zip(("height_m", "mean_height_m", "spread_m"), told, strict=True):
            columns[f"{when}_{name}"] = np.broadcast_to(value, len(T_base_target))
    columns["turn_rad"] = rotation_angle_rad(T_base_object[:3, :3], T_base_target[:, :3, :3])
    columns["tilt_rad"] = np.arctan2(np.hypot(T_to_target[:, 0, 2], T_to_target[:, 1, 2]), T_to_target[:, 2, 2])
    columns["carry_m"] = np.hypot(*(T_base_target[:, :2, 3] - T_base_object[:2, 3]).T)
    columns["target_obstacle_m"] = np.full(len(T_base_target), FURTHEST_M)
    if len(points.obstacle_m):
        few = _into(inverse(T_to_target), points.few_object_m)
        gap2 = sum(np.square(axis[:, :, None] - points.obstacle_m[None, None, :, k]) for k, axis in enumerate(few))
        columns["target_obstacle_m"] = np.minimum(FURTHEST_M, np.sqrt(np.min(gap2, axis=(1, 2))))
    return columns


def _obstacle_columns(
    obstacle_m: Float32[np.ndarray, "n 3"],
    hands: dict[str, Float[np.ndarray, "c 4 4"]],
    gaps: Gaps,
) -> Columns:
    columns: Columns = {}
    for phase, T in hands.items():
        names = [f"{phase}_{name}_obstacle_m" for name in ("hand", "fingers", "wrist", "arm")]
        if not len(obstacle_m):
            columns |= {name: np.full(len(T), FURTHEST_M) for name in names}
            continue
        wrist = wrist_point_m(T).astype(np.float32)
        shoulder = np.broadcast_to(np.array(SHOULDER_M, dtype=np.float32), wrist.shape)
        lines = (segment_distance_m(obstacle_m, wrist, wrist), segment_distance_m(obstacle_m, shoulder, wrist))
        nearest = (*(gap.min(axis=1) for gap in gaps[phase]), *lines)
        columns |= {name: np.minimum(values, FURTHEST_M) for name, values in zip(names, nearest, strict=True)}
    return columns


def _nearest(
    points: _ThinnedPoints,
    hands: dict[str, Float[np.ndarray, "c 4 4"]],
    obstacle_gaps: Gaps,
    jaw_m: Float[np.ndarray, "c"],
    settings: LocalSettings,
) -> tuple[Float32[np.ndarray, "c m 7"], Int[np.ndarray, "c m"]]:
    """The points of each type that come nearest to the hand in any of NEAR_PHASES; a tie goes to the point that was thinned to first."""
    parts, types = [], []
    environment_gaps = {phase: _hand_gaps(_into(hands[phase], points.environment_m), jaw_m) for phase in NEAR_PHASES}
    for number, cloud_m, gaps, n_near in (
        (OBSTACLE, points.obstacle_m, obstacle_gaps, settings.n_near_obstacle),
        (ENVIRONMENT, points.environment_m, environment_gaps, settings.n_near_environment),
    ):
        types.append(np.full((len(jaw_m), n_near), number if len(cloud_m) else -1, dtype=np.int8))
        if not len(cloud_m):
            parts.append(np.zeros((len(jaw_m), n_near, N_NEAR_VALUES), dtype=np.float32))
            continue
        from_hand = [np.minimum(*gaps[phase]) for phase in NEAR_PHASES]
        order = np.argsort(np.minimum.reduce(from_hand), axis=1, kind="stable")[:, :n_near]
        chosen = order[:, np.minimum(np.arange(n_near), order.shape[1] - 1)]
        values = [*_into(hands["place"], cloud_m), *from_hand]
        parts.append(np.stack([np.take_along_axis(value, chosen, axis=1) for value in values], axis=-1))
    return np.concatenate(parts, axis=1), np.concatenate(types, axis=1)
