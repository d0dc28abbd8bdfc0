"""Executes stored plans in the held object's engine, to measure the engine; the labels of the benchmark are labels.execution's."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from objects.gripper import open_jaw_m
from objects.object_model import ObjectModel
from pipelines.engines.physics.hand_rollout import Phase, RestWatch, hold, move, open_fingers, pose_difference, settle
from pipelines.engines.physics.hand_world import HandWorld
from pipelines.engines.planning.trajectory import MotionParams, time_path
from pipelines.labels.execution import ExecutionParams
from pipelines.values import LiftedGrasp, Plan, Target
from tables.vocabulary import ExecStatus, Symmetry

# Fingers that take over a grasp lifted by another engine start that much further open, and close on the weightless object.
TAKE_GAP_M = 0.002
TAKE_S = 0.15
# A finger moves at 0.05 m/s: 12 mm take 0.24 s.
MAX_OPEN_S = 0.5


@dataclass(frozen=True, slots=True)
class Executed:
    """Outcome of one execution: metres, radians, newton seconds."""

    status: ExecStatus
    position_error_m: float
    rotation_error_rad: float
    margin: float
    slip_m: float
    slip_rad: float
    drag_m: float | None
    impulse_n_s: float
    is_lost: bool
    is_stopped: bool
    n_steps: int
    T_taken: Float[np.ndarray, "4 4"]
    T_final: Float[np.ndarray, "4 4"]

    @property
    def is_success(self) -> bool:
        return self.status is ExecStatus.SUCCESS


def execute(
    world: HandWorld,
    label: str,
    grasp: LiftedGrasp,
    target: Target,
    plan: Plan,
    params: ExecutionParams,
    motion: MotionParams,
    *,
    is_continuous: bool,
) -> Executed:
    """Carry, descend, release, retreat, settle, and judge.

    Args:
        is_continuous: the grasp was lifted in this engine and goes on from its very state; otherwise it is taken over.
    """
    if is_continuous:
        world.start_held(label, grasp.lifted_q_rad, grasp.fingers_m.tolist(), grasp.T_tcp_object)
    else:
        finger_m = min(0.04, float(grasp.fingers_m.mean()) + TAKE_GAP_M)
        world.start_taking(label, grasp.lifted_q_rad, finger_m, grasp.T_tcp_object, TAKE_S)
    T_taken = world.inhand_pose()
    monitor = _Monitor(world, T_taken, params)
    is_held = _carry(world, plan, params, motion, monitor)
    T_release = world.object_pose()
    drag_m = None
    if is_held and not world.is_stopped:
        width_m = next(pool.jaw_width_m for pool in world.object_model.grasps if pool.grasp_id == grasp.grasp_id)
        drag_m = _let_go(world, width_m, plan, params, motion, monitor)
    impulse_n_s = _collision_impulse(world) + monitor.carried_impulse_n_s
    is_stopped = world.is_stopped
    world.remove_hand()
    is_settled = settle(world, params.max_settle_steps)
    T_final = world.object_pose()
    error_m, _ = pose_difference(T_final, target.T_base_target)
    error_rad = world.object_model.rotation_error_rad(T_final[:3, :3], target.T_base_target[:3, :3])
    margin = 1.0 - max(error_m / params.position_tolerance_m, error_rad / params.rotation_tolerance_rad)
    is_collided = impulse_n_s > params.collision_impulse_n_s or is_stopped
    status = _status(world, params, monitor, is_held, is_collided, is_settled, margin, T_release, T_final, drag_m)
    return Executed(
        status, error_m, error_rad, margin, monitor.slip_m, monitor.slip_rad, drag_m, impulse_n_s, world.is_lost, is_stopped,
        world.n_steps, T_taken, T_final,
    )  # fmt: skip


def _carry(world: HandWorld, plan: Plan, params: ExecutionParams, motion: MotionParams, monitor: _Monitor) -> bool:
    """Hold, transport, descend; False where the object was dropped on the way."""
    dt_s = world.params.dt_s
    transport = time_path(plan.transport_q_rad, motion, dt_s, stop_at_waypoints=True)
    descend = time_path(plan.descend_q_rad, motion, dt_s, stop_at_waypoints=False)
    is_carried = hold(world, Phase.HOLD, params.hold_s, monitor.carried) and move(world, Phase.TRANSPORT, transport, monitor.carried)
    monitor.begin_descend()
    if is_carried:
        move(world, Phase.DESCEND, descend, monitor.carried)
    monitor.end_descend()
    return not monitor.is_dropped and not world.is_lost


def _let_go(world: HandWorld, width_m: float, plan: Plan, params: ExecutionParams, motion: MotionParams, monitor: _Monitor) -> float:
    """Open and retreat; how far the object moved during the retreat, in metres."""
    open_fingers(world, open_jaw_m(width_m), MAX_OPEN_S)
    hold(world, Phase.OPEN, params.release_wait_s)
    T_opened = world.object_pose()
    retreat = time_path(plan.retreat_q_rad, motion, world.params.dt_s, stop_at_waypoints=False)
    monitor.rest = RestWatch(world)
    move(world, Phase.RETREAT, retreat, monitor.released)
    return pose_difference(T_opened, world.object_pose())[0]


@dataclass(slots=True)
class _Monitor:
    world: HandWorld
    T_tcp_object: Float[np.ndarray, "4 4"]
    params: ExecutionParams
    slip_m: float = 0.0
    slip_rad: float = 0.0
    is_dropped: bool = False
    is_touched_in_retreat: bool = False
    carried_impulse_n_s: float = 0.0
    rest: RestWatch | None = None

    def carried(self, phase: Phase) -> bool:
        if self.world.is_lost:
            return True
        slip_m, slip_rad = pose_difference(self.T_tcp_object, self.world.inhand_pose())
        self.slip_m, self.slip_rad = max(self.slip_m, slip_m), max(self.slip_rad, slip_rad)
        self.is_dropped = self.is_dropped or slip_m > self.params.dropped_m
        return self.is_dropped

    def begin_descend(self) -> None:
        """What the held object met up to here is a collision; the end of the descend may set it down on the table."""
        self.carried_impulse_n_s += sum(self.world.impulse_n_s("object", name) for name in self.world.fixed_bodies)
        self._before = self._obstacles()

    def end_descend(self) -> None:
        self.carried_impulse_n_s += self._obstacles() - self._before

    _before: float = 0.0

    def _obstacles(self) -> float:
        return sum(self.world.impulse_n_s("object", name) for name in self.world.fixed_bodies[1:])

    def released(self, phase: Phase) -> bool:
        touched = any(self.world.touching(part) for part in ("panda_hand", "panda_leftfinger", "panda_rightfinger"))
        self.is_touched_in_retreat = self.is_touched_in_retreat or touched
        return self.rest is not None and self.rest.is_at_rest() and self.world.is_clear(self.params.clear_gap_m)


def _collision_impulse(world: HandWorld) -> float:
    """Of the hand with anything fixed."""
    return sum(world.impulse_n_s("robot", name) for name in world.fixed_bodies)


def _status(
    world: HandWorld,
    params: ExecutionParams,
    monitor: _Monitor,
    is_held: bool,
    is_collided: bool,
    is_settled: bool,
    margin: float,
    T_release: Float[np.ndarray, "4 4"],
    T_final: Float[np.ndarray, "4 4"],
    drag_m: float | None,
) -> ExecStatus:
    if is_held and not is_collided and is_settled and margin >= 0.0:
        return ExecStatus.SUCCESS
    (x0, x1), (y0, y1) = world.params.table_x_m, world.params.table_y_m
    x, y, z = T_final[:3, 3]
    reasons = (
        (not is_held, ExecStatus.DROPPED),
        (monitor.slip_m > params.slipped_m or monitor.slip_rad > params.slipped_rad, ExecStatus.SLIPPED),
        (is_collided, ExecStatus.COLLIDED),
        (not (x0 < x < x1 and y0 < y < y1 and z > 0.0), ExecStatus.OFF_TABLE),
        (drag_m is not None and drag_m > params.dragged_m and monitor.is_touched_in_retreat, ExecStatus.DRAGGED),
        (_tilt_rad(world.object_model, T_release, T_final) > params.toppled_rad, ExecStatus.TOPPLED),
        (not is_settled, ExecStatus.NOT_SETTLED),
    )
    return next((status for applies, status in reasons if applies), ExecStatus.OFF_TARGET)


def _tilt_rad(object_model: ObjectModel, T_a: Float[np.ndarray, "4 4"], T_b: Float[np.ndarray, "4 4"]) -> float:
    """Change of the vertical as the object sees it; a can that rolls about its axis does not tilt."""
    up_a, up_b = T_a[2, :3], T_b[2, :3]
    if object_model.symmetry is Symmetry.REVOLUTION_Z:
        return abs(math.acos(float(np.clip(up_a[2], -1.0, 1.0))) - math.acos(float(np.clip(up_b[2], -1.0, 1.0))))
    return float(np.arctan2(np.linalg.norm(np.cross(up_a, up_b)), up_a @ up_b))
