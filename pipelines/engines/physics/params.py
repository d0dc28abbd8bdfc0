"""The numbers of the physics recipe and why they are what they are; see building.py for what is built with them."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pipelines.engines.bounds import BoundsError, bounded, check_bounds
from pipelines.values import TABLE_X_M, TABLE_Y_M


@dataclass(frozen=True, slots=True)
class PhysicsParams:
    """The physics recipe. It was tuned once to grasp, carry and release believably, and is no knob of task difficulty."""

    # At 1/480 s, 6 % of 300 executions succeed or fail otherwise, nearly all of them slipping; at 1/120 s a third.
    dt_s: float = bounded(1 / 240, 1e-4, 1 / 240)
    # With 50, mugs held by their thin walls creep 1 mm a second; 200 change little and cost a fifth more.
    solver_iterations: int = bounded(100, 1, 10_000)
    solver_residual: float = bounded(1e-7, 1e-15, 1.0)  # ends the iterations of a step that has converged
    erp: float = bounded(0.2, 0.001, 1.0)  # joint, contact and friction error reduction: Bullet's default, stiff enough without jitter
    arm_position_gain: float = bounded(0.3, 0.001, 10.0)  # with velocity feed-forward follows a trajectory within 1 mm
    arm_velocity_gain: float = bounded(1.0, 0.001, 10.0)
    finger_speed_m_s: float = bounded(0.1, 0.001, 1.0)  # the limit of the Franka Hand itself
    # Speed that a gripping finger strives for and never reaches. At 0.1 m/s its motor meets its bound so late in the solver's iterations
    # that the friction behind it lags: without anchors, the heaviest boxes crept 2.5 mm in five seconds, so 0.5 mm.
    grip_speed_m_s: float = bounded(0.3, 0.001, 1.0)
    # Force of a finger: 15 N and 50 N a kilogram, at most 60 N (the Franka Hand holds 70 N). Whoever grasps a sponge as hard as a full
    # can crushes it; here the engine would: 30 N on everything lost 6 of 16 grasps of the lightest objects to the solver, and held the
    # heaviest too loosely.
    min_finger_force_n: float = bounded(15.0, 0.1, 1000.0)
    finger_force_n_per_kg: float = bounded(50.0, 0.1, 1000.0)
    max_finger_force_n: float = bounded(60.0, 0.1, 1000.0)
    gear_erp: float = bounded(0.1, 0.001, 1.0)  # couples the fingers as the belt of the hand does
    gear_force_n: float = bounded(50.0, 0.1, 1000.0)
    # Turn of the hand after which the contacts of the pads are found anew, looked at in every check: their normals are wrong by this and
    # what the hand turns from one check to the next, 0.09 rad at most by one joint.
    pad_refresh_rad: float = bounded(0.1, 1e-9, math.pi)
    finger_friction: float = bounded(0.8, 0.001, 10.0)  # rubber pads; the engine multiplies with that of the object
    table_friction: float = bounded(0.6, 0.001, 10.0)  # table and obstacles
    spinning_friction: float = bounded(0.004, 1e-6, 1.0)  # on fingers and table: a pad is a patch, not a point
    rolling_friction: float = bounded(0.0001, 1e-6, 1.0)  # on the table only: a can on wood rolls out in a second or two
    settled_speed_m_s: float = bounded(0.004, 1e-6, 1.0)  # means between two checks
    settled_rate_rad_s: float = bounded(0.04, 1e-5, 10.0)
    settled_checks: int = bounded(3, 1, 1000)  # in a row
    check_every_steps: int = bounded(8, 1, 1000)  # 33 ms: slower than contact jitter, faster than anything falls
    table_x_m: tuple[float, float] = bounded(TABLE_X_M, -10.0, 10.0, is_increasing=True)  # a workbench that the arm stands on
    table_y_m: tuple[float, float] = bounded(TABLE_Y_M, -10.0, 10.0, is_increasing=True)
    table_thickness_m: float = bounded(0.1, 0.01, 1.0)

    def __post_init__(self) -> None:
        check_bounds(self)
        if self.max_finger_force_n < self.min_finger_force_n:
            raise BoundsError(
                f"max_finger_force_n = {self.max_finger_force_n}, must be at least min_finger_force_n = {self.min_finger_force_n}"
            )
