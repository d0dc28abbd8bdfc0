"""What the endpoint baselines know of a candidate before anything is planned or lifted: reach and hand clearance at the place pose."""

from __future__ import annotations

import time
from collections.abc import Sequence

from objects.gripper import open_jaw_m
from objects.object_model import ObjectModel
from pipelines.codecs import Row
from pipelines.engines.planning.bodies import Surroundings, hand_body
from pipelines.engines.robot.arm import ik
from pipelines.values import Scene
from tables.identity import candidate_id_of


def policy_feature_rows(
    object_model: ObjectModel, scene: Scene, grasp_ids: Sequence[int], target_ids: Sequence[int], n_q7: int
) -> tuple[list[Row], list[Row]]:
    """Rows of `policy_features`, and of `timings` for both tests of every candidate.

    The place pose of the TCP is the target pose with the pool grasp: the pose measured in the hand is not known before lifting.

    Args:
        grasp_ids: grasps of the object's pool.
        n_q7: inverse-kinematics grid, as in planning, so that the baseline errs by ignoring collisions alone.

    Returns:
        `ik_feasible`: some configuration within limits reaches the place pose, collisions ignored. `gripper_free`: the hand with its
        fingers open for release touches neither table nor obstacles there. Timings are of the stages `policy_ik` and `policy_gripper`.
    """
    pool = {grasp.grasp_id: grasp for grasp in object_model.grasps}
    targets = {target.target_id: target for target in scene.targets}
    surroundings = Surroundings(scene)
    # Built once an object and process, so no part of a candidate's time.
    hands = {grasp_id: hand_body(open_jaw_m(pool[grasp_id].jaw_width_m)) for grasp_id in grasp_ids}
    features, timings = [], []
    for target_id in target_ids:
        for grasp_id in grasp_ids:
            candidate_id = candidate_id_of(scene.scene_id, target_id, grasp_id)
            T_base_place = targets[target_id].T_base_target @ pool[grasp_id].T_object_grasp
            start_ns = time.thread_time_ns()
            is_reached = len(ik(T_base_place, n_q7)) > 0
            reached_ns = time.thread_time_ns()
            is_free = not surroundings.in_collision(hands[grasp_id], T_base_place)
            free_ns = time.thread_time_ns()
            features.append({"candidate_id": candidate_id, "ik_feasible": is_reached, "gripper_free": is_free})
            timings.append({"stage": "policy_ik", "item_id": candidate_id, "core_ms": (reached_ns - start_ns) / 1e6})
            timings.append({"stage": "policy_gripper", "item_id": candidate_id, "core_ms": (free_ns - reached_ns) / 1e6})
    return features, timings
