"""How finely the audits look, and from when on they disagree; what they look at is paths', rejections' and audits'."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class AuditParams:
    """Resolution of the audits; the planner's own is PlanningParams'."""

    step_rad: float = 0.005  # largest joint step between rechecked configurations: a quarter of the planner's, 5 mm at most at the TCP
    max_depth_m: float = 0.001  # deeper is a bug; less is what two engines may differ by in a touch that the planner tolerates
    budget_factor: int = 10  # of the planner's checks
    n_q7: int = 256  # twice the planner's grid of the redundant joint
    line_step_m: float = 0.001  # of descend and retreat; the planner's is 2.5 mm
    n_restarts: int = 64  # random starts of the numerical inverse kinematics, which knows nothing of grids and branches

    def __post_init__(self) -> None:
        bounds = {
            "step_rad": (1e-4, 0.05), "max_depth_m": (0.0, 0.01), "budget_factor": (1, 1000),
            "n_q7": (1, 4096), "line_step_m": (1e-4, 0.0025), "n_restarts": (0, 10_000),
        }  # fmt: skip
        for name, (lower, upper) in bounds.items():
            if not lower <= getattr(self, name) <= upper:
                raise ValueError(f"{name} = {getattr(self, name)}, must be in [{lower}, {upper}]")
