"""The numbers of the physics recipe and why they are what they are; what is built with them is world's."""

from __future__ import annotations

from dataclasses import dataclass, fields


@dataclass(frozen=True, slots=True)
class PhysicsParams:
    """The physics recipe. It was tuned once to grasp, carry and release believably, and is no knob of task difficulty."""

    dt_s: float = 1 / 240  # at 1/480 s, 6 % of 300 executions succeed or fail otherwise, nearly all of them slipping; 1/120 s: a third
    solver_iterations: int = 100  # with 50, mugs held by their thin walls creep 1 mm a second; 200 change little and cost a fifth more
    solver_residual: float = 1e-7  # ends the iterations of a step that has converged
    erp: float = 0.2  # joint, contact and friction error reduction: Bullet's default, stiff enough without jitter
    arm_position_gain: float = 0.3  # with velocity feed-forward follows a trajectory within 1 mm
    arm_velocity_gain: float = 1.0
    finger_speed_m_s: float = 0.1  # the Franka Hand's own limit
    # Speed that a gripping finger strives for and never reaches. At 0.1 m/s its motor meets its bound so late in the solver's iterations
    # that the friction behind it lags: without anchors, the heaviest boxes crept 2.5 mm in five seconds, so 0.5 mm.
    grip_speed_m_s: float = 0.3
    # Force of a finger: 15 N and 50 N a kilogram, at most 60 N (the Franka Hand holds 70 N). Whoever grasps a sponge as hard as a full
    # can crushes it; here the engine would: 30 N on everything lost 6 of 16 grasps of the lightest objects to the solver, and held the
    # heaviest too loosely.
    min_finger_force_n: float = 15.0
    finger_force_n_per_kg: float = 50.0
    max_finger_force_n: float = 60.0
    gear_erp: float = 0.1  # couples the fingers as the hand's belt does
    gear_force_n: float = 50.0
    # Turn of the hand after which the pads' contacts are found anew, looked at in every check: their normals are wrong by this and what the
    # hand turns from one check to the next, 0.09 rad at most by one joint.
    pad_refresh_rad: float = 0.1
    finger_friction: float = 0.8  # rubber pads; the engine multiplies with the object's
    table_friction: float = 0.6  # table and obstacles
    spinning_friction: float = 0.004  # on fingers and table: a pad is a patch, not a point
    rolling_friction: float = 0.0001  # on the table only: a can on wood rolls out in a second or two
    settled_speed_m_s: float = 0.004  # means between two checks
    settled_rate_rad_s: float = 0.04
    settled_checks: int = 3  # in a row
    check_every_steps: int = 8  # 33 ms: slower than contact jitter, faster than anything falls
    table_x_m: tuple[float, float] = (-0.4, 1.1)  # a workbench that the arm stands on
    table_y_m: tuple[float, float] = (-0.9, 0.9)
    table_thickness_m: float = 0.1

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, tuple):
                if not value[0] < value[1]:
                    raise ValueError(f"{field.name} = {value}, must be (lower, upper)")
            elif not 0.0 < value < 1e4:
                raise ValueError(f"{field.name} = {value}, must be in (0, 1e4)")
        if self.max_finger_force_n < self.min_finger_force_n:
            raise ValueError(
                f"max_finger_force_n = {self.max_finger_force_n}, must be at least min_finger_force_n = {self.min_finger_force_n}"
            )
        if self.dt_s > 1 / 240 + 1e-12:
            raise ValueError(f"dt_s = {self.dt_s}, must be at most 1/240")
