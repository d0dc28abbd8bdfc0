"""Objects, motions and takes that the tests of the hand's world share."""

from __future__ import annotations

import numpy as np

from pipelines.engines.physics.hand_params import HandWorldParams
from pipelines.engines.physics.hand_world import HandWorld
from pipelines.engines.planning.trajectory import MotionParams, Trajectory, time_path
from pipelines.engines.robot.arm import HOME_Q_RAD
from tables.poses import inverse
from tests.pipelines.engines.physics.object_models import can_model, cuboid_model, mug_model

MODELS = [can_model(), cuboid_model(), mug_model()]
PARAMS = HandWorldParams()
FAST = MotionParams(velocity_scale=1.0, acceleration_scale=1.0, jerk_scale=0.3)
FAR_Q_RAD = HOME_Q_RAD + np.array([0.9, 0.3, 0.3, 0.4, 0.5, -0.4, 0.8])


def swing(dt_s: float = PARAMS.dt_s) -> Trajectory:
    """At the joints' limits there and back: every joint turns."""
    return time_path(np.stack([HOME_Q_RAD, FAR_Q_RAD, HOME_Q_RAD]), FAST, dt_s, stop_at_waypoints=True)


def take(world: HandWorld, grasp_id: int, label: str = "test") -> None:
    """Close on the object at one of its grasps."""
    grasp = world.object_model.grasps[grasp_id]
    world.start_taking(label, HOME_Q_RAD, grasp.jaw_width_m / 2 + 0.002, inverse(grasp.T_object_grasp), 0.2)
