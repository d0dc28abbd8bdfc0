"""Which pool grasps a scene allows, by geometry: hand, arm, straight approach and lift; see pick_lift.py for whether they hold."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from objects.gripper import open_jaw_m
from objects.object_model import ObjectModel, PoolGrasp
from pipelines import laws
from pipelines.codecs import Row, joints_row
from pipelines.engines.bounds import bounded, check_bounds
from pipelines.engines.planning.bodies import CLEARANCE_M, Body, bodies_meet, hand_body
from pipelines.engines.planning.collision import CollisionModel
from pipelines.engines.planning.planner import CountedChecks
from pipelines.engines.robot.arm import HOME_Q_RAD, QD_MAX_RAD_S, follow_line, ik
from pipelines.stage import Stage, Unit, UnitResult, timing_row
from pipelines.values import Scene
from tables.poses import inverse, matrix_of, pose_columns, pose_of
from tables.schemas import GRASP_ADMISSION, OBSTACLES, SCENES, TARGETS
from tables.vocabulary import AdmissionStatus


@dataclass(frozen=True, slots=True)
class AdmissionParams:
    """What a grasp must keep clear of, and how many a scene keeps."""

    quota: int = bounded(32, 1, 64)  # admitted grasps a scene, as many as the paper's fixed set an object
    pregrasp_m: float = bounded(0.10, 0.02, 0.3)  # straight approach: longer than a finger, so that the hand turns outside the object
    lift_m: float = bounded(0.12, 0.02, 0.4)  # vertical lift: clears the height of an obstacle
    palm_clearance_m: float = bounded(0.002, 0.0, 0.02)  # palm to object: a palm in contact drags the object on retreat
    finger_clearance_m: float = bounded(0.0005, 0.0, 0.01)  # open fingers to object: less is pushed by tracking error alone
    table_clearance_m: float = bounded(0.002, 0.0, 0.02)  # hand to table: the arm sags by up to 1 mm
    pad_reach_m: float = bounded(0.001, 0.0, 0.01)  # pads closed this much beyond the width of the grasp must be inside the object
    line_step_m: float = bounded(0.0025, 1e-4, 0.0025)  # at 5 mm, 3-6 % of line verdicts flip
    max_joint_jump_rad: float = bounded(0.1, 0.01, 1.0)  # a line step; more is a detour of the elbow that takes seconds
    n_q7: int = bounded(32, 1, 4096)  # lines here are 0.10 and 0.12 m; what 32 values miss is rejected as blocked, and no label
    max_tries: int = bounded(8, 1, 4096)  # collision-free configurations whose lines are tried

    def __post_init__(self) -> None:
        check_bounds(self)


@dataclass(frozen=True, slots=True)
class Reach:
    """How an arm configuration reaches a grasp, and how many configurations were tried."""

    status: AdmissionStatus
    n_ik: int | None = None
    pregrasp_q_rad: Float[np.ndarray, "7"] | None = None
    grasp_q_rad: Float[np.ndarray, "7"] | None = None


def admission_rows(object_model: ObjectModel, scene: Scene, params: AdmissionParams) -> list[Row]:
    """Rows of `grasp_admission`, one for every pool grasp, in grasp order.

    Every grasp is judged in full; the first `quota` that pass are admitted. The pool is in farthest-point order, so these are spread.
    """
    model = CollisionModel(scene, object_model)
    rows, n_admitted = [], 0
    grasps = sorted(object_model.grasps, key=lambda grasp: grasp.grasp_id)
    # The poses as their rows give them back, so that what was judged is what physics gets, to the bit.
    stored = pose_of(scene.T_base_object @ np.array([grasp.T_object_grasp for grasp in grasps]))
    for grasp, pose, T_base_grasp in zip(grasps, stored.tolist(), matrix_of(stored), strict=True):
        reach = judge_grasp(grasp, T_base_grasp, scene, model, params)
        if reach.status is AdmissionStatus.ADMITTED:
            if n_admitted == params.quota:
                reach = Reach(AdmissionStatus.NOT_NEEDED, reach.n_ik)
            else:
                n_admitted += 1
        rows.append(
            {
                "scene_id": scene.scene_id,
                "grasp_id": grasp.grasp_id,
                "admission_status": reach.status.value,
                **dict(zip(pose_columns("grasp"), pose, strict=True)),
                **joints_row("pregrasp_q", reach.pregrasp_q_rad),
                **joints_row("grasp_q", reach.grasp_q_rad),
                "n_ik": reach.n_ik,
            }
        )
    return rows


def judge_grasp(
    grasp: PoolGrasp, T_base_grasp: Float[np.ndarray, "4 4"], scene: Scene, model: CollisionModel, params: AdmissionParams
) -> Reach:
    """Verdict on one grasp at its pose in the scene, tests in the order of AdmissionStatus, cheap ones first."""
    own = _verdict_on_object(model.object, grasp.T_object_grasp.tobytes(), grasp.jaw_width_m, params)
    if own is AdmissionStatus.PALM_CONTACT:
        return Reach(own)
    jaw_m = open_jaw_m(grasp.jaw_width_m)
    if model.surroundings.in_collision(hand_body(jaw_m, params.pregrasp_m), T_base_grasp, params.table_clearance_m):
        return Reach(AdmissionStatus.SCENE_COLLISION)
    if own is not None:
        return Reach(own)
    solutions = ik(T_base_grasp, params.n_q7)
    if not len(solutions):
        return Reach(AdmissionStatus.NO_IK)
    model.place_object(scene.T_base_object, jaw_m)
    model.attach(inverse(grasp.T_object_grasp), np.array([grasp.jaw_width_m / 2, grasp.jaw_width_m / 2]))
    return _reach(T_base_grasp, solutions, model, params)


def _reach(
    T_base_grasp: Float[np.ndarray, "4 4"], solutions: Float[np.ndarray, "k 7"], model: CollisionModel, params: AdmissionParams
) -> Reach:
    """The first free configuration, nearest to the ready pose first, that can approach and lift in straight lines."""
    T_pregrasp, T_lifted = T_base_grasp.copy(), T_base_grasp.copy()
    T_pregrasp[:3, 3] -= params.pregrasp_m * T_base_grasp[:3, 2]
    T_lifted[2, 3] += params.lift_m
    furthest, n_tries = AdmissionStatus.ARM_COLLISION, 0
    for q in solutions[np.argsort((np.abs(solutions - HOME_Q_RAD) / QD_MAX_RAD_S).max(axis=1), kind="stable")]:
        if n_tries == params.max_tries:
            break
        if model.in_collision_open(q):
            continue
        n_tries += 1
        away = follow_line(T_base_grasp, T_pregrasp, q, params.line_step_m, params.max_joint_jump_rad)
        if away is None or not CountedChecks(model.in_collision_open).is_free_path(away[1:]):
            if furthest is AdmissionStatus.ARM_COLLISION:
                furthest = AdmissionStatus.APPROACH_BLOCKED
            continue
        up = follow_line(T_base_grasp, T_lifted, q, params.line_step_m, params.max_joint_jump_rad)
        if up is None or not CountedChecks(model.in_collision_holding).is_free_path(_off_the_table(up, params.lift_m)):
            furthest = AdmissionStatus.LIFT_BLOCKED
            continue
        return Reach(AdmissionStatus.ADMITTED, n_tries, away[-1], q)
    return Reach(furthest, n_tries)


def _off_the_table(up: Float[np.ndarray, "m 7"], lift_m: float) -> Float[np.ndarray, "n 7"]:
    """The rows of a lift by which the object, which starts on the table, must have its clearance above it."""
    return up[np.linspace(0.0, lift_m, len(up)) >= 2 * CLEARANCE_M]


@lru_cache(maxsize=4096)
def _verdict_on_object(body: Body, T_object_grasp: bytes, jaw_width_m: float, params: AdmissionParams) -> AdmissionStatus | None:
    """What the object alone says of a grasp, the same in every scene: None where it says nothing against it."""
    T = np.frombuffer(T_object_grasp).reshape(4, 4)
    palm, *fingers = hand_body(open_jaw_m(jaw_width_m), params.pregrasp_m).parts
    if bodies_meet(body.parts, (palm,), T, params.palm_clearance_m):
        return AdmissionStatus.PALM_CONTACT
    if bodies_meet(body.parts, tuple(fingers), T, params.finger_clearance_m):
        return AdmissionStatus.OBJECT_COLLISION
    closed = hand_body(max(0.0, jaw_width_m - 2 * params.pad_reach_m)).parts
    if not all(bodies_meet(body.parts, (pad,), T, 0.0) for pad in (closed[1], closed[3])):
        return AdmissionStatus.FINGERS_MISS
    return None


def run(unit: Unit) -> UnitResult:
    """Every pool grasp in one scene."""
    start = time.process_time_ns()
    rows = admission_rows(unit.object_model, unit.scene, unit.params(AdmissionParams))
    return UnitResult({"grasp_admission": rows}, [timing_row("grasp_admission", unit.item_id, start)])


STAGE = Stage(
    name="grasp_admission",
    group="grasps",
    description="Tests every pool grasp in every scene by geometry alone and keeps the reason for each rejection.",
    code_version="1",
    inputs=(SCENES, OBSTACLES, TARGETS),
    objects=("object_parts", "grasp_pool"),
    outputs=(GRASP_ADMISSION,),
    sections=(AdmissionParams,),
    engines=("pin", "coal", "frankik", "numpy"),
    run=run,
    law=laws.grasp_admission_law,
    time_share=0.02,
)
