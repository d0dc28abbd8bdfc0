"""The numbers of the held object's engine and where each comes from; the geometry of the pads is pads.py, the model hand_model.py."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

CELLS_PER_SIDE = (3, 5)


@dataclass(frozen=True, slots=True)
class HandWorldParams:
    """Physics of what the hand holds: no knob of task difficulty. `perturbed` makes the variants of the repeatability study.

    Friction of a pair of surfaces is the product of a number for the object (objects/catalogue.toml) and one for the other surface, the
    same for both directions of a surface (isotropic Coulomb cone, elliptic). The numbers are assumptions of the benchmark, the same for
    every policy: the catalogue says so for each material.
    """

    # Commands and checks run on the clock of the rest of the pipeline; contacts are solved `steps_per_tick` times in between (1.04 ms).
    # The note beside this engine tells what half of the step changes.
    dt_s: float = 1 / 240
    steps_per_tick: int = 4
    check_every_steps: int = 8  # ticks from one look to the next: 33 ms
    solver_iterations: int = 100  # Newton converges in 1 to 13
    solver_tolerance: float = 1e-13
    # Friction is viscous below Coulomb's bound: a held object creeps at its load over (this ratio x the pads' damping), MuJoCo's impratio.
    # At 100 a heavy box crept 0.17 mm in three seconds, at 1000 0.02 mm; 10,000 costs a third more.
    friction_stiffness_ratio: float = 1000.0

    # Franka Hand product manual R50010 1.2: continuous grasping force adjustable from 30 to 70 N, 50 mm/s a finger, 80 mm of travel. The
    # middle of the range, for every object: the hand does not know what it is about to hold.
    finger_force_n: float = 50.0
    finger_speed_m_s: float = 0.05
    # MuJoCo Menagerie's model of this hand (system identification of the real one): 15 g of finger and 0.1 kg of drive a finger.
    finger_mass_kg: float = 0.115
    finger_lag_s: float = 0.004  # in which a free finger takes up a commanded speed
    # In which the grip force rises once both fingers touch, and falls before they open. A force that stops at once lets the pads throw the
    # fingers open, one before the other, and kick what they release.
    grip_ramp_s: float = 0.02

    # A pad is a block of rubber of 60 Shore A (Gent 1958: 3.6 MPa) with a face of 17.5 x 18.5 mm: 0.4 MN/m where it may bulge, 4 MN/m where
    # it may not (2 to 3 mm thick, bonded on one side). The geometric middle: 50 N press an even face in by 40 um.
    pad_stiffness_n_m: float = 1.3e6
    # Relaxation time of the pad: it presses evenly one hundredth of a second after a change, as rubber does.
    pad_relaxation_s: float = 0.010
    cells_per_side: int = 3  # a pad's face is that many by that many cells that yield on their own
    pad_lever_scale: float = 1.0  # of the lever that even pressure gives, for the repeatability study
    pad_protrusion_m: float = 0.00035  # the cells stand that far before the rigid block behind them: nine times what an even face yields

    pad_friction: float = 0.8  # times the object's
    table_friction: float = 0.6  # table, obstacles, palm and the bare sides of the fingers
    friction_scale: float = 1.0  # of every pair with the object, for the repeatability study
    rolling_friction_m: float = 0.0001  # round objects on table and obstacles: a can on wood rolls out in a second or two

    # What the arm bears before it stops by itself. A larger contact force on the hand, the mean of a tick (4 ms), ends the motion.
    # FCI collision reflexes are set between 20 and 100 N in libfranka's examples; the largest is taken, so that only a jam sets it off.
    protective_stop_n: float = 100.0

    settled_speed_m_s: float = 0.004  # means between two checks
    settled_rate_rad_s: float = 0.04
    settled_checks: int = 3  # in a row
    table_x_m: tuple[float, float] = (-0.4, 1.1)  # a workbench that the arm stands on
    table_y_m: tuple[float, float] = (-0.9, 0.9)
    table_thickness_m: float = 0.1

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(value, tuple):
                if not value[0] < value[1]:
                    raise ValueError(f"{field.name} = {value}, must be (lower, upper)")
            elif not 0.0 < value < 1e8:
                raise ValueError(f"{field.name} = {value}, must be in (0, 1e8)")
        bounds = {
            "dt_s": (1e-4, 1 / 240 + 1e-12),
            "step_s": (1e-5, 0.0021),  # at 2 ms 4.5 % of the labels flip
            "finger_force_n": (30.0, 70.0),
            "pad_lever_scale": (0.85, 1.15),
            "friction_scale": (0.5, 2.0),
        }
        for name, (low, high) in bounds.items():
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name} = {getattr(self, name)}, must be in [{low}, {high}]")
        if self.cells_per_side not in CELLS_PER_SIDE:
            raise ValueError(f"cells_per_side = {self.cells_per_side}, must be one of {CELLS_PER_SIDE}")

    @property
    def step_s(self) -> float:
        """Time step of the contacts."""
        return self.dt_s / self.steps_per_tick
