"""What happened in one execution, moment by moment, for pictures and traces; what happens in it is decided in labels.execution."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from objects.object_model import ObjectModel
from pipelines.codecs import Row
from pipelines.engines.physics.hand_world import HandWorld
from pipelines.engines.physics.phases import Phase
from pipelines.engines.robot.arm import fk
from pipelines.labels.execution import ExecutionSetup, execute_candidate
from pipelines.values import Candidate, Motion


@dataclass(frozen=True, slots=True)
class Moment:
    """The world at one time; the arm stays where it was once the hand was taken out of the world.

    Attributes:
        time_s: simulated, from zero.
        fingers_m: opening of each finger.
        robot_object_n: net contact force of the hand on the object, in newton.
        object_fixed_n: net contact forces of table and obstacles on the object, summed, in newton.
    """

    phase: Phase
    time_s: float
    q_rad: Float[np.ndarray, "7"]
    fingers_m: Float[np.ndarray, "2"]
    T_base_object: Float[np.ndarray, "4 4"]
    robot_object_n: float
    object_fixed_n: float


@dataclass(frozen=True, slots=True)
class Recording:
    """What is shown of one candidate: how its execution went, or the state after the lift where it was never planned.

    Attributes:
        labels: its row of `planning_labels` and, where it was planned, of `execution_labels`, in one.
        moments: of the execution, from time zero, about 30 a second; the one state after the lift where there is no execution.
        T_base_place: TCP pose where the hand lets go, or was asked to.
    """

    object_model: ObjectModel
    candidate: Candidate
    labels: Row
    moments: tuple[Moment, ...]
    T_base_place: Float[np.ndarray, "4 4"]

    @property
    def is_executed(self) -> bool:
        """Whether there is a motion to see."""
        return self.labels.get("exec_status") is not None

    @property
    def verdict(self) -> str:
        """What became of the candidate, in one sentence."""
        name = self.candidate.candidate_id
        if not self.is_executed:
            return f"{name}: not planned, {self.labels['plan_status']}; nothing was executed"
        return f"{name}: {self.labels['exec_status']}"


def record_execution(
    object_model: ObjectModel, candidate: Candidate, motion: Motion, setup: ExecutionSetup, planning_row: Row | None = None
) -> Recording:
    """Run a candidate as its label was made and remember every moment that is looked at; looking changes nothing.

    Args:
        planning_row: its row of `planning_labels`, where the recording is to hold it.
    """
    with HandWorld(object_model, candidate.scene.obstacles, setup.physics) as world:
        watcher = _Watcher(world, [_lifted(candidate)])
        row = execute_candidate(world, candidate, motion, setup, watcher.watch)
    labels = {**(planning_row or {}), **row}
    return Recording(object_model, candidate, labels, tuple(watcher.moments), fk(motion.descend_q_rad[-1]))


def record_rejection(object_model: ObjectModel, candidate: Candidate, release_height_m: float, planning_row: Row) -> Recording:
    """A candidate without a plan: arm and object as they were after the lift, from where planning started.

    Args:
        release_height_m: how far above the target the hand was asked to let go.
    """
    return Recording(object_model, candidate, dict(planning_row), (_lifted(candidate),), candidate.place_pose(release_height_m))


def _lifted(candidate: Candidate) -> Moment:
    """Time zero: the state after the lift, before the engine has found a contact."""
    grasp = candidate.grasp
    T_base_object = fk(grasp.lifted_q_rad) @ grasp.T_tcp_object
    return Moment(Phase.HOLD, 0.0, grasp.lifted_q_rad, grasp.fingers_m, T_base_object, 0.0, 0.0)


@dataclass(slots=True)
class _Watcher:
    world: HandWorld
    moments: list[Moment]

    def watch(self, phase: Phase) -> bool:
        world, has_hand = self.world, self.world.has_robot
        arm = world.arm_state() if has_hand else (self.moments[-1].q_rad, self.moments[-1].fingers_m)
        pressed_n = world.force_n("robot", "object") if has_hand else 0.0
        resting_n = sum(world.force_n("object", name) for name in world.fixed_bodies)
        self.moments.append(Moment(phase, world.n_steps * world.params.dt_s, *arm, world.object_pose(), pressed_n, resting_n))
        return False
