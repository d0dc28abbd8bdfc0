"""What the endpoint baselines know of a candidate before anything is planned or lifted: reach and hand clearance at the place pose."""

from __future__ import annotations

import time
from collections.abc import Sequence

from objects.gripper import open_jaw_m
from objects.object_model import ObjectModel
from pipelines import laws
from pipelines.codecs import Row
from pipelines.engines.planning.bodies import Surroundings, hand_body
from pipelines.engines.robot.arm import ik
from pipelines.labels.planning import PlanningParams
from pipelines.stage import Stage, Unit, UnitResult
from pipelines.values import Candidate
from tables.schemas import CANDIDATE_PAIRS, OBSTACLES, PICK_LIFT, POLICY_FEATURES, SCENES, TARGETS


def policy_feature_rows(object_model: ObjectModel, candidates: Sequence[Candidate], n_q7: int) -> tuple[list[Row], list[Row]]:
    """Rows of `policy_features`, and of `timings` for both tests of every candidate.

    The place pose of the TCP is the target pose with the pool grasp: the pose measured in the hand is not known before lifting.

    Args:
        candidates: of one scene.
        n_q7: inverse-kinematics grid, as in planning, so that the baseline errs by ignoring collisions alone.

    Returns:
        `ik_feasible`: some configuration within limits reaches the place pose, collisions ignored. `gripper_free`: the hand with its
        fingers open for release touches neither table nor obstacles there. Timings are of the stages `policy_ik` and `policy_gripper`.
    """
    if not candidates:
        return [], []
    surroundings = Surroundings(candidates[0].scene)
    pool = {grasp_id: object_model.grasp(grasp_id) for grasp_id in {candidate.grasp.grasp_id for candidate in candidates}}
    # Built once an object and process, so no part of the time of a candidate.
    hands = {grasp_id: hand_body(open_jaw_m(grasp.jaw_width_m)) for grasp_id, grasp in pool.items()}
    features, timings = [], []
    for candidate in candidates:
        grasp_id, candidate_id = candidate.grasp.grasp_id, candidate.candidate_id
        T_base_place = candidate.target.T_base_target @ pool[grasp_id].T_object_grasp
        start_ns = time.thread_time_ns()
        is_reached = len(ik(T_base_place, n_q7)) > 0
        reached_ns = time.thread_time_ns()
        is_free = not surroundings.in_collision(hands[grasp_id], T_base_place)
        free_ns = time.thread_time_ns()
        features.append({"candidate_id": candidate_id, "ik_feasible": is_reached, "gripper_free": is_free})
        timings.append({"stage": "policy_ik", "item_id": candidate_id, "core_ms": (reached_ns - start_ns) / 1e6})
        timings.append({"stage": "policy_gripper", "item_id": candidate_id, "core_ms": (free_ns - reached_ns) / 1e6})
    return features, timings


def run(unit: Unit) -> UnitResult:
    """The candidates of one scene."""
    rows, timings = policy_feature_rows(unit.object_model, unit.known.candidates, unit.params(PlanningParams).n_q7)
    return UnitResult({"policy_features": rows}, timings)


STAGE = Stage(
    name="policy_features",
    group="candidates",
    description="Computes what the endpoint baselines know: IK without collisions, the gripper alone at the place pose.",
    code_version="2",
    inputs=(SCENES, OBSTACLES, TARGETS, PICK_LIFT, CANDIDATE_PAIRS),
    objects=("grasp_pool",),
    outputs=(POLICY_FEATURES,),
    sections=(PlanningParams,),
    engines=("coal", "frankik", "numpy"),
    run=run,
    law=laws.policy_features_law,
)
