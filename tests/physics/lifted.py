"""Scenes, lifted grasps and plans of the hand-built objects, made by the real stages; for the tests of what comes after."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from objects.kit import ObjectKit
from pipelines.grasp_admission import AdmissionParams, admission_rows
from pipelines.physics.world import PhysicsParams
from pipelines.pick_lift import PickLiftParams, pick_lift_rows
from pipelines.planning.trajectory import MotionParams
from pipelines.planning_labels import PlanningParams, planning_rows
from pipelines.scene import LiftedGrasp, Obstacle, Plan, Row, Scene, Target, admitted_grasps, lifted_grasps, plan_in
from pipelines.tabletop import standing
from tables.identity import parse_candidate_id
from tests.physics.kits import can_kit, cuboid_kit, mug_kit

PHYSICS, MOTION = PhysicsParams(), MotionParams()
KITS = {"can": can_kit, "cuboid": cuboid_kit, "mug": mug_kit}
_SPOTS = ((0.40, -0.25, 0.4), (0.55, -0.30, -1.0), (0.35, 0.30, 2.0), (0.62, 0.10, 0.9))


@dataclass(frozen=True)
class Lifted:
    """An object of which some grasps have been lifted and some placements planned."""

    kit: ObjectKit
    scene: Scene
    lift_rows: tuple[Row, ...]
    grasps: tuple[LiftedGrasp, ...]
    plans: dict[int, dict[int, Plan]]


def scene_of(kit: ObjectKit, obstacles: tuple[Obstacle, ...] = ()) -> Scene:
    """The object upright at (0.5, 0.05), upright targets around it."""
    rest = kit.stable_poses[0].T_plane_object
    targets = tuple(Target(k, 0, standing(np.array([x, y]), yaw) @ rest) for k, (x, y, yaw) in enumerate(_SPOTS))
    return Scene("full-0000", kit.object_id, 0, standing(np.array([0.5, 0.05]), 0.3) @ rest, obstacles, targets)


@lru_cache(maxsize=8)
def lifted(name: str, n_grasps: int = 2) -> Lifted:
    """Lift the first grasps that admission lets through and plan their placements."""
    kit = KITS[name]()
    scene = scene_of(kit)
    admitted = admitted_grasps(admission_rows(kit, scene, AdmissionParams(quota=n_grasps)))
    rows = pick_lift_rows(kit, scene, admitted, PickLiftParams(), MOTION, PHYSICS)
    grasps = lifted_grasps(rows)
    plans = {}
    for grasp in grasps:
        _, found = planning_rows(kit, scene, grasp, range(len(scene.targets)), PlanningParams(), MOTION, 42)
        plans[grasp.grasp_id] = {parse_candidate_id(row["candidate_id"]).target_id: plan_in(row) for row in found}
    return Lifted(kit, scene, tuple(rows), grasps, plans)
