"""How far a held object creeps in three seconds: pool grasps of an object, taken by a hand at rest that points down."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from objects.gripper import MAX_JAW_M
from objects.object_model import ObjectModel
from pipelines.engines.physics.hand_params import HandWorldParams
from pipelines.engines.physics.hand_rollout import hold, pressing_fingers
from pipelines.engines.physics.hand_world import HandWorld
from pipelines.engines.physics.phases import Phase, pose_difference
from pipelines.engines.robot.arm import HOME_Q_RAD
from tables.identity import rng_for
from tables.poses import inverse

TAKE_GAP_M, TAKE_S, SETTLE_S, HOLD_S = 0.002, 0.2, 0.25, 3.0
# A grasp that moves more while it takes its load does not hold, and has no creep to measure.
HELD_M, TAKEN_M = 0.001, 0.005


@dataclass(frozen=True, slots=True)
class Creep:
    """Motion in the hand of one grasp that holds, after it has taken its load."""

    object_id: str
    grasp_id: int
    creep_m: float
    creep_rad: float


def hold_creep(object_model: ObjectModel, n_grasps: int, params: HandWorldParams, seed: int) -> tuple[list[Creep], int]:
    """Creep of the first `n_grasps` grasps that hold, in a random order of the pool; and how many before them did not hold."""
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
            world.start_taking(label, HOME_Q_RAD, finger_m, T_tcp_object, TAKE_S)
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
