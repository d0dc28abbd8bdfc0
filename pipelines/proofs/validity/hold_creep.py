"""How far a held object creeps in three seconds: pool grasps of an object, taken by a hand at rest that points down or elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from objects.gripper import MAX_JAW_M
from objects.object_model import ObjectModel
from pipelines.codecs import Row
from pipelines.engines.physics.hand_params import HandWorldParams
from pipelines.engines.physics.hand_rollout import hold, pressing_fingers
from pipelines.engines.physics.hand_world import HandWorld
from pipelines.engines.physics.phases import Phase, pose_difference
from pipelines.engines.robot.arm import HOME_Q_RAD, ik
from pipelines.proofs.validity.study import Numbers, Study, StudyError, StudyUnit
from pipelines.proofs.validity.subject import TAKE_GAP_M, Subject
from tables.identity import rng_for
from tables.poses import inverse

# The load is taken within a second: heavy cans held askew turn by 12 to 18 degrees for half of it, until their axis hangs.
TAKE_S, SETTLE_S, HOLD_S = 0.2, 1.0, 3.0
# A grasp that moves more while it takes its load does not hold, and has no creep to measure.
HELD_M, TAKEN_M = 0.001, 0.005


class Direction(StrEnum):
    """Where a hand points, and where its jaw lies: gravity then pulls along the fingers, across them, along the jaw, or between."""

    DOWN = "down"
    LEVEL = "level, jaw level"
    LEVEL_JAW_UPRIGHT = "level, jaw upright"
    TILTED = "tilted by 45 degrees"


_C = 0.7071067811865476
_AXES = {  # z (approach) and y (jaw) of the hand in the base frame
    Direction.LEVEL: ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
    Direction.LEVEL_JAW_UPRIGHT: ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    Direction.TILTED: ((_C, 0.0, -_C), (0.0, 1.0, 0.0)),
}
_AT_M = (0.6, 0.0, 0.5)  # where the arm reaches all of them


@dataclass(frozen=True, slots=True)
class Creep:
    """Motion in the hand of one grasp that holds, after it has taken its load."""

    object_id: str
    grasp_id: int
    creep_m: float
    creep_rad: float


def creep_study(subject: Subject) -> Study:
    """The first grasps that hold of every object, in a hand that points down."""
    return _study("hold_creep", subject, (Direction.DOWN,), subject.sizes.n_grasps)


def creep_elsewhere_study(subject: Subject) -> Study:
    """Fewer of them in hands that point elsewhere."""
    directions = tuple(direction for direction in Direction if direction is not Direction.DOWN)
    return _study("hold_creep_elsewhere", subject, directions, subject.sizes.n_grasps_elsewhere)


def _study(name: str, subject: Subject, directions: tuple[Direction, ...], n: int) -> Study:
    physics, seed = subject.recipe.hand_physics, subject.recipe.seed
    units = tuple(
        StudyUnit(f"{model.object_id} {direction} {n}", (model, n, physics, seed, direction))
        for model in subject.object_models()
        for direction in directions
    )
    return Study(name, units, creep_row, creep_summary if directions == (Direction.DOWN,) else creep_elsewhere_summary, 170.0 * n)


def creep_row(object_model: ObjectModel, n_grasps: int, params: HandWorldParams, seed: int, direction: Direction) -> Row:
    """Creep of the grasps of one object that hold in one direction of the hand."""
    creeps, n_lost = hold_creep(object_model, n_grasps, params, seed, arm_pointing(direction))
    return {
        "object_id": object_model.object_id,
        "direction": direction.value,
        "n_wanted": n_grasps,
        "n_not_held": n_lost,
        "grasp_ids": [creep.grasp_id for creep in creeps],
        "creep_mm": [1e3 * creep.creep_m for creep in creeps],
        "creep_rad": [creep.creep_rad for creep in creeps],
    }


def creep_summary(rows: Sequence[Row]) -> Numbers:
    """Median and maximum over all grasps in a hand that points down, and how many were tried for them."""
    n_held, n_not_held = sum(len(row["creep_mm"]) for row in rows), sum(row["n_not_held"] for row in rows)
    return {
        **_over_all(rows, "hold_creep", "n_hold_creep"),
        "hold_not_held": float(n_not_held),
        "n_hold_tried": float(n_held + n_not_held),
        "hold_objects_short": float(sum(len(row["creep_mm"]) < row["n_wanted"] for row in rows)),
        "n_hold_objects": float(len(rows)),
    }


def creep_elsewhere_summary(rows: Sequence[Row]) -> Numbers:
    """The same of hands that point elsewhere."""
    return _over_all(rows, "hold_creep_any_direction", "n_hold_creep_any_direction")


def _over_all(rows: Sequence[Row], key: str, count_key: str) -> dict[str, float | None]:
    values = [value for row in rows for value in row["creep_mm"]]
    return {
        f"{key}_mm_median": float(np.median(values)) if values else None,
        f"{key}_mm_max": max(values, default=None),
        count_key: float(len(values)),
    }


@lru_cache(maxsize=len(Direction))
def _configuration(direction: Direction) -> tuple[float, ...]:
    if direction is Direction.DOWN:
        return tuple(HOME_Q_RAD.tolist())
    z, y = (np.array(axis) for axis in _AXES[direction])
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.column_stack([np.cross(y, z), y, z]), _AT_M
    found = ik(T, 32)
    if not len(found):
        raise StudyError(f"hold_creep: the arm reaches no hand {direction} at {_AT_M} m, must reach one")
    return tuple(found[0].tolist())


def arm_pointing(direction: Direction) -> Float[np.ndarray, "7"]:
    """An arm configuration whose hand points there."""
    return np.array(_configuration(direction))


def hold_creep(
    object_model: ObjectModel, n_grasps: int, params: HandWorldParams, seed: int, q_rad: Float[np.ndarray, "7"] = HOME_Q_RAD
) -> tuple[list[Creep], int]:
    """Creep of the first `n_grasps` grasps that hold, in a random order of the pool; and how many before them did not hold.

    Args:
        q_rad: of the arm; by default the hand points down.
    """
    rows: list[Creep] = []
    n_lost = 0
    order = rng_for(seed, "hold_creep", object_model.object_id).permutation(len(object_model.grasps))
    with HandWorld(object_model, (), params) as world:
        for k in order:
            if len(rows) == n_grasps:
                break
            grasp = object_model.grasps[k]
            T_tcp_object = inverse(grasp.T_object_grasp)
            finger_m = min(MAX_JAW_M / 2, grasp.jaw_width_m / 2 + TAKE_GAP_M)
            label = f"{object_model.object_id} grasp {grasp.grasp_id}"
            world.start_taking(label, q_rad, finger_m, T_tcp_object, TAKE_S)
            T_taken = world.inhand_pose()
            hold(world, Phase.HOLD, SETTLE_S)
            T_loaded = world.inhand_pose()
            moved_m = pose_difference(T_taken, T_loaded)[0]
            if moved_m > HELD_M or pose_difference(T_tcp_object, T_taken)[0] > TAKEN_M or pressing_fingers(world) < 2:
                n_lost += 1
                continue
            hold(world, Phase.HOLD, HOLD_S)
            creep_m, creep_rad = pose_difference(T_loaded, world.inhand_pose())
            rows.append(Creep(object_model.object_id, grasp.grasp_id, creep_m, creep_rad))
    return rows, n_lost


def summary(rows: list[Creep]) -> tuple[float, float]:
    """Median and maximum of the creep in metres."""
    values = np.array([row.creep_m for row in rows])
    return float(np.median(values)), float(values.max())
