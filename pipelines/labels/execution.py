"""Does a planned placement survive physics? Carry, descend, release, retreat and settle; plans are planning.py's, verdicts verdict.py's."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from objects.gripper import open_jaw_m
from objects.object_model import ObjectModel
from pipelines import laws
from pipelines.codecs import Row
from pipelines.engines.physics.coming_to_rest import settle
from pipelines.engines.physics.hand_params import HandWorldParams
from pipelines.engines.physics.hand_rollout import hold, move, open_fingers
from pipelines.engines.physics.hand_world import HandWorld
from pipelines.engines.physics.phases import Phase, Watch, pose_difference
from pipelines.engines.planning.trajectory import MotionParams, time_path
from pipelines.labels.planning import PlanningParams, motion_of
from pipelines.labels.verdict import Ending, ExecutionParams, Monitor, judge
from pipelines.stage import Stage, Unit, UnitResult, timing_row
from pipelines.values import Candidate, LiftedGrasp, Motion
from tables.schemas import CANDIDATE_PAIRS, EXECUTION_LABELS, OBSTACLES, PICK_LIFT, PLANNING_LABELS, PLANS, SCENES, TARGETS
from tables.vocabulary import Perturbation

__all__ = [
    "STAGE",
    "ExecutionParams",
    "ExecutionSetup",
    "Lateness",
    "execute_candidate",
    "execute_held",
    "execute_perturbed",
    "execution_rows",
    "perturbed_setup",
    "run",
]


@dataclass(frozen=True, slots=True)
class ExecutionSetup:
    """How plans are executed: phases and verdicts, timing of the motions, physics."""

    execution: ExecutionParams
    motion: MotionParams
    physics: HandWorldParams


@dataclass(frozen=True, slots=True)
class Lateness:
    """Ticks by which each motion of a placement starts late; negative is early."""

    transport: int = 0
    descend: int = 0
    retreat: int = 0


ON_TIME = Lateness()


def execution_rows(object_model: ObjectModel, planned: Sequence[tuple[Candidate, Motion]], setup: ExecutionSetup) -> Iterator[Row]:
    """Rows of `execution_labels` of one grasp, one a planned candidate, as they finish.

    They share compiled models, which take some milliseconds, and no state: every run starts from fresh data.

    Args:
        planned: candidates of one scene.

    Raises:
        PhysicsError: the engine warned or gave a state that is not finite; names the candidate.
    """
    if not planned:
        return
    with HandWorld(object_model, planned[0][0].scene.obstacles, setup.physics) as world:
        for candidate, motion in planned:
            yield execute_candidate(world, candidate, motion, setup)


def execute_perturbed(
    object_model: ObjectModel, candidate: Candidate, motion: Motion, perturbation: Perturbation, setup: ExecutionSetup
) -> Row:
    """The row of one candidate under a change that ought not to matter, or none."""
    setup = perturbed_setup(setup, perturbation)
    with HandWorld(object_model, candidate.scene.obstacles, setup.physics) as world:
        return execute_candidate(world, candidate, motion, setup)


def perturbed_setup(setup: ExecutionSetup, perturbation: Perturbation) -> ExecutionSetup:
    """A longer hold, half the step, other friction, another lever of the pads, or no change."""
    changes: dict[Perturbation, dict[str, float]] = {
        Perturbation.FINE_STEP: {
            "steps_per_tick": 2 * setup.physics.steps_per_tick,
            "landing_steps_per_tick": 2 * setup.physics.landing_steps_per_tick,
        },
        Perturbation.FRICTION_UP: {"friction_scale": 1.05},
        Perturbation.FRICTION_DOWN: {"friction_scale": 0.95},
        Perturbation.PAD_LEVER_UP: {"pad_lever_scale": 1.15},
        Perturbation.PAD_LEVER_DOWN: {"pad_lever_scale": 0.85},
    }
    physics = dataclasses.replace(setup.physics, **changes.get(perturbation, {}))  # type: ignore[arg-type]
    execution = dataclasses.replace(setup.execution, hold_s=0.10) if perturbation is Perturbation.HOLD else setup.execution
    return ExecutionSetup(execution, setup.motion, physics)


def execute_candidate(world: HandWorld, candidate: Candidate, motion: Motion, setup: ExecutionSetup, watch: Watch | None = None) -> Row:
    """The row of one candidate, run in `world` from the post-lift state.

    Args:
        watch: sees every phase every few ticks (a trace, a film); cannot change the outcome.
    """
    grasp = candidate.grasp
    world.start_held(candidate.candidate_id, grasp.lifted_q_rad, grasp.fingers_m.tolist(), grasp.T_tcp_object)
    return execute_held(world, candidate, motion, setup, Monitor(world, grasp.T_tcp_object, setup.execution, watch))


def execute_held(
    world: HandWorld, candidate: Candidate, motion: Motion, setup: ExecutionSetup, monitor: Monitor, late: Lateness = ON_TIME
) -> Row:
    """The row of one candidate whose object is in the hand of `world`, at the post-lift configuration, however it came to be there."""
    _carry(world, motion, setup, monitor, late)
    T_release, is_let_go = world.object_pose(), not monitor.is_dropped and not world.is_stopped
    drag_m = _let_go(world, candidate.grasp, motion, setup, monitor, late) if is_let_go else None
    # From here on the hand touches nothing, or the object has left it: alone it settles at a third of the cost.
    world.remove_hand()
    is_settled = settle(world, setup.execution.max_settle_steps, monitor.film)
    return judge(candidate, monitor, Ending(T_release, world.object_pose(), is_settled, drag_m))


def _carry(world: HandWorld, motion: Motion, setup: ExecutionSetup, monitor: Monitor, late: Lateness) -> None:
    """Hold, transport and descend, as far as the object stays in the hand and the hand meets nothing that stops it."""
    transport = time_path(motion.transport_q_rad, setup.motion, world.params.dt_s, stop_at_waypoints=True)
    descend = time_path(motion.descend_q_rad, setup.motion, world.params.dt_s, stop_at_waypoints=False)
    if late.descend < 0 and len(transport.q_rad) > 1 - late.descend:
        # The last samples of the transport are dropped: micrometres before its end the hand is nearly at rest.
        transport = dataclasses.replace(transport, q_rad=transport.q_rad[: late.descend], qd_rad_s=transport.qd_rad_s[: late.descend])
    hold_s = setup.execution.hold_s + late.transport * world.params.dt_s
    is_carried = hold(world, Phase.HOLD, hold_s, monitor.carried) and move(world, Phase.TRANSPORT, transport, monitor.carried)
    if late.descend > 0:
        is_carried = is_carried and hold(world, Phase.TRANSPORT, late.descend * world.params.dt_s, monitor.carried)
    monitor.end_transport()
    if is_carried:
        move(world, Phase.DESCEND, descend, monitor.carried)
    monitor.is_dropped = monitor.is_dropped or world.is_lost


def _let_go(world: HandWorld, grasp: LiftedGrasp, motion: Motion, setup: ExecutionSetup, monitor: Monitor, late: Lateness) -> float:
    """Open and retreat; returns how far the object moved during the retreat, in metres."""
    width_m = world.object_model.grasp(grasp.grasp_id).jaw_width_m
    world.begin_landing()
    open_fingers(world, open_jaw_m(width_m), setup.execution.max_open_s, monitor.film)
    hold(world, Phase.OPEN, setup.execution.release_wait_s + late.retreat * world.params.dt_s, monitor.film)
    T_opened = world.object_pose()
    retreat = time_path(motion.retreat_q_rad, setup.motion, world.params.dt_s, stop_at_waypoints=False)
    monitor.begin_retreat()
    move(world, Phase.RETREAT, retreat, monitor.released)
    return pose_difference(T_opened, world.object_pose())[0]


def run(unit: Unit) -> UnitResult:
    """The planned candidates of one lifted grasp."""
    setup = ExecutionSetup(unit.params(ExecutionParams), unit.params(MotionParams), unit.params(HandWorldParams))
    rows, timings, start = [], [], time.process_time_ns()
    planning, plans = unit.params(PlanningParams), unit.known.plans
    planned = [(c, motion_of(c, plans[c.candidate_id], planning)) for c in unit.known.candidates if c.candidate_id in plans]
    for row in execution_rows(unit.object_model, planned, setup):
        rows.append(row)
        timings.append(timing_row("execution_labels", row["candidate_id"], start))
        start = time.process_time_ns()
    if timings:  # the end of the engine
        timings[-1]["core_ms"] += (time.process_time_ns() - start) / 1e6
    return UnitResult({"execution_labels": rows}, timings)


STAGE = Stage(
    name="execution_labels",
    group="labels",
    description="Executes every plan in physics from the measured post-lift state and validates the final object pose.",
    code_version="6",
    inputs=(SCENES, OBSTACLES, TARGETS, PICK_LIFT, CANDIDATE_PAIRS, PLANNING_LABELS, PLANS),
    objects=("objects", "object_parts", "grasp_pool"),
    outputs=(EXECUTION_LABELS,),
    sections=(ExecutionParams, PlanningParams, MotionParams, HandWorldParams),
    engines=("mujoco-core", "frankik", "ruckig", "numpy", "scipy"),
    run=run,
    law=laws.execution_labels_law,
    split="lifted",
    time_share=0.65,
)
