"""The derived features of a candidate: name, unit and meaning of each, in the order of the columns; they are computed in geometry.py."""

from __future__ import annotations

from dataclasses import dataclass

from tables.columns import TableSchema, plain, real


@dataclass(frozen=True, slots=True)
class Feature:
    """One number of a candidate. Unit m, rad or none."""

    name: str
    unit: str
    meaning: str

    def __post_init__(self) -> None:
        if not self.name.isidentifier() or self.unit not in ("", "m", "rad") or not self.meaning:
            raise ValueError(f"feature {self.name!r}: unit {self.unit!r}, must have a name, a meaning, and a unit among m, rad and none")


# Where the hand is looked at. The plan comes down on the place from straight above and leaves back along the approach.
PHASES = {
    "pick": "at the grasp",
    "place": "at the place",
    "above5": "5 cm straight above the place",
    "above15": "15 cm straight above the place",
    "back15": "15 cm back from the place along the approach",
}
FURTHEST_M = 0.5  # distances to obstacle points end here: further away, or without an obstacle, it makes no difference

_POSES = {
    "grasp": "TCP at the grasp, base frame",
    "target": "object at the target, base frame",
    "relative": "initial object in the TCP frame of the grasp",
    "composed": "TCP at the place, T_base_target inv(T_base_object) T_base_grasp, base frame",
}


def _pose(name: str, meaning: str) -> tuple[Feature, ...]:
    position = [Feature(f"{name}_{axis}_m", "m", f"{meaning}: {axis}") for axis in "xyz"]
    axes = [Feature(f"{name}_{of}{axis}", "", f"{meaning}: {axis} of its {of} axis") for of in "yz" for axis in "xyz"]
    return (*position, *axes)


def _arm(phase: str) -> tuple[Feature, ...]:
    where = PHASES[phase]
    directions = (("out", "away from the base axis"), ("left", "to the left of that"), ("up", "upwards"))
    return (
        Feature(f"{phase}_azimuth_rad", "rad", f"direction of the TCP about the base axis {where}"),
        Feature(f"{phase}_tcp_radius_m", "m", f"distance of the TCP from the base axis {where}"),
        Feature(f"{phase}_wrist_radius_m", "m", f"distance of the wrist (on the axis of joint 7) from the base axis {where}"),
        Feature(f"{phase}_wrist_height_m", "m", f"height of the wrist over the table {where}"),
        *(Feature(f"{phase}_approach_{name}", "", f"approach {where}, part {meaning}") for name, meaning in directions),
        *(Feature(f"{phase}_jaw_{name}", "", f"jaw axis {where}, part {meaning}") for name, meaning in directions),
    )


def _reach(phase: str) -> tuple[Feature, ...]:
    what = f"distance of the shoulder from the axis of joint 6 {PHASES[phase]}, over all angles of joint 7"
    return (Feature(f"{phase}_reach_near_m", "m", f"smallest {what}"), Feature(f"{phase}_reach_far_m", "m", f"largest {what}"))


def _table(phase: str) -> tuple[Feature, ...]:
    parts = (("hand", "body of the hand"), ("fingers", "fingers"))
    return tuple(
        Feature(f"{phase}_{name}_low_m", "m", f"lowest point of the {part} over the table {PHASES[phase]}") for name, part in parts
    )


def _obstacles(phase: str) -> tuple[Feature, ...]:
    end = f"{PHASES[phase]}, at most {FURTHEST_M} m, which is also the value without obstacles"
    return (
        Feature(f"{phase}_hand_obstacle_m", "m", f"signed distance of the hand's body to obstacle points {end}"),
        Feature(f"{phase}_fingers_obstacle_m", "m", f"signed distance of the fingers to obstacle points {end}"),
        Feature(f"{phase}_wrist_obstacle_m", "m", f"distance of the wrist to obstacle points {end}"),
        Feature(f"{phase}_arm_obstacle_m", "m", f"distance of the line from shoulder to wrist to obstacle points {end}"),
    )


_OBJECT_IN_HAND = (
    *(
        Feature(f"inhand_{axis}_{bound}_m", "m", f"{meaning} of the object's points along {axis} of the TCP frame")
        for axis in "xyz"
        for bound, meaning in (("low", "lowest"), ("high", "highest"), ("mean", "mean"))
    ),
    Feature("held_width_m", "m", "twice the largest distance from the middle of the jaw of the object's points between the open pads"),
    Feature("held_share", "", "share of the object's points between the open pads"),
    Feature("hand_object_m", "m", "signed distance of the hand's body to the object's points"),
    Feature("fingers_object_m", "m", "signed distance of the open fingers to the object's points"),
)
# In the frame of the object itself an object looks the same in every scene, and a grasp of its pool is at the same place.
_OBJECT_ITSELF = (
    *(
        Feature(f"object_{axis}_{bound}_m", "m", f"{meaning} of the object's points along {axis} of the object frame")
        for axis in "xyz"
        for bound, meaning in (("low", "lowest"), ("high", "highest"))
    ),
    *(Feature(f"object_grasp_{axis}_m", "m", f"TCP at the grasp, object frame: {axis}") for axis in "xyz"),
)
_OBJECT_AT_TARGET = (
    *(
        Feature(f"{when}_{name}", "m", f"{meaning} of the object's points {where}")
        for when, where in (("initial", "in the initial scene"), ("moved", "moved to the target"))
        for name, meaning in (
            ("height_m", "highest"),
            ("mean_height_m", "mean height"),
            ("spread_m", "largest horizontal distance from their mean"),
        )
    ),
    Feature("turn_rad", "rad", "turn of the object from its initial pose to the target"),
    Feature("tilt_rad", "rad", "angle between the object's upward direction before and after"),
    Feature("carry_m", "m", "horizontal distance of target and initial object"),
    Feature("target_obstacle_m", "m", f"distance of the object's points at the target to obstacle points, at most {FURTHEST_M} m"),
    *(
        feature
        for phase in ("pick", "place")
        for feature in (
            Feature(f"{phase}_lever_jaw_m", "m", f"lever of the object's weight about the jaw axis {PHASES[phase]} (points for mass)"),
            Feature(f"{phase}_lever_m", "m", f"horizontal distance of TCP and the mean of the object's points {PHASES[phase]}"),
            Feature(f"{phase}_above_m", "m", f"height of the TCP over the mean of the object's points {PHASES[phase]}"),
        )
    ),
)

RAW_POSE_FEATURES: tuple[Feature, ...] = tuple(feature for name in ("grasp", "target", "relative") for feature in _pose(name, _POSES[name]))
POSE_FEATURES: tuple[Feature, ...] = (
    *RAW_POSE_FEATURES,
    *_pose("composed", _POSES["composed"]),
    *(feature for phase in ("pick", "place") for feature in _arm(phase)),
    *(feature for phase in ("pick", "place", "above15", "back15") for feature in _reach(phase)),
    Feature("swing_rad", "rad", "turn of the TCP about the base axis from the grasp to the place"),
)
FEATURES: tuple[Feature, ...] = (
    *POSE_FEATURES,
    *_OBJECT_IN_HAND,
    *_OBJECT_ITSELF,
    *_OBJECT_AT_TARGET,
    *(feature for phase in ("pick", "place", "back15") for feature in _table(phase)),
    *(feature for phase in PHASES for feature in _obstacles(phase)),
)

# What changes when a scene is turned as a whole about the base axis, which makes no difference to the arm but for the ends of joint 1.
TURNING = frozenset(
    {f"{name}_{part}" for name in ("grasp", "target", "composed") for part in ("x_m", "y_m", "yx", "yy", "zx", "zy")}
    | {f"{phase}_azimuth_rad" for phase in ("pick", "place")}
)

CANDIDATE_GEOMETRY = TableSchema(
    "candidate_geometry",
    "geometry of every candidate that follows from the five inputs and the published dimensions of the hand",
    ("candidate_id",),
    (
        plain("candidate_id", "<scene_id>-t<target_id>-g<grasp_id>"),
        *(real(feature.name, feature.meaning, feature.unit) for feature in FEATURES),
    ),
)
