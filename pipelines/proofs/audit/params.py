"""How finely the audits look, and from when on they disagree; see paths.py, rejections.py and audits.py for what they look at."""

from __future__ import annotations

from dataclasses import dataclass

from pipelines.engines.bounds import bounded, check_bounds


@dataclass(frozen=True, slots=True)
class AuditParams:
    """Resolution of the audits; see PlanningParams for that of the planner."""

    # Largest joint step between rechecked configurations: a quarter of what the planner takes, 5 mm at most at the TCP.
    step_rad: float = bounded(0.005, 1e-4, 0.05)
    # Deeper is a bug; less is what two engines may differ by where the planner tolerates contact.
    max_depth_m: float = bounded(0.001, 0.0, 0.01)
    budget_factor: int = bounded(10, 1, 1000)  # of the checks that the planner may spend
    n_q7: int = bounded(256, 1, 4096)  # twice as fine a grid of the redundant joint as the planner has
    line_step_m: float = bounded(0.001, 1e-4, 0.0025)  # of descend and retreat; the planner takes 2.5 mm
    n_restarts: int = bounded(64, 0, 10_000)  # random starts of the numerical inverse kinematics, which knows nothing of grids and branches

    def __post_init__(self) -> None:
        check_bounds(self)
