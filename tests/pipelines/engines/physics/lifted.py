"""Scenes, lifted grasps and plans of the hand-built objects, made by the real stages; for the tests of what comes after."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from objects.object_model import ObjectModel
from pipelines.codecs import Row, admitted_grasps, lifted_grasps, plan_in
from pipelines.engines.physics.hand_params import HandWorldParams
from pipelines.engines.planning.trajectory import MotionParams
from pipelines.grasps.admission import AdmissionParams, admission_rows
from pipelines.grasps.pick_lift import PickLiftParams, PickLiftSetup, pick_lift_rows
from pipelines.labels.planning import PlanningParams, PlanningSetup, motion_of, planning_rows
from pipelines.scenes.tabletop import standing
from pipelines.values import Candidate, LiftedGrasp, Motion, Obstacle, Scene, Target
from tests.pipelines.engines.physics.object_models import can_model, cuboid_model, mug_model

PHYSICS, MOTION = HandWorldParams(), MotionParams()
LIFTING = PickLiftSetup(PickLiftParams(), AdmissionParams(), MOTION, PHYSICS)
OBJECT_MODELS = {"can": can_model, "cuboid": cuboid_model, "mug": mug_model}
_SPOTS = ((0.40, -0.25, 0.4), (0.55, -0.30, -1.0), (0.35, 0.30, 2.0), (0.62, 0.10, 0.9))


@dataclass(frozen=True)
class Lifted:
    """An object of which some grasps have been lifted and some placements planned."""

    object_model: ObjectModel
    scene: Scene
    lift_rows: tuple[Row, ...]
    grasps: tuple[LiftedGrasp, ...]
    planned: tuple[tuple[Candidate, Motion], ...]

    def of(self, grasp: LiftedGrasp) -> list[tuple[Candidate, Motion]]:
        """The planned candidates of a grasp, in target order."""
        return [(candidate, motion) for candidate, motion in self.planned if candidate.grasp.grasp_id == grasp.grasp_id]


def scene_of(object_model: ObjectModel, obstacles: tuple[Obstacle, ...] = ()) -> Scene:
    """The object upright at (0.5, 0.05), upright targets around it."""
    rest = object_model.stable_poses[0].T_plane_object
    targets = tuple(Target(k, 0, standing(np.array([x, y]), yaw) @ rest) for k, (x, y, yaw) in enumerate(_SPOTS))
    return Scene("full-0000", object_model.object_id, 0, standing(np.array([0.5, 0.05]), 0.3) @ rest, obstacles, targets)


@lru_cache(maxsize=8)
def lifted(name: str, n_grasps: int = 2) -> Lifted:
    """Lift the first grasps that admission lets through and plan their placements."""
    object_model = OBJECT_MODELS[name]()
    scene = scene_of(object_model)
    admitted = admitted_grasps(admission_rows(object_model, scene, AdmissionParams(quota=n_grasps)))
    rows = pick_lift_rows(object_model, scene, admitted, LIFTING)
    grasps = lifted_grasps(rows)
    candidates = [Candidate(scene, grasp, target) for grasp in grasps for target in scene.targets]
    setup = PlanningSetup(PlanningParams(), MOTION, 42)
    found = [(candidate, planning_rows(object_model, candidate, setup)[1]) for candidate in candidates]
    planned = tuple((candidate, motion_of(candidate, plan_in(row), setup.planning)) for candidate, row in found if row is not None)
    return Lifted(object_model, scene, tuple(rows), grasps, planned)
