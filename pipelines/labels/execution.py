"""Does a planned placement survive physics? Carry, descend, release, retreat, settle and judge; plans come from planning.py."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from objects.gripper import open_jaw_m
from objects.object_model import ObjectModel
from pipelines import laws
from pipelines.codecs import Row, pose_row
from pipelines.engines.bounds import BoundsError, bounded, check_bounds
from pipelines.engines.physics.coming_to_rest import RestWatch, settle
from pipelines.engines.physics.hand_model import HAND_PARTS
from pipelines.engines.physics.hand_params import HandWorldParams
from pipelines.engines.physics.hand_rollout import hold, move, open_fingers
from pipelines.engines.physics.hand_world import HandWorld
from pipelines.engines.physics.phases import Phase, Watch, pose_difference
from pipelines.engines.planning.trajectory import MotionParams, time_path
from pipelines.labels.planning import PlanningParams, motion_of
from pipelines.stage import Stage, Unit, UnitResult, timing_row
from pipelines.values import Candidate, LiftedGrasp, Motion
from tables.schemas import CANDIDATE_PAIRS, EXECUTION_LABELS, OBSTACLES, PICK_LIFT, PLANNING_LABELS, PLANS, SCENES, TARGETS
from tables.vocabulary import ExecStatus, Perturbation, Symmetry


@dataclass(frozen=True, slots=True)
class ExecutionParams:
    """How a placement is executed and what counts as a valid end."""

    hold_s: float = bounded(0.05, 0.001, 10.0)  # contacts find their forces before the arm moves: five relaxation times of the pads
    max_open_s: float = bounded(0.5, 0.001, 10.0)  # 12 mm a finger take 0.24 s at 0.05 m/s
    # Between opening and retreat: the object drops the release height (10 mm take 45 ms) and comes to rest or does not.
    release_wait_s: float = bounded(0.1, 0.001, 10.0)
    # The retreat ends once the object rests and the hand is this far away: from here the hand only moves further, on a line that was
    # planned free of everything.
    clear_gap_m: float = bounded(0.02, 0.001, 0.5)
    max_settle_steps: int = bounded(480, 1, 100_000)  # 2 s: what still moves then is rolling away
    # How near to the target a valid placement ends, modulo the symmetry of the object.
    position_tolerance_m: float = bounded(0.0075, 1e-4, 0.5)
    rotation_tolerance_rad: float = bounded(0.08726646259971647, 0.001, math.pi)
    dropped_m: float = bounded(0.05, 0.001, 1.0)  # further from where the hand held it than a pad is long
    slipped_m: float = bounded(0.02, 1e-4, 0.5)  # the bounds of the pick-lift check
    slipped_rad: float = bounded(0.2617993877991494, 0.001, math.pi)
    collision_impulse_n_s: float = bounded(0.2, 0.001, 100.0)  # a 0.35 kg can stopped from 0.6 m/s; brushing past is less
    dragged_m: float = bounded(0.00375, 1e-5, 0.5)  # what the retreat may move the object by
    # 15 degrees of tilt: beyond tolerance, and no face of a box is that close to another.
    toppled_rad: float = bounded(0.2617993877991494, 0.001, math.pi)

    def __post_init__(self) -> None:
        check_bounds(self)
        for name, bound in (
            ("dragged_m", "position_tolerance_m"),
            ("slipped_m", "dropped_m"),
            ("rotation_tolerance_rad", "toppled_rad"),
        ):
            if getattr(self, name) > getattr(self, bound):
                raise BoundsError(f"{name} = {getattr(self, name)}, must be at most {bound} = {getattr(self, bound)}")


@dataclass(frozen=True, slots=True)
class ExecutionSetup:
    """How plans are executed: phases and verdicts, timing of the motions, physics."""

    execution: ExecutionParams
    motion: MotionParams
    physics: HandWorldParams


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
        Perturbation.FINE_STEP: {"steps_per_tick": 2 * setup.physics.steps_per_tick},
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
    grasp, params = candidate.grasp, setup.execution
    world.start_held(candidate.candidate_id, grasp.lifted_q_rad, grasp.fingers_m.tolist(), grasp.T_tcp_object)
    monitor = _Monitor(world, grasp.T_tcp_object, params, watch)
    _carry(world, motion, setup, monitor)
    is_held = not monitor.is_dropped
    is_let_go = is_held and not world.is_stopped
    T_release = world.object_pose()
    drag_m = _let_go(world, grasp, motion, setup, monitor) if is_let_go else None
    # From here on the hand touches nothing, or the object has left it: alone it settles at a third of the cost.
    world.remove_hand()
    is_settled = settle(world, params.max_settle_steps, monitor.film)
    T_final = world.object_pose()

    release = _error(world.object_model, T_release, candidate.target.T_base_target)
    final = _error(world.object_model, T_final, candidate.target.T_base_target)
    margin = 1.0 - max(final[0] / params.position_tolerance_m, final[1] / params.rotation_tolerance_rad)
    status = _status(world, params, monitor, _Ending(is_held, is_settled, margin, T_release, T_final, drag_m))
    return {
        "candidate_id": candidate.candidate_id,
        "y_pipe": status is ExecStatus.SUCCESS,
        "exec_status": status.value,
        "final_position_error_m": final[0],
        "final_rotation_error_rad": final[1],
        "tolerance_margin": margin,
        "transport_slip_m": monitor.slip_m,
        "transport_slip_rad": monitor.slip_rad,
        "release_position_error_m": release[0] if is_let_go else None,
        "release_rotation_error_rad": release[1] if is_let_go else None,
        "retreat_drag_m": drag_m,
        "n_physics_steps": world.n_steps,
        **pose_row("final", T_final),
    }


def _carry(world: HandWorld, motion: Motion, setup: ExecutionSetup, monitor: _Monitor) -> None:
    """Hold, transport and descend, as far as the object stays in the hand and the hand meets nothing that stops it."""
    transport = time_path(motion.transport_q_rad, setup.motion, world.params.dt_s, stop_at_waypoints=True)
    descend = time_path(motion.descend_q_rad, setup.motion, world.params.dt_s, stop_at_waypoints=False)
    is_carried = hold(world, Phase.HOLD, setup.execution.hold_s, monitor.carried) and move(
        world, Phase.TRANSPORT, transport, monitor.carried
    )
    monitor.end_transport()
    if is_carried:
        move(world, Phase.DESCEND, descend, monitor.carried)
    monitor.is_dropped = monitor.is_dropped or world.is_lost


def _let_go(world: HandWorld, grasp: LiftedGrasp, motion: Motion, setup: ExecutionSetup, monitor: _Monitor) -> float:
    """Open and retreat; returns how far the object moved during the retreat, in metres."""
    width_m = world.object_model.grasp(grasp.grasp_id).jaw_width_m
    open_fingers(world, open_jaw_m(width_m), setup.execution.max_open_s, monitor.film)
    hold(world, Phase.OPEN, setup.execution.release_wait_s, monitor.film)
    T_opened = world.object_pose()
    retreat = time_path(motion.retreat_q_rad, setup.motion, world.params.dt_s, stop_at_waypoints=False)
    monitor.rest = RestWatch(world)
    move(world, Phase.RETREAT, retreat, monitor.released)
    return pose_difference(T_opened, world.object_pose())[0]


@dataclass(slots=True)
class _Monitor:
    """What is measured on the way, every few ticks; collision impulses are summed by the world itself, every step."""

    world: HandWorld
    T_tcp_object: Float[np.ndarray, "4 4"]
    params: ExecutionParams
    watch: Watch | None
    slip_m: float = 0.0
    slip_rad: float = 0.0
    is_dropped: bool = False
    is_touched_in_retreat: bool = False
    table_impulse_n_s: float = 0.0
    rest: RestWatch | None = None

    def carried(self, phase: Phase) -> bool:
        """Slip while the object is held; True once it is dropped."""
        slip_m, slip_rad = pose_difference(self.T_tcp_object, self.world.inhand_pose())
        self.slip_m, self.slip_rad = max(self.slip_m, slip_m), max(self.slip_rad, slip_rad)
        self.is_dropped = self.is_dropped or slip_m > self.params.dropped_m
        self.film(phase)
        return self.is_dropped

    def end_transport(self) -> None:
        """The end of the descend sets the object down on the table: only what it met of the table up to here is a collision."""
        self.table_impulse_n_s = self.world.impulse_n_s("object", "table")

    def released(self, phase: Phase) -> bool:
        """Whether the hand still touches the object while it retreats; True once it cannot any more."""
        self.film(phase)
        self.is_touched_in_retreat = self.is_touched_in_retreat or any(self.world.touching(part) for part in HAND_PARTS)
        return self.rest is not None and self.rest.is_at_rest() and self.world.is_clear(self.params.clear_gap_m)

    def film(self, phase: Phase) -> bool:
        if self.watch is not None:
            self.watch(phase)
        return False

    def collision_impulse_n_s(self) -> float:
        """Of the hand with table and obstacles, of the object with obstacles, and with the table before it was set down."""
        hand = sum(self.world.impulse_n_s("robot", name) for name in self.world.fixed_bodies)
        return hand + self.table_impulse_n_s + sum(self.world.impulse_n_s("object", name) for name in self.world.fixed_bodies[1:])


@dataclass(frozen=True, slots=True)
class _Ending:
    """How an execution ended; `drag_m` is None where the hand never let go."""

    is_held: bool
    is_settled: bool
    margin: float
    T_release: Float[np.ndarray, "4 4"]
    T_final: Float[np.ndarray, "4 4"]
    drag_m: float | None


def _status(world: HandWorld, params: ExecutionParams, monitor: _Monitor, end: _Ending) -> ExecStatus:
    """A drop, a protective stop or a collision fails whatever the end; every other status says why the end is not valid."""
    is_collided = monitor.collision_impulse_n_s() > params.collision_impulse_n_s
    if end.is_held and not world.is_stopped and not is_collided and end.is_settled and end.margin >= 0.0:
        return ExecStatus.SUCCESS
    (x0, x1), (y0, y1) = world.params.table_x_m, world.params.table_y_m
    x, y, z = end.T_final[:3, 3]
    reasons = (
        (not end.is_held, ExecStatus.DROPPED),
        (world.is_stopped, ExecStatus.STOPPED),
        (monitor.slip_m > params.slipped_m or monitor.slip_rad > params.slipped_rad, ExecStatus.SLIPPED),
        (is_collided, ExecStatus.COLLIDED),
        (not (x0 < x < x1 and y0 < y < y1 and z > 0.0), ExecStatus.OFF_TABLE),
        (end.drag_m is not None and end.drag_m > params.dragged_m and monitor.is_touched_in_retreat, ExecStatus.DRAGGED),
        (_tilt_rad(world.object_model, end.T_release, end.T_final) > params.toppled_rad, ExecStatus.TOPPLED),
        (not end.is_settled, ExecStatus.NOT_SETTLED),
    )
    return next((status for applies, status in reasons if applies), ExecStatus.OFF_TARGET)


def _error(
    object_model: ObjectModel, T_base_object: Float[np.ndarray, "4 4"], T_base_target: Float[np.ndarray, "4 4"]
) -> tuple[float, float]:
    """Distance in metres and turn in radians, modulo the object's symmetry."""
    distance_m, _ = pose_difference(T_base_object, T_base_target)
    return distance_m, object_model.rotation_error_rad(T_base_object[:3, :3], T_base_target[:3, :3])


def _tilt_rad(object_model: ObjectModel, T_a: Float[np.ndarray, "4 4"], T_b: Float[np.ndarray, "4 4"]) -> float:
    """Change of the vertical as the object sees it; a can that rolls about its axis does not tilt."""
    up_a, up_b = T_a[2, :3], T_b[2, :3]
    if object_model.symmetry is Symmetry.REVOLUTION_Z:
        return abs(math.acos(float(np.clip(up_a[2], -1.0, 1.0))) - math.acos(float(np.clip(up_b[2], -1.0, 1.0))))
    return float(np.arctan2(np.linalg.norm(np.cross(up_a, up_b)), up_a @ up_b))


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
    code_version="3",
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
