"""Does the grasp lift the object? Approach, close, lift and hold in physics; see admission.py for which grasps are tried."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from objects.gripper import open_jaw_m
from objects.object_model import ObjectModel
from pipelines import laws
from pipelines.codecs import Row, joints_row, pose_row
from pipelines.engines.bounds import BoundsError, bounded, check_bounds
from pipelines.engines.physics.errors import PhysicsError
from pipelines.engines.physics.hand_params import HandWorldParams
from pipelines.engines.physics.hand_rollout import close_fingers, hold, move, pressing_fingers
from pipelines.engines.physics.hand_world import HandWorld
from pipelines.engines.physics.phases import Phase, pose_difference
from pipelines.engines.planning.trajectory import MotionParams, time_path
from pipelines.engines.robot.arm import fk, follow_line
from pipelines.grasps.admission import AdmissionParams
from pipelines.stage import Stage, Unit, UnitResult, timing_row
from pipelines.values import AdmittedGrasp, Scene
from tables.schemas import GRASP_ADMISSION, OBSTACLES, PICK_LIFT, SCENES, TARGETS
from tables.vocabulary import LiftStatus


@dataclass(frozen=True, slots=True)
class PickLiftParams:
    """Bounds of the pick-lift check."""

    lift_m: float = bounded(0.12, 0.02, 1.0)  # the lift that admission checked, as high as an obstacle
    # At 0.05 m/s a finger crosses its whole 40 mm in 0.8 s; twice that leaves room for an object pushed to the middle.
    max_close_s: float = bounded(1.6, 0.01, 10.0)
    squeeze_s: float = bounded(0.1, 0.01, 10.0)  # grip force builds up before the arm moves
    hold_s: float = bounded(0.25, 0.01, 10.0)  # 60 steps: a grasp that creeps shows it
    max_approach_push_m: float = bounded(0.01, 1e-4, 0.5)  # the open hand may brush what it is about to grasp, not shove it
    min_rise_m: float = bounded(0.10, 0.001, 1.0)  # of the 0.12 m: the rest may be lost to closing and slip, which have their own bound
    max_slip_m: float = bounded(0.02, 1e-4, 0.5)
    max_slip_rad: float = bounded(0.2617993877991494, 0.001, math.pi)  # 15 degrees

    def __post_init__(self) -> None:
        check_bounds(self)
        if self.min_rise_m >= self.lift_m:
            raise BoundsError(f"min_rise_m = {self.min_rise_m}, must be below lift_m = {self.lift_m}")


@dataclass(frozen=True, slots=True)
class PickLiftSetup:
    """How grasps are tried: phases and verdicts, how their lines were admitted, timing of the motions, physics."""

    pick_lift: PickLiftParams
    admission: AdmissionParams
    motion: MotionParams
    physics: HandWorldParams


def pick_lift_rows(object_model: ObjectModel, scene: Scene, admitted: Sequence[AdmittedGrasp], setup: PickLiftSetup) -> list[Row]:
    """Rows of `pick_lift`, one an admitted grasp; each grasp starts from fresh data, so a row depends on its grasp only.

    Raises:
        PhysicsError: the engine warned or gave a state that is not finite, or the arm cannot follow a line that admission passed.
    """
    with HandWorld(object_model, scene.obstacles, setup.physics) as world:
        return [_pick_lift_row(world, scene, grasp, setup) for grasp in admitted]


def _pick_lift_row(world: HandWorld, scene: Scene, grasp: AdmittedGrasp, setup: PickLiftSetup) -> Row:
    params, motion = setup.pick_lift, setup.motion
    label = f"{scene.scene_id}-g{grasp.grasp_id:02d}"
    opening_m = open_jaw_m(world.object_model.grasp(grasp.grasp_id).jaw_width_m)
    T_lifted_grasp = grasp.T_base_grasp.copy()
    T_lifted_grasp[2, 3] += params.lift_m
    # Followed from the grasp outwards in the steps of admission. The lift has the very rows that admission checked. The approach ends at
    # the stored pregrasp configuration, some 1e-11 m beside the pose that admission aimed at: its rows differ by as much, and where
    # the line comes out longer than a whole number of steps (1 in 187), it has one row more.
    approach_q = _line(label, grasp, fk(grasp.pregrasp_q_rad), setup.admission)[::-1]
    lift_q = _line(label, grasp, T_lifted_grasp, setup.admission)

    world.start_open(label, grasp.pregrasp_q_rad, opening_m / 2, scene.T_base_object)
    move(world, Phase.APPROACH, time_path(approach_q, motion, world.params.dt_s, stop_at_waypoints=False))
    push_m, _ = pose_difference(world.object_pose(), scene.T_base_object)
    if world.is_stopped or push_m > params.max_approach_push_m:
        return _row(scene, grasp, LiftStatus.STOPPED if world.is_stopped else LiftStatus.DISTURBED)
    # Fingers that never both press are judged by what the lift shows.
    close_fingers(world, params.max_close_s)
    hold(world, Phase.CLOSE, params.squeeze_s)
    T_tcp_closed, T_base_closed = world.inhand_pose(), world.object_pose()
    move(world, Phase.LIFT, time_path(lift_q, motion, world.params.dt_s, stop_at_waypoints=False))
    hold(world, Phase.HOLD, params.hold_s)
    slip = pose_difference(T_tcp_closed, world.inhand_pose())
    rise_m = float(world.object_pose()[2, 3] - T_base_closed[2, 3])
    return _row(scene, grasp, _status(world, rise_m, slip, params), slip, world)


def _status(world: HandWorld, rise_m: float, slip: tuple[float, float], params: PickLiftParams) -> LiftStatus:
    if world.is_stopped:
        return LiftStatus.STOPPED
    if rise_m < params.min_rise_m:
        return LiftStatus.NOT_LIFTED
    if pressing_fingers(world) < 2:
        return LiftStatus.LOST_FINGER
    if slip[0] > params.max_slip_m or slip[1] > params.max_slip_rad:
        return LiftStatus.SLIPPED
    return LiftStatus.LIFTED


def _row(
    scene: Scene, grasp: AdmittedGrasp, status: LiftStatus, slip: tuple[float, float] | None = None, world: HandWorld | None = None
) -> Row:
    """The state is that of the end: what an execution goes on from."""
    q, fingers_m = (None, (None, None)) if world is None else world.arm_state()
    slip_m, slip_rad = slip or (None, None)
    return {
        "scene_id": scene.scene_id,
        "grasp_id": grasp.grasp_id,
        "lift_status": status.value,
        "lift_slip_m": slip_m,
        "lift_slip_rad": slip_rad,
        **joints_row("lifted_q", q),
        "lifted_finger_left_m": None if fingers_m[0] is None else float(fingers_m[0]),
        "lifted_finger_right_m": None if fingers_m[1] is None else float(fingers_m[1]),
        **pose_row("lifted", None if world is None else world.object_pose()),
        **pose_row("inhand", None if world is None else world.inhand_pose()),
    }


def _line(label: str, grasp: AdmittedGrasp, T_end: Float[np.ndarray, "4 4"], admission: AdmissionParams) -> Float[np.ndarray, "m 7"]:
    path = follow_line(grasp.T_base_grasp, T_end, grasp.grasp_q_rad, admission.line_step_m, admission.max_joint_jump_rad)
    if path is None:
        end = T_end[:3, 3].round(3).tolist()
        raise PhysicsError(f"{label}: the arm cannot follow the line from the grasp to {end} m that admission passed")
    return path


def run(unit: Unit) -> UnitResult:
    """One admitted grasp."""
    start = time.process_time_ns()
    sections = unit.params(PickLiftParams), unit.params(AdmissionParams), unit.params(MotionParams), unit.params(HandWorldParams)
    rows = pick_lift_rows(unit.object_model, unit.scene, unit.known.admitted, PickLiftSetup(*sections))
    return UnitResult({"pick_lift": rows}, [timing_row("pick_lift", unit.item_id, start)])


STAGE = Stage(
    name="pick_lift",
    group="grasps",
    description="Executes each admitted grasp in physics: approach, close, lift, hold; keeps the measured state after the lift.",
    code_version="4",
    inputs=(SCENES, OBSTACLES, TARGETS, GRASP_ADMISSION),
    objects=("objects", "object_parts", "grasp_pool"),
    outputs=(PICK_LIFT,),
    sections=(PickLiftParams, AdmissionParams, MotionParams, HandWorldParams),
    engines=("mujoco-core", "frankik", "ruckig", "numpy", "scipy"),
    run=run,
    law=laws.pick_lift_law,
    split="admitted",
    time_share=0.10,
)
