"""The numbers of the physics of resting objects and why they are what they are; see building.py for what is built with them."""

from __future__ import annotations

from dataclasses import dataclass

from pipelines.engines.bounds import bounded, check_bounds
from pipelines.values import TABLE_X_M, TABLE_Y_M


@dataclass(frozen=True, slots=True)
class PhysicsParams:
    """Physics of objects that nobody holds (held ones: hand_params.py): no knob of task difficulty."""

    dt_s: float = bounded(1 / 240, 1e-4, 1 / 240)  # the step that Bullet is made for
    solver_iterations: int = bounded(100, 1, 10_000)  # twice Bullet's default; a step that has converged takes fewer
    solver_residual: float = bounded(1e-7, 1e-15, 1.0)
    erp: float = bounded(0.2, 0.001, 1.0)  # contact and friction error reduction: Bullet's default, stiff enough without jitter
    table_friction: float = bounded(0.6, 0.001, 10.0)  # table and obstacles
    spinning_friction: float = bounded(0.004, 1e-6, 1.0)  # on table and obstacles: what lies on them touches them with an area
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
