"""The verdict on an execution: what is measured on the way, how it ended, and the row that says so; who executes is execution.py.

Any world that offers the measurements of `JudgedWorld` can be judged: the engine behind them is not asked for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float

from objects.object_model import ObjectModel
from pipelines.codecs import Row, pose_row
from pipelines.engines.bounds import BoundsError, bounded, check_bounds
from pipelines.engines.physics.coming_to_rest import RestParams, RestWatch, SteppedWorld
from pipelines.engines.physics.hand_bodies import HAND_PARTS
from pipelines.engines.physics.phases import Phase, Watch, pose_difference
from pipelines.values import Candidate
from tables.tolerances import Tolerances
from tables.vocabulary import ExecStatus, Symmetry


@dataclass(frozen=True, slots=True)
class ExecutionParams:
    """How a placement is executed and what counts as a valid end."""

    hold_s: float = bounded(0.05, 0.001, 10.0)  # contacts find their forces before the arm moves: five relaxation times of the pads
    max_open_s: float = bounded(0.5, 0.001, 10.0)  # 12 mm a finger take 0.24 s at 0.05 m/s
    # Between opening and retreat: the object drops the release height (3 mm take 25 ms) and comes to rest or does not.
    release_wait_s: float = bounded(0.1, 0.001, 10.0)
    # The retreat ends once the object rests and the hand is this far away: from here the hand only moves further, on a line that was
    # planned free of everything.
    clear_gap_m: float = bounded(0.02, 0.001, 0.5)
    max_settle_steps: int = bounded(480, 1, 100_000)  # 2 s: what still moves then is rolling away
    # How near to the target a valid placement ends, modulo the symmetry of the object.
    position_tolerance_m: float = bounded(0.0075, 1e-4, 0.5)
    rotation_tolerance_rad: float = bounded(0.08726646259971647, 0.001, math.pi)
    dropped_m: float = bounded(0.05, 0.001, 1.0)  # further from where the hand held it than a pad is long
    # Held means held: what loads below the pads' limit never do, half of what a placement may be off and the 5 degrees that it may be
    # turned by (HAND_WORLD.md, "What a slip is").
    slipped_m: float = bounded(0.00375, 1e-4, 0.5)
    slipped_rad: float = bounded(0.08726646259971647, 0.001, math.pi)
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

    @property
    def tolerances(self) -> Tolerances:
        """What a release states, and what laws hold its labels against."""
        return Tolerances(self.position_tolerance_m, self.rotation_tolerance_rad, self.slipped_m, self.slipped_rad)


class JudgedParams(RestParams, Protocol):
    """The numbers of an engine that say what rest is and where the table is."""

    @property
    def table_x_m(self) -> tuple[float, float]: ...
    @property
    def table_y_m(self) -> tuple[float, float]: ...


class JudgedWorld(SteppedWorld, Protocol):
    """What an engine must tell of a run; HandWorld says what each name means."""

    @property
    def object_model(self) -> ObjectModel: ...
    @property
    def params(self) -> JudgedParams: ...
    @property
    def n_steps(self) -> int: ...
    @property
    def is_stopped(self) -> bool: ...
    @property
    def fixed_bodies(self) -> tuple[str, ...]: ...
    def inhand_pose(self) -> Float[np.ndarray, "4 4"]: ...
    def impulse_n_s(self, body: str, other: str) -> float: ...
    def touching(self, part: str) -> bool: ...
    def is_clear(self, gap_m: float) -> bool: ...


@dataclass(slots=True)
class Monitor:
    """What is measured on the way, every few ticks; collision impulses are summed by the world itself, every step.

    Attributes:
        world: the run that is judged.
        T_tcp_object: how the hand held the object at the start.
        params: what counts as what.
        watch: sees every phase every few ticks; cannot change the outcome.
        slip_m, slip_rad: the most that the object was off `T_tcp_object` while it was held.
        is_dropped: it left the hand before the hand let it go.
        is_touched_in_retreat: the opened hand touched it.
        table_impulse_n_s: of the object with the table before it was set down.
        rest: tells whether the object rests, None before the retreat.
    """

    world: JudgedWorld
    T_tcp_object: Float[np.ndarray, "4 4"]
    params: ExecutionParams
    watch: Watch | None = None
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

    def begin_retreat(self) -> None:
        """The hand is open: from here on it may only leave."""
        self.rest = RestWatch(self.world)

    def released(self, phase: Phase) -> bool:
        """Whether the hand still touches the object while it retreats; True once it cannot any more."""
        self.film(phase)
        self.is_touched_in_retreat = self.is_touched_in_retreat or any(self.world.touching(part) for part in HAND_PARTS)
        return self.rest is not None and self.rest.is_at_rest() and self.world.is_clear(self.params.clear_gap_m)

    def film(self, phase: Phase) -> bool:
        """Show the phase to whoever watches; never ends it."""
        if self.watch is not None:
            self.watch(phase)
        return False

    def collision_impulse_n_s(self) -> float:
        """Of the hand with table and obstacles, of the object with obstacles, and with the table before it was set down."""
        hand = sum(self.world.impulse_n_s("robot", name) for name in self.world.fixed_bodies)
        return hand + self.table_impulse_n_s + sum(self.world.impulse_n_s("object", name) for name in self.world.fixed_bodies[1:])


@dataclass(frozen=True, slots=True)
class Ending:
    """How an execution ended.

    Attributes:
        T_release: T_base_object when the carry was over.
        T_final: T_base_object at the end.
        is_settled: the object rests there.
        drag_m: how far the object moved during the retreat; None where the hand never let go.
    """

    T_release: Float[np.ndarray, "4 4"]
    T_final: Float[np.ndarray, "4 4"]
    is_settled: bool
    drag_m: float | None


def judge(candidate: Candidate, monitor: Monitor, end: Ending) -> Row:
    """The row of `execution_labels` of one execution that is over."""
    world, params = monitor.world, monitor.params
    release = _error(world.object_model, end.T_release, candidate.target.T_base_target)
    final = _error(world.object_model, end.T_final, candidate.target.T_base_target)
    margin = 1.0 - max(final[0] / params.position_tolerance_m, final[1] / params.rotation_tolerance_rad)
    status = _status(monitor, end, margin)
    is_let_go = end.drag_m is not None
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
        "retreat_drag_m": end.drag_m,
        "n_physics_steps": world.n_steps,
        **pose_row("final", end.T_final),
    }


def is_slip(slip_m: float, slip_rad: float, params: ExecutionParams) -> bool:
    """Whether an object that moved this far in the hand was not held."""
    return slip_m > params.slipped_m or slip_rad > params.slipped_rad


def _status(monitor: Monitor, end: Ending, margin: float) -> ExecStatus:
    """A drop, a protective stop or a collision fails whatever the end; what ends as it should fails if it slipped on the way.

    Every other status says why the end is not valid, whether it slipped or not: transport_slip_m and _rad say that of all.
    """
    world, params, is_held = monitor.world, monitor.params, not monitor.is_dropped
    is_collided = monitor.collision_impulse_n_s() > params.collision_impulse_n_s
    if is_held and not world.is_stopped and not is_collided and end.is_settled and margin >= 0.0:
        return ExecStatus.SLIPPED if is_slip(monitor.slip_m, monitor.slip_rad, params) else ExecStatus.SUCCESS
    (x0, x1), (y0, y1) = world.params.table_x_m, world.params.table_y_m
    x, y, z = end.T_final[:3, 3]
    reasons = (
        (not is_held, ExecStatus.DROPPED),
        (world.is_stopped, ExecStatus.STOPPED),
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
