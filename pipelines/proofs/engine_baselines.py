"""What a physics step and a collision check cost at the very least, measured when asked: the floors that stage costs are read against."""

from __future__ import annotations

import time

import numpy as np

from objects.object_model import ObjectModel
from pipelines.engines.physics.hand_params import HandWorldParams
from pipelines.engines.physics.hand_world import HandWorld
from pipelines.engines.planning.collision import CollisionModel
from pipelines.engines.robot.arm import HOME_Q_RAD, Q_LOWER_RAD, Q_UPPER_RAD
from pipelines.values import Scene
from tables.identity import rng_for

N_TICKS = 2000
N_CHECKS = 5000


def bare_tick_us(object_model: ObjectModel, scene: Scene, physics: HandWorldParams) -> float:
    """CPU microseconds of a tick in which the open hand holds still above the table and the object lies on it."""
    with HandWorld(object_model, scene.obstacles, physics) as world:
        world.start_open("floor", HOME_Q_RAD, 0.04, scene.T_base_object)
        start = time.process_time_ns()
        for _ in range(N_TICKS):
            world.step()
        return (time.process_time_ns() - start) / N_TICKS / 1e3


def collision_check_us(object_model: ObjectModel, scene: Scene) -> float:
    """CPU microseconds of one check of arm, hand and held object, over random configurations."""
    model = CollisionModel(scene, object_model)
    model.attach(np.linalg.inv(object_model.grasps[0].T_object_grasp), np.full(2, object_model.grasps[0].jaw_width_m / 2))
    # A cost, not a label: the recipe has no say in which configurations it is measured on.
    configurations = rng_for(0, "engine_baselines", scene.scene_id).uniform(Q_LOWER_RAD, Q_UPPER_RAD, (N_CHECKS, 7))
    start = time.process_time_ns()
    for q in configurations:
        model.in_collision_holding(q)
    return (time.process_time_ns() - start) / N_CHECKS / 1e3
