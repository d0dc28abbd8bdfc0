"""What scene sampling would find for an object before any scene is drawn: the grasps of each resting pose, at random spots of the table."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

from objects.object_model import ObjectModel
from pipelines.engines.physics.params import PhysicsParams
from pipelines.engines.physics.resting import rest_drift
from pipelines.engines.physics.world import PhysicsWorld
from pipelines.scenes.draws import SceneSamplingParams
from pipelines.scenes.reach import OpenHands
from pipelines.scenes.tabletop import spot_in_sector, standing
from tables.identity import rng_for

# Of each resting pose: what one spot in twenty allows is missed in every second look, and a scene draws a hundred.
N_SPOTS = 16


@dataclass(frozen=True, slots=True)
class RestOutlook:
    """One resting pose as scene sampling sees it.

    `above_table` counts the pool grasps, by kind, whose open hand clears the table. `within_reach` has a number for each spot: how many of
    them the arm reaches there. `start_spots` and `target_spots` count the spots where those are enough.
    """

    resting: str
    probability: float
    stays: bool
    above_table: Mapping[str, int]
    within_reach: tuple[int, ...]
    start_spots: int
    target_spots: int

    @property
    def may_start(self) -> bool:
        return self.stays and self.start_spots > 0

    @property
    def may_be_target(self) -> bool:
        return self.stays and self.target_spots > 0


def scene_outlook(object_model: ObjectModel, params: SceneSamplingParams, physics: PhysicsParams, seed: int) -> tuple[RestOutlook, ...]:
    """Each resting pose at N_SPOTS spots and turns, drawn as those of a scene are; without obstacles.

    Whether it stays at rest is tried at the first spot.
    """
    hands, outlooks = OpenHands(object_model, params.n_q7), []
    with PhysicsWorld(object_model, (), physics) as world:
        for rest in object_model.stable_poses:
            rng = rng_for(seed, "scene_outlook", object_model.object_id, rest.stable_pose_id)
            spots = [(spot_in_sector(rng, params.radius_m, params.angle_rad), rng.uniform(-math.pi, math.pi)) for _ in range(N_SPOTS)]
            poses = [standing(xy, yaw_rad) @ rest.T_plane_object for xy, yaw_rad in spots]
            is_above = hands.is_above_table(poses[0])
            within_reach = tuple(hands.n_allowed(T) for T in poses)
            T_rested, drift = rest_drift(world, f"{object_model.object_id} {rest.resting}", poses[0], params.rest_s)
            outlooks.append(
                RestOutlook(
                    rest.resting,
                    rest.probability,
                    T_rested is not None and drift[0] <= params.max_drift_m and drift[1] <= params.max_drift_rad,
                    Counter(grasp.grasp_kind for grasp, is_free in zip(object_model.grasps, is_above, strict=True) if is_free),
                    within_reach,
                    sum(n >= params.min_initial_grasps for n in within_reach),
                    sum(n >= params.min_target_grasps for n in within_reach),
                )
            )
    return tuple(outlooks)
