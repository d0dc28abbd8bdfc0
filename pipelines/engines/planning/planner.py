"""A collision-free joint path from a start to the best of some goals: straight first, RRTConnect where that is blocked.

Collision is behind a callable; see trajectory.py for timing. Budgets are counts and the random seed is an argument, so a path depends
on the arguments alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from pipelines.engines.bounds import bounded, check_bounds
from pipelines.engines.robot.arm import Q_LOWER_RAD, Q_UPPER_RAD

InCollision = Callable[[Float[np.ndarray, "7"]], bool]


@dataclass(frozen=True, slots=True)
class SearchParams:
    """How hard to look for a path."""

    # Largest joint step between checked configurations; 0.05 lets 1 in 100 paths graze, 0.02 none.
    edge_step_rad: float = bounded(0.02, 1e-4, 0.1)
    range_rad: float = bounded(1.5, 0.01, 10.0)  # longest edge RRTConnect grows
    # Configurations checked a search: ten times as many found nothing more on a stress set.
    max_checks: int = bounded(20_000, 1, 10_000_000)
    n_shorten_steps: int = bounded(30, 1, 10_000)  # attempts to cut a corner of a found path; the cheap reduceVertices, 0.3 ms

    def __post_init__(self) -> None:
        check_bounds(self)


class CountedChecks:
    """A collision test that counts how often it is asked."""

    def __init__(self, in_collision: InCollision) -> None:
        self._in_collision = in_collision
        self.n_checks = 0

    def in_collision(self, q: Float[np.ndarray, "7"]) -> bool:
        self.n_checks += 1
        return self._in_collision(q)

    def is_free_edge(self, q_a: Float[np.ndarray, "7"], q_b: Float[np.ndarray, "7"], step_rad: float) -> bool:
        """Whether a straight joint-space edge is free, both ends included.

        The order halves the largest gap each round, which meets a collision in the middle early.
        """
        n_steps = max(1, math.ceil(float(np.abs(q_b - q_a).max()) / step_rad))
        q = q_a + np.linspace(0.0, 1.0, n_steps + 1)[:, None] * (q_b - q_a)
        return not any(self.in_collision(q[k]) for k in _halving_order(n_steps + 1))

    def is_free_path(self, path: Float[np.ndarray, "n 7"]) -> bool:
        """Whether every row is free; rows are checked as they are, in the same order."""
        return not any(self.in_collision(path[k]) for k in _halving_order(len(path)))


def search_path(
    q_start: Float[np.ndarray, "7"], goals: Float[np.ndarray, "g 7"], checks: CountedChecks, params: SearchParams, seed: int
) -> Float[np.ndarray, "k 7"] | None:
    """RRTConnect from a free start to any of some free goals, then shortened; None when the budget is spent.

    Args:
        q_start: configuration in radians.
        goals: configurations, each free.
        checks: counts every configuration tested, also those of shortening.
        seed: in [1, 2147483646]; OMPL refuses 0.
    """
    # Seeding anew before everything else is built is what makes OMPL repeatable; its log calls that an error, so it is silenced.
    ou.noOutputHandler()
    ou.RNG.setSeed(seed)
    space = ob.RealVectorStateSpace(7)
    bounds = ob.RealVectorBounds(7)
    for k in range(7):
        bounds.setLow(k, float(min(Q_LOWER_RAD[k], q_start[k])))
        bounds.setHigh(k, float(max(Q_UPPER_RAD[k], q_start[k])))
    space.setBounds(bounds)
    info = ob.SpaceInformation(space)
    info.setStateValidityChecker(lambda state: not checks.in_collision(_q_of(state)))
    info.setMotionValidator(_EdgeValidator(info, checks, params.edge_step_rad))
    info.setup()
    problem = ob.ProblemDefinition(info)
    problem.addStartState(_state_of(space, q_start))
    goal = ob.GoalStates(info)
    for q in goals:
        goal.addState(_state_of(space, q))
    problem.setGoal(goal)
    planner = og.RRTConnect(info)
    planner.setRange(params.range_rad)
    planner.setProblemDefinition(problem)
    planner.setup()
    last_check = checks.n_checks + params.max_checks
    # A Python bool: one of numpy raises std::bad_cast, and only once the budget is spent.
    planner.solve(ob.PlannerTerminationCondition(lambda: bool(checks.n_checks >= last_check)))
    if not problem.hasExactSolution():
        return None
    path = problem.getSolutionPath()
    og.PathSimplifier(info).reduceVertices(path, params.n_shorten_steps, params.n_shorten_steps, 0.33)
    return np.array([_q_of(path.getState(k)) for k in range(path.getStateCount())])


def path_samples(waypoints: Float[np.ndarray, "k 7"], step_rad: float) -> Float[np.ndarray, "n 7"]:
    """Configurations along straight joint-space pieces, no joint moving more than `step_rad` between two; waypoints included."""
    pieces = [waypoints[:1]]
    for q_a, q_b in pairwise(waypoints):
        n_steps = max(1, math.ceil(float(np.abs(q_b - q_a).max()) / step_rad))
        pieces.append(q_a + (np.arange(1, n_steps + 1) / n_steps)[:, None] * (q_b - q_a))
    return np.concatenate(pieces)


class _EdgeValidator(ob.MotionValidator):  # type: ignore[misc]
    """Checks whole edges in Python: three times faster than OMPL asking for one state at a time."""

    def __init__(self, info: ob.SpaceInformation, checks: CountedChecks, step_rad: float) -> None:
        super().__init__(info)
        self._checks, self._step_rad = checks, step_rad

    def checkMotion(self, state_a: ob.State, state_b: ob.State) -> bool:
        return self._checks.is_free_edge(_q_of(state_a), _q_of(state_b), self._step_rad)


@lru_cache(maxsize=1024)
def _halving_order(n: int) -> tuple[int, ...]:
    """0, n - 1, the middle, the quarters, ..."""
    order, gaps = ([0, n - 1] if n > 1 else [0]), [(0, n - 1)]
    while gaps:
        wide = [(low, (low + high) // 2, high) for low, high in gaps if high - low > 1]
        order += [middle for _, middle, _ in wide]
        gaps = [gap for low, middle, high in wide for gap in ((low, middle), (middle, high))]
    return tuple(order)


def _q_of(state: ob.State) -> Float[np.ndarray, "7"]:
    return np.array(state[0:7])


def _state_of(space: ob.RealVectorStateSpace, q: Float[np.ndarray, "7"]) -> ob.State:
    state = space.allocState()
    for k in range(7):
        state[k] = float(q[k])
    return state
