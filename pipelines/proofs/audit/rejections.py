"""A rejected candidate judged again, slowly: is there a placement motion after all? See audits.py for which are.

Independent of the planner are every verdict on collision (Bullet instead of coal, the object and link6 as triangle meshes instead of
convex parts and hull) and the inverse kinematics from random starts. Only finer are the grid of joint 7, the line steps and the
edges; RRTConnect is the same. What a placement is stays the same too: release height, clearance, straight lines at constant joint 7.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from objects.gripper import open_jaw_m
from pipelines.engines.planning.bodies import CLEARANCE_M
from pipelines.engines.planning.collision import HELD_TOLERANCE_M
from pipelines.engines.planning.planner import CountedChecks, path_samples, search_path
from pipelines.engines.robot.arm import QD_MAX_RAD_S, follow_line, ik
from pipelines.labels.planning import PlanningParams
from pipelines.proofs.audit import numeric_ik
from pipelines.proofs.audit.bullet_scene import FINGERS, LINKS, BulletScene, Pair, hand
from pipelines.proofs.audit.params import AuditParams
from pipelines.proofs.audit.paths import arm_pairs, object_pairs, self_pairs, standing_pairs
from pipelines.values import Candidate
from tables.identity import ompl_seed_for, rng_for
from tables.vocabulary import PlanStatus

HAND = ("hand", *FINGERS)
# The closed form knows no line with the elbow straighter than this.
_CLOSED_FORM_Q4_RAD = -0.47
# The links that do not hold the object.
_LINKS_BY_OBJECT = LINKS[:6]


@dataclass(frozen=True, slots=True)
class Rejudgement:
    """Outcome of the slow judge; `solved` says that a whole motion was found."""

    status: PlanStatus
    n_configurations: int


def rejudge(world: BulletScene, candidate: Candidate, planning: PlanningParams, params: AuditParams, seed: int) -> Rejudgement:
    """Judge one candidate, tests in the order of PlanStatus; nothing about the stored verdict is known here.

    Args:
        world: the candidate's scene, `exact`.
        planning: what a placement is; of its resolutions only how fast the joints move along a line.
        seed: the recipe seed.
    """
    before = world.n_checked
    status = _SlowJudge(world, candidate, planning, params, seed).status()
    return Rejudgement(status, world.n_checked - before)


class _SlowJudge:
    """One candidate while it is being judged."""

    def __init__(self, world: BulletScene, candidate: Candidate, planning: PlanningParams, params: AuditParams, seed: int) -> None:
        self.world, self.planning, self.params = world, planning, params
        self.grasp, self.candidate_id, self.seed = candidate.grasp, candidate.candidate_id, seed
        self.T_base_object = candidate.release_pose(planning.release_height_m)
        self.T_place = candidate.place_pose(planning.release_height_m)
        self.T_preplace, self.T_retreat = self.T_place.copy(), self.T_place.copy()
        self.T_preplace[2, 3] += planning.preplace_m
        self.T_retreat[:3, 3] -= planning.retreat_m * self.T_place[:3, 2]
        self.furthest = PlanStatus.DESCEND_BLOCKED
        # As fast as the planner lets the joints move along a line, whatever the step.
        self.max_jump_rad = planning.max_joint_jump_rad * params.line_step_m / planning.line_step_m
        jaw_m = open_jaw_m(world.object_model.grasp(self.grasp.grasp_id).jaw_width_m)
        self.open_m = np.array([jaw_m / 2, jaw_m / 2])
        # Hand, fingers and object are where the TCP is, whatever the arm does: they are judged once a line, the arm once a goal.
        clear = arm_pairs(world, CLEARANCE_M)
        self.hand_clear = [pair for pair in clear if pair.a in HAND]
        self.links_clear = [*(pair for pair in clear if pair.a not in HAND), *self_pairs()]
        self.object_clear = object_pairs(world, CLEARANCE_M)
        self.links_carrying = [*self.links_clear, *(Pair(link, "object") for link in _LINKS_BY_OBJECT)]
        self.carrying = [*self.hand_clear, *self.object_clear, *self.links_carrying]
        standing = standing_pairs(HELD_TOLERANCE_M)
        self.hand_standing = [*self.hand_clear, *(pair for pair in standing if pair.a in HAND)]
        self.links_standing = [*self.links_clear, *(pair for pair in standing if pair.a not in HAND and pair.a not in LINKS[:2])]

    def status(self) -> PlanStatus:
        world, place = self.world, self.T_place[None]
        if not world.is_free({**hand(place, self.open_m), "object": self.T_base_object[None]}, [*self.hand_clear, *self.object_clear]):
            return PlanStatus.PLACE_COLLISION
        closed_form = ik(self.T_place, self.params.n_q7)
        numeric = numeric_ik.solutions(
            world, self.T_place, self.params.n_restarts, rng_for(self.seed, "audit_numeric_ik", self.candidate_id)
        )
        if not len(closed_form) and not numeric:
            return PlanStatus.NO_IK
        goals = [q for q in (*closed_form, *numeric) if self._is_free_carrying(q[None])]
        if not goals:
            return PlanStatus.IK_COLLISION
        goals.sort(key=lambda q: float((np.abs(q - self.grasp.lifted_q_rad) / QD_MAX_RAD_S).max()))
        if not self._hand_can_descend():
            return PlanStatus.DESCEND_BLOCKED
        starts: list[Float[np.ndarray, "7"]] = []
        for q_preplace in self._ends(goals):
            if not starts and not self._is_free_carrying(self.grasp.lifted_q_rad[None]):
                return PlanStatus.START_COLLISION
            if self._is_free_carrying(path_samples(np.stack([self.grasp.lifted_q_rad, q_preplace]), self.params.step_rad)):
                return PlanStatus.SOLVED
            starts.append(q_preplace)
        return self._search(np.array(starts)) if starts else self.furthest

    def _hand_can_descend(self) -> bool:
        line = self._tcp_line(self.T_preplace)
        placed = {**hand(line, self.grasp.fingers_m), "object": line @ self.grasp.T_tcp_object}
        return self.world.is_free(placed, [*self.hand_clear, *self.object_clear])

    def _hand_can_retreat(self) -> bool:
        placed = {**hand(self._tcp_line(self.T_retreat), self.open_m), "object": self.T_base_object[None]}
        return self.world.is_free(placed, self.hand_standing)

    def _ends(self, goals: list[Float[np.ndarray, "7"]]) -> Iterator[Float[np.ndarray, "7"]]:
        """Pre-place configurations of the goals whose lines are both free."""
        can_retreat = self._hand_can_retreat()
        for q in goals:
            up = self._line(self.T_preplace, q)
            back = self._line(self.T_retreat, q) if can_retreat and up is not None else None
            # Without a retreat the descend matters only for the reason that is given.
            if up is None or (back is None and self.furthest is PlanStatus.RETREAT_BLOCKED):
                continue
            lines = [(up, self._is_free_descend), (back, self._is_free_retreat)]
            # What stopped the goal before most likely stops this one too.
            if self.furthest is PlanStatus.RETREAT_BLOCKED:
                lines.reverse()
            for line, is_free in lines:
                if line is None or not is_free(line):
                    break
                if line is up:
                    self.furthest = PlanStatus.RETREAT_BLOCKED
            else:
                yield up[-1]

    def _line(self, T_end: Float[np.ndarray, "4 4"], q: Float[np.ndarray, "7"]) -> Float[np.ndarray, "m 7"] | None:
        if q[3] < _CLOSED_FORM_Q4_RAD:
            line = follow_line(self.T_place, T_end, q, self.params.line_step_m, self.max_jump_rad)
            if line is not None:
                return line
        # Where the closed form gives up, the line may run on through what it does not know.
        return numeric_ik.follow_line(self.world, self.T_place, T_end, q, self.params.line_step_m, self.max_jump_rad)

    def _tcp_line(self, T_end: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "m 4 4"]:
        way_m = T_end[:3, 3] - self.T_place[:3, 3]
        n = int(np.ceil(np.linalg.norm(way_m) / self.params.line_step_m - 1e-9)) + 1
        T = np.repeat(self.T_place[None], n, axis=0)
        T[:, :3, 3] += np.linspace(0.0, 1.0, n)[:, None] * way_m
        return T

    def _is_free_carrying(self, q: Float[np.ndarray, "n 7"]) -> bool:
        placed = self.world.arm(q, self.grasp.fingers_m)
        return self.world.is_free({**placed, "object": placed["tcp"] @ self.grasp.T_tcp_object}, self.carrying)

    def _is_free_descend(self, q: Float[np.ndarray, "n 7"]) -> bool:
        placed = self.world.arm(q, self.grasp.fingers_m)
        return self.world.is_free({**placed, "object": placed["tcp"] @ self.grasp.T_tcp_object}, self.links_carrying)

    def _is_free_retreat(self, q: Float[np.ndarray, "n 7"]) -> bool:
        return self.world.is_free({**self.world.arm(q, self.open_m), "object": self.T_base_object[None]}, self.links_standing)

    def _search(self, goals: Float[np.ndarray, "g 7"]) -> PlanStatus:
        checks = CountedChecks(lambda q: not self._is_free_carrying(q[None]))
        seed = ompl_seed_for(self.seed, "audit_search", self.candidate_id)
        path = search_path(self.grasp.lifted_q_rad, goals, checks, self.planning.search, seed)
        return PlanStatus.BUDGET_SPENT if path is None else PlanStatus.SOLVED
