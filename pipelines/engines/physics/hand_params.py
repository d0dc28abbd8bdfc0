"""The numbers of the held object's engine and where each comes from; the geometry of the pads is pads.py, the bodies hand_bodies.py."""

from __future__ import annotations

from dataclasses import dataclass

from pipelines.engines.bounds import BoundsError, bounded, check_bounds
from pipelines.values import TABLE_X_M, TABLE_Y_M

CELLS_PER_SIDE = (0, 3, 5)  # 0: a rigid block, the pad that other engines have, too
MAX_STEP_S = 0.0021  # at 2 ms 4.5 % of the labels flip


@dataclass(frozen=True, slots=True)
class HandWorldParams:
    """Physics of what the hand holds: no knob of task difficulty. `perturbed` makes the variants of the repeatability study.

    Friction of a pair of surfaces is the product of a number for the object (objects/catalogue.toml) and one for the other surface, the
    same for both directions of a surface (isotropic Coulomb cone, elliptic). objects/catalogue.toml has the sources and what was chosen
    within their bounds; it is the same for every policy.
    """

    # Commands and checks run on the clock of the rest of the pipeline; contacts are solved `steps_per_tick` times in between (1.04 ms).
    # The note beside this engine tells what half of the step changes.
    dt_s: float = bounded(1 / 240, 1e-4, 1 / 240 + 1e-12)
    steps_per_tick: int = bounded(4, 1, 64)
    # From the moment the hand lets go: what tumbles off opening fingers and lands on an edge hangs on the step as what is held does not.
    landing_steps_per_tick: int = bounded(12, 1, 256)
    check_every_steps: int = bounded(8, 1, 240)  # ticks from one look to the next: 33 ms
    solver_iterations: int = bounded(100, 1, 1000)  # Newton converges in 1 to 13
    solver_tolerance: float = bounded(1e-13, 1e-15, 1e-3)
    # Friction is viscous below Coulomb's bound: a held object creeps at its load over (this ratio x the pads' damping), MuJoCo's impratio.
    # At 100 a heavy box crept 0.17 mm in three seconds, at 1000 0.02 mm; 10,000 costs a third more.
    friction_stiffness_ratio: float = bounded(1000.0, 1.0, 1e6)

    # Franka Hand product manual R50010 1.2: continuous grasping force adjustable from 30 to 70 N, 50 mm/s a finger, 80 mm of travel. The
    # middle of the range, for every object: the hand does not know what it is about to hold.
    finger_force_n: float = bounded(50.0, 30.0, 70.0)
    finger_speed_m_s: float = bounded(0.05, 0.001, 0.1)
    # MuJoCo Menagerie's model of this hand (system identification of the real one): 15 g of finger and 0.1 kg of drive a finger.
    finger_mass_kg: float = bounded(0.115, 0.01, 1.0)
    finger_lag_s: float = bounded(0.004, 1e-4, 0.1)  # in which a free finger takes up a commanded speed
    # In which the grip force rises once both fingers touch, and falls before they open. A force that stops at once lets the pads throw the
    # fingers open, one before the other, and kick what they release.
    grip_ramp_s: float = bounded(0.02, 1e-3, 1.0)

    # A pad is a block of rubber of 60 Shore A (Gent 1958: 3.6 MPa) with a face of 17.5 x 18.5 mm: 0.4 MN/m where it may bulge, 4 MN/m where
    # it may not (2 to 3 mm thick, bonded on one side). The geometric middle: 50 N press an even face in by 40 um.
    pad_stiffness_n_m: float = bounded(1.3e6, 1e4, 1e7)
    # Relaxation time of the pad: it presses evenly one hundredth of a second after a change, as rubber does.
    pad_relaxation_s: float = bounded(0.010, 1e-3, 0.1)
    cells_per_side: int = bounded(3, 0, 5)  # a pad's face is that many by that many cells that yield on their own
    pad_lever_scale: float = bounded(1.0, 0.85, 1.15)  # of the lever that even pressure gives, for the repeatability study
    # The cells stand that far before the rigid block behind them: nine times what an even face yields.
    pad_protrusion_m: float = bounded(0.00035, 1e-5, 0.002)
    # Cans as the prisms of 48 sides that they are in engines without cylinders: for a comparison with one.
    rounds_are_hulls: bool = bounded(False, 0, 1)

    pad_friction: float = bounded(0.8, 0.05, 2.0)  # times the object's
    table_friction: float = bounded(0.6, 0.05, 2.0)  # table, obstacles, palm and the bare sides of the fingers
    friction_scale: float = bounded(1.0, 0.5, 2.0)  # of every pair with the object, for the repeatability study
    rolling_friction_m: float = bounded(
        0.0001, 1e-7, 0.01
    )  # round objects on table and obstacles: a can on wood rolls out in a second or two

    # What the arm bears before it stops by itself. A larger contact force on the hand, the mean of a tick (4 ms), ends the motion.
    # FCI collision reflexes are set between 20 and 100 N in libfranka's examples; the largest is taken, so that only a jam sets it off.
    protective_stop_n: float = bounded(100.0, 10.0, 1000.0)

    settled_speed_m_s: float = bounded(0.004, 1e-5, 0.1)  # means between two checks
    settled_rate_rad_s: float = bounded(0.04, 1e-4, 1.0)
    settled_checks: int = bounded(3, 1, 100)  # in a row
    table_x_m: tuple[float, float] = bounded(TABLE_X_M, -10.0, 10.0, is_increasing=True)  # a workbench that the arm stands on
    table_y_m: tuple[float, float] = bounded(TABLE_Y_M, -10.0, 10.0, is_increasing=True)
    table_thickness_m: float = bounded(0.1, 0.001, 1.0)

    def __post_init__(self) -> None:
        check_bounds(self)
        if self.step_s > MAX_STEP_S:
            raise BoundsError(f"steps_per_tick = {self.steps_per_tick}, a step of {self.step_s:.3g} s, must be at most {MAX_STEP_S} s")
        if self.cells_per_side not in CELLS_PER_SIDE:
            raise BoundsError(f"cells_per_side = {self.cells_per_side}, must be one of {CELLS_PER_SIDE}")

    @property
    def step_s(self) -> float:
        """Time step of the contacts."""
        return self.dt_s / self.steps_per_tick
