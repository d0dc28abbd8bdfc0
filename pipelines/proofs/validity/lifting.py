"""Lifts admitted grasps in the held object's engine, to measure the engine; the labels of the benchmark are grasps.pick_lift's."""

from __future__ import annotations

from dataclasses import dataclass

from objects.gripper import open_jaw_m
from pipelines.engines.physics.errors import PhysicsError
from pipelines.engines.physics.hand_rollout import Phase, close_fingers, hold, move, pose_difference, pressing_fingers
from pipelines.engines.physics.hand_world import HandWorld
from pipelines.engines.planning.trajectory import MotionParams, time_path
from pipelines.engines.robot.arm import fk, follow_line
from pipelines.grasps.pick_lift import PickLiftParams
from pipelines.values import AdmittedGrasp, LiftedGrasp, Scene
from tables.vocabulary import LiftStatus


@dataclass(frozen=True, slots=True)
class Lift:
    """Outcome of one pick-lift; `grasp` is the state that an execution goes on from, whatever the status."""

    status: LiftStatus
    slip_m: float
    slip_rad: float
    n_steps: int
    grasp: LiftedGrasp | None


def lift(world: HandWorld, label: str, scene: Scene, grasp: AdmittedGrasp, params: PickLiftParams, motion: MotionParams) -> Lift:
    """Approach, close, lift and hold, from the object at rest on the table.

    Raises:
        PhysicsError: the arm cannot follow a line that admission passed, or the engine failed; names the grasp.
    """
    width_m = next(pool.jaw_width_m for pool in world.object_model.grasps if pool.grasp_id == grasp.grasp_id)
    T_lifted = grasp.T_base_grasp.copy()
    T_lifted[2, 3] += params.lift_m
    approach_q = follow_line(grasp.T_base_grasp, fk(grasp.pregrasp_q_rad), grasp.grasp_q_rad)
    lift_q = follow_line(grasp.T_base_grasp, T_lifted, grasp.grasp_q_rad)
    if approach_q is None or lift_q is None:
        raise PhysicsError(f"{label}: the arm cannot follow the approach or the lift that admission passed")
    world.start_open(label, grasp.pregrasp_q_rad, open_jaw_m(width_m) / 2, scene.T_base_object)
    move(world, Phase.APPROACH, time_path(approach_q[::-1], motion, world.params.dt_s, stop_at_waypoints=False))
    push_m, _ = pose_difference(world.object_pose(), scene.T_base_object)
    if push_m > params.max_approach_push_m or world.is_stopped:
        return Lift(LiftStatus.DISTURBED, push_m, 0.0, world.n_steps, None)
    close_fingers(world, params.max_close_s)
    hold(world, Phase.CLOSE, params.squeeze_s)
    T_tcp_closed, z_closed_m = world.inhand_pose(), world.object_pose()[2, 3]
    move(world, Phase.LIFT, time_path(lift_q, motion, world.params.dt_s, stop_at_waypoints=False))
    hold(world, Phase.HOLD, params.hold_s)
    slip_m, slip_rad = pose_difference(T_tcp_closed, world.inhand_pose())
    if world.object_pose()[2, 3] - z_closed_m < params.min_rise_m:
        status = LiftStatus.NOT_LIFTED
    elif pressing_fingers(world) < 2:
        status = LiftStatus.LOST_FINGER
    elif slip_m > params.max_slip_m or slip_rad > params.max_slip_rad:
        status = LiftStatus.SLIPPED
    else:
        status = LiftStatus.LIFTED
    q, fingers_m = world.arm_state()
    lifted = LiftedGrasp(grasp.grasp_id, q, fingers_m, world.object_pose(), world.inhand_pose())
    return Lift(status, slip_m, slip_rad, world.n_steps, lifted)
