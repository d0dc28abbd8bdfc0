"""Laws of path search: paths are free when looked at more finely, repeat to the bit, and keep to their budget."""

from __future__ import annotations

import hashlib
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipelines.engines.planning.collision import CollisionModel
from pipelines.engines.planning.planner import CountedChecks, SearchParams, _halving_order, path_samples, search_path
from pipelines.engines.robot.arm import fk, ik
from tests.builders import can_model, panda_scene, tcp_pose

PARAMS = SearchParams()


def problem() -> tuple[CollisionModel, np.ndarray, np.ndarray]:
    """A carried can from one side of an obstacle to the other; the straight joint path is blocked."""
    object_model = can_model()
    model = CollisionModel(panda_scene(object_model, [(0.5, 0.0), (0.6, -0.2)]), object_model)
    model.attach(np.eye(4), np.array([0.033, 0.033]))
    ends = [tcp_pose((0.5, y, 0.2), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)) for y in (0.25, -0.25)]
    start, goals = ([q for q in ik(T, 32) if not model.in_collision_holding(q)] for T in ends)
    return model, start[0], np.array(goals[:8])


def search_digest(seed: int) -> str:
    model, start, goals = problem()
    checks = CountedChecks(model.in_collision_holding)
    path = search_path(start, goals, checks, PARAMS, seed)
    assert path is not None
    return hashlib.sha256(path.tobytes() + str(checks.n_checks).encode()).hexdigest()


def test_found_paths_join_start_and_goal_and_are_free_ten_times_finer() -> None:
    model, start, goals = problem()
    checks = CountedChecks(model.in_collision_holding)
    assert not any(checks.is_free_edge(start, goal, PARAMS.edge_step_rad) for goal in goals[:1])
    for seed in range(1, 6):
        path = search_path(start, goals, checks, PARAMS, seed)
        assert path is not None
        np.testing.assert_array_equal(path[0], start)
        assert any(np.array_equal(path[-1], goal) for goal in goals)
        assert checks.is_free_path(path_samples(path, PARAMS.edge_step_rad / 10))


def test_a_search_repeats_to_the_bit_after_others_and_in_a_fresh_process() -> None:
    digests = {seed: search_digest(seed) for seed in (3, 1, 2)}
    assert {seed: search_digest(seed) for seed in (1, 2, 3)} == digests
    assert len(set(digests.values())) == 3
    code = "from tests.pipelines.engines.planning.test_planner import search_digest; print(search_digest(2))"
    fresh = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert fresh.stdout.split()[-1] == digests[2]


def test_a_spent_budget_is_none_not_an_error() -> None:
    """The start is walled in by a test that always says yes away from it; OMPL must end by the count."""
    _, start, goals = problem()

    def walled(q: np.ndarray) -> bool:
        return bool(np.abs(q - start).max() > 0.05 and min(np.abs(q - goal).max() for goal in goals) > 0.05)

    checks = CountedChecks(walled)
    params = SearchParams(max_checks=2000)
    assert search_path(start, goals, checks, params, 1) is None
    # The count is looked at between edges; an edge of the range has at most this many configurations.
    assert 2000 <= checks.n_checks <= 2000 + 4 * (params.range_rad / params.edge_step_rad + 2)


@given(st.integers(1, 400))
def test_halving_order_visits_everything_once_and_spreads(n: int) -> None:
    order = _halving_order(n)
    assert sorted(order) == list(range(n))
    assert order[0] == 0
    for k in range(2, n):
        if k & (k - 1) == 0:  # after 2^m + 1 visits no gap is longer than about n / 2^m
            gaps = np.diff(sorted(order[: k + 1]))
            assert gaps.max() <= -(-(n - 1) // k) + 1


def test_an_edge_is_checked_at_least_as_finely_as_asked() -> None:
    asked: list[np.ndarray] = []
    checks = CountedChecks(lambda q: asked.append(q) is not None)
    q_a, q_b = np.zeros(7), np.array([0.3, -0.1, 0, 0, 0, 0, 0.05])
    assert checks.is_free_edge(q_a, q_b, 0.02)
    along = np.sort([q[0] for q in asked])
    assert checks.n_checks == len(asked) == 16
    assert along[0] == 0.0
    assert along[-1] == pytest.approx(0.3)
    assert np.diff(along).max() <= 0.02 + 1e-12


def test_path_samples_keep_waypoints_and_step() -> None:
    waypoints = np.array([np.zeros(7), np.full(7, 0.1), np.linspace(0.0, 0.5, 7)])
    samples = path_samples(waypoints, 0.03)
    assert np.abs(np.diff(samples, axis=0)).max() <= 0.03 + 1e-12
    for q in waypoints:
        assert np.abs(samples - q).max(axis=1).min() < 1e-12


def test_the_problem_starts_where_it_says() -> None:
    """Guards the fixtures: start and goals are 0.5 m apart at the TCP, so no path is trivial."""
    _, start, goals = problem()
    assert np.linalg.norm(fk(start)[:3, 3] - fk(goals[0])[:3, 3]) == pytest.approx(0.5, abs=1e-6)


@pytest.mark.parametrize(("name", "value"), [("edge_step_rad", 0.5), ("max_checks", 0), ("range_rad", -1.0), ("n_shorten_steps", 0)])
def test_impossible_budgets_are_refused(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        SearchParams(**{name: value})
