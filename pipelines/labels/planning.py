"""Whether a lifted grasp can be carried to a target, put down and left, and by which motion; physics is in execution.py."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from objects.gripper import open_jaw_m
from objects.object_model import ObjectModel
from pipelines import laws
from pipelines.codecs import Row, plan_columns
from pipelines.engines.bounds import bounded, check_bounds
from pipelines.engines.planning.bodies import CLEARANCE_M, hand_body
from pipelines.engines.planning.clearance import path_clearance_m
from pipelines.engines.planning.collision import CollisionModel
from pipelines.engines.planning.planner import CountedChecks, SearchParams, path_samples, search_path
from pipelines.engines.planning.trajectory import MotionParams, path_duration_s
from pipelines.engines.robot.arm import QD_MAX_RAD_S, follow_line, ik
from pipelines.stage import Stage, Unit, UnitResult, timing_row
from pipelines.values import Candidate, LiftedGrasp, Motion, Plan, Scene
from tables.identity import ompl_seed_for
from tables.schemas import CANDIDATE_PAIRS, OBSTACLES, PICK_LIFT, PLANNING_LABELS, PLANS, SCENES, TARGETS
from tables.vocabulary import PlanStatus


@dataclass(frozen=True, slots=True)
class PlanningParams:
    """How a placement is planned, and how finely it is checked."""

    # Let go so far above the target. The held object needs its clearance above the table, and the arm tracks within 1 mm: lower, no
    # place pose would be free.
    release_height_m: float = bounded(0.003, 2 * CLEARANCE_M, 0.05)
    preplace_m: float = bounded(0.15, 0.01, 0.4)  # straight descend from above the place pose
    retreat_m: float = bounded(0.15, 0.01, 0.4)  # straight retreat along the approach
    # Lines of 0.15 m can be followed from a narrow range of joint 7 only: 32 miss 7 plans in 3,240 candidates that 256 find, 128 miss 1.
    n_q7: int = bounded(128, 1, 4096)
    # All: the nearest 16 lie so close that 4 in 1,000 labels were blocked for all of them but not for the next.
    max_goals: int = bounded(512, 1, 4096)
    line_step_m: float = bounded(0.0025, 1e-4, 0.0025)  # at 5 mm, 3-6 % of line verdicts flip
    # A line step: 0.35 rad flips no label, but such lines take up to 11 s instead of 1.1.
    max_joint_jump_rad: float = bounded(0.1, 0.01, 1.0)
    # Between clearance samples of the transport: 2-4 cm at the TCP, about 30 samples, a tenth of the cost.
    clearance_step_rad: float = bounded(0.05, 0.001, 0.5)
    search: SearchParams = field(default_factory=SearchParams)

    def __post_init__(self) -> None:
        check_bounds(self)


@dataclass(frozen=True, slots=True)
class Judgement:
    """Outcome of planning one candidate; the motion exists where the status is `solved`."""

    status: PlanStatus
    motion: Motion | None
    n_goals: int
    n_checks: int
    used_search: bool


@dataclass(frozen=True, slots=True)
class PlanningSetup:
    """How candidates are planned and their motions timed; `seed` is the recipe seed."""

    planning: PlanningParams
    motion: MotionParams
    seed: int


def planning_rows(
    object_model: ObjectModel, candidate: Candidate, setup: PlanningSetup, model: CollisionModel | None = None
) -> tuple[Row, Row | None]:
    """The candidate's row of `planning_labels` and, where it is solved, of `plans`.

    Args:
        model: the scene's collision model if it exists already; nothing of its history enters a row.
    """
    model = model or CollisionModel(candidate.scene, object_model)
    judgement = judge_candidate(object_model, candidate, setup.planning, setup.seed, model)
    label = {"candidate_id": candidate.candidate_id, **_label_columns(judgement, model, setup)}
    motion = judgement.motion
    return label, None if motion is None else {"candidate_id": candidate.candidate_id, **plan_columns(plan_of(motion))}


def plan_of(motion: Motion) -> Plan:
    """What has to be stored of a motion: the rest follows from the candidate."""
    return Plan(motion.descend_q_rad[-1], motion.transport_q_rad[1:-1])


def motion_of(candidate: Candidate, plan: Plan, params: PlanningParams) -> Motion:
    """The motion of a stored plan, bit for bit as it was planned: the lines are followed again from where the hand lets go.

    Raises:
        ValueError: the arm cannot follow a line that planning followed: the plan is not this candidate's, or other parameters made it.
    """
    T_base_place = candidate.place_pose(params.release_height_m)
    up, back = (_line(T_base_place, T_end, plan.place_q_rad, params) for T_end in _line_ends(T_base_place, params))
    if up is None or back is None:
        raise ValueError(f"{candidate.candidate_id}: the arm cannot follow the {'descend' if up is None else 'retreat'} of its stored plan")
    transport = np.concatenate([candidate.grasp.lifted_q_rad[None], plan.via_q_rad, up[-1:]])
    return Motion(transport, up[::-1], back)


def _line_ends(T_base_place: Float[np.ndarray, "4 4"], params: PlanningParams) -> tuple[Float[np.ndarray, "4 4"], Float[np.ndarray, "4 4"]]:
    """TCP poses at pre-place, straight above, and after the retreat, straight back along the approach."""
    T_preplace, T_retreat = T_base_place.copy(), T_base_place.copy()
    T_preplace[2, 3] += params.preplace_m
    T_retreat[:3, 3] -= params.retreat_m * T_base_place[:3, 2]
    return T_preplace, T_retreat


def _line(
    T_base_place: Float[np.ndarray, "4 4"], T_end: Float[np.ndarray, "4 4"], q: Float[np.ndarray, "7"], params: PlanningParams
) -> Float[np.ndarray, "m 7"] | None:
    return follow_line(T_base_place, T_end, q, params.line_step_m, params.max_joint_jump_rad)


def judge_candidate(object_model: ObjectModel, candidate: Candidate, params: PlanningParams, seed: int, model: CollisionModel) -> Judgement:
    """Plan one candidate: cheap tests in the order of PlanStatus, then straight joint motion, then search.

    Leaves the grasp's object attached to the model.
    """
    grasp = candidate.grasp
    jaw_m = open_jaw_m(object_model.grasp(grasp.grasp_id).jaw_width_m)
    T_base_object = candidate.release_pose(params.release_height_m)
    model.attach(grasp.T_tcp_object, grasp.fingers_m)
    model.place_object(T_base_object, jaw_m)
    placement = _Placement(candidate.place_pose(params.release_height_m), jaw_m, grasp, model, params)
    status, motion = placement.solve(T_base_object, ompl_seed_for(seed, "planning_labels", candidate.candidate_id))
    return Judgement(status, motion, placement.n_goals, placement.carrying.n_checks + placement.open.n_checks, placement.used_search)


class _Placement:
    """One candidate while it is being planned."""

    def __init__(
        self, T_base_place: Float[np.ndarray, "4 4"], jaw_m: float, grasp: LiftedGrasp, model: CollisionModel, params: PlanningParams
    ) -> None:
        self.T_base_place, self.jaw_m, self.grasp, self.model, self.params = T_base_place, jaw_m, grasp, model, params
        self.carrying, self.open = CountedChecks(model.in_collision_holding), CountedChecks(model.in_collision_open)
        self.n_goals = 0
        self.used_search = False
        self.furthest = PlanStatus.DESCEND_BLOCKED

    def solve(self, T_base_object: Float[np.ndarray, "4 4"], seed: int) -> tuple[PlanStatus, Motion | None]:
        surroundings, hand = self.model.surroundings, hand_body(self.jaw_m)
        if surroundings.in_collision(hand, self.T_base_place) or surroundings.in_collision(self.model.object, T_base_object):
            return PlanStatus.PLACE_COLLISION, None
        solutions = ik(self.T_base_place, self.params.n_q7)
        if not len(solutions):
            return PlanStatus.NO_IK, None
        goals = self._free_goals(solutions)
        if not goals:
            return PlanStatus.IK_COLLISION, None
        q_start = self.grasp.lifted_q_rad
        ends: list[tuple[Float[np.ndarray, "d 7"], Float[np.ndarray, "r 7"]]] = []
        for descend, retreat in self._ends(goals):
            if not ends and self.carrying.in_collision(q_start):
                return PlanStatus.START_COLLISION, None
            if self.carrying.is_free_edge(q_start, descend[0], self.params.search.edge_step_rad):
                return PlanStatus.SOLVED, Motion(np.stack([q_start, descend[0]]), descend, retreat)
            ends.append((descend, retreat))
        if not ends:
            return self.furthest, None
        self.used_search = True
        path = search_path(q_start, np.array([descend[0] for descend, _ in ends]), self.carrying, self.params.search, seed)
        if path is None:
            return PlanStatus.BUDGET_SPENT, None
        reached = int(np.argmin([np.abs(descend[0] - path[-1]).max() for descend, _ in ends]))
        return PlanStatus.SOLVED, Motion(path, *ends[reached])

    def _free_goals(self, solutions: Float[np.ndarray, "k 7"]) -> list[Float[np.ndarray, "7"]]:
        """The first free configurations at the place pose, soonest reached from the start first."""
        order = np.argsort((np.abs(solutions - self.grasp.lifted_q_rad) / QD_MAX_RAD_S).max(axis=1), kind="stable")
        goals = []
        for q in solutions[order]:
            if not self.carrying.in_collision(q):
                goals.append(q)
                if len(goals) == self.params.max_goals:
                    break
        self.n_goals = len(goals)
        return goals

    def _ends(self, goals: list[Float[np.ndarray, "7"]]) -> Iterator[tuple[Float[np.ndarray, "d 7"], Float[np.ndarray, "r 7"]]]:
        """Free descend and retreat lines of the goals that have both."""
        T_preplace, T_retreat = _line_ends(self.T_base_place, self.params)
        for q in goals:
            up = _line(self.T_base_place, T_preplace, q, self.params)
            if up is None or not self.carrying.is_free_path(up[1:]):
                continue
            self.furthest = PlanStatus.RETREAT_BLOCKED
            back = _line(self.T_base_place, T_retreat, q, self.params)
            if back is None or not self.open.is_free_path(back):
                continue
            yield up[::-1], back


def _label_columns(judgement: Judgement, model: CollisionModel, setup: PlanningSetup) -> Row:
    row: Row = {
        "y_plan": judgement.motion is not None,
        "plan_status": judgement.status.value,
        "min_clearance_m": None,
        "n_goals": judgement.n_goals,
        "n_checks": judgement.n_checks,
        "plan_duration_s": None,
        "path_length_rad": None,
        "n_waypoints": None,
        "used_search": judgement.used_search,
    }
    motion = judgement.motion
    if motion is not None:
        transport = motion.transport_q_rad
        row["min_clearance_m"] = path_clearance_m(model, path_samples(transport, setup.planning.clearance_step_rad))
        row["plan_duration_s"] = path_duration_s(transport, setup.motion, stop_at_waypoints=True) + sum(
            path_duration_s(line, setup.motion, stop_at_waypoints=False) for line in (motion.descend_q_rad, motion.retreat_q_rad)
        )
        row["path_length_rad"] = float(np.linalg.norm(np.diff(transport, axis=0), axis=1).sum())
        row["n_waypoints"] = len(transport)
    return row


@dataclass(frozen=True, slots=True)
class _ByIdentity:
    """Cache key of a scene's collision model: the values themselves hold arrays and cannot be hashed."""

    scene: Scene
    object_model: ObjectModel

    def _contents(self) -> tuple[bytes, ...]:
        scene = self.scene
        poses = [scene.T_base_object, *(o.T_base_obstacle for o in scene.obstacles), *(o.size_m for o in scene.obstacles)]
        return tuple(np.ascontiguousarray(part).tobytes() for part in (*poses, *(p.vertices_m for p in self.object_model.parts)))

    def __hash__(self) -> int:
        return hash((self.scene.scene_id, self._contents()))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _ByIdentity) and self.scene.scene_id == other.scene.scene_id and self._contents() == other._contents()


@lru_cache(maxsize=1)
def _collision_model(key: _ByIdentity) -> CollisionModel:
    """Units come scene by scene to a worker: building the model once a scene instead of once a grasp saves 11 ms a grasp."""
    return CollisionModel(key.scene, key.object_model)


def run(unit: Unit) -> UnitResult:
    """The candidates of one lifted grasp."""
    setup = PlanningSetup(unit.params(PlanningParams), unit.params(MotionParams), unit.seed)
    labels, plans, timings = [], [], []
    for candidate in unit.known.candidates:
        start = time.process_time_ns()
        model = _collision_model(_ByIdentity(candidate.scene, unit.object_model))
        label, plan = planning_rows(unit.object_model, candidate, setup, model)
        labels.append(label)
        plans += [] if plan is None else [plan]
        timings.append(timing_row("planning_labels", candidate.candidate_id, start))
    return UnitResult({"planning_labels": labels, "plans": plans}, timings)


STAGE = Stage(
    name="planning_labels",
    group="labels",
    description="Plans transport, descend and retreat for every candidate and says why where there is no plan.",
    code_version="1",
    inputs=(SCENES, OBSTACLES, TARGETS, PICK_LIFT, CANDIDATE_PAIRS),
    objects=("object_parts", "grasp_pool"),
    outputs=(PLANNING_LABELS, PLANS),
    sections=(PlanningParams, MotionParams),
    engines=("ompl", "pin", "coal", "frankik", "ruckig", "numpy", "scipy"),
    run=run,
    law=laws.planning_labels_law,
    split="lifted",
    time_share=0.16,
)
