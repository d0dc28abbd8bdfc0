"""The figures of the front page: the numbers of the report, learned policies where there are any, the same bytes again, small enough."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipelines.engines.physics.phases import Phase
from pipelines.pictures.recording import Moment, Recording
from reports.figures import SERIES
from reports.front_figures import chain_figure, ladder_points_figure
from reports.front_page import FRONT_PICTURES, PICTURES
from reports.front_strip import _moment
from reports.load import Task
from reports.policies import FULL_PLANNER, LOCAL, POLICIES, RANDOM, RANKER, UNLEARNED
from reports.report import ReportError
from reports.standing import S1, random_mean, standings
from tables.vocabulary import Split


def metrics_of(policies: tuple[str, ...]) -> dict[str, float]:
    names = [f"test.{task}.{policy}.s1" for task in Task for policy in policies]
    ends = {"": 0.6, "_low": 0.5, "_high": 0.7}
    return {f"{name}{end}": value for name in names for end, value in ends.items()} | {"test.joint.random.s1_expected": 0.2}


def test_standings_are_those_of_the_metrics_beside_the_paper_s() -> None:
    found = standings(metrics_of(("random", "full_planner", "local", "ranker")))
    assert [standing.policy for standing in found] == [RANDOM, FULL_PLANNER, RANKER, LOCAL]
    planner, local = found[1], found[-1]
    assert planner.s1[Task.JOINT] == S1(60.0, 50.0, 70.0, 72.84)
    assert local.cells() == ["Local ranker", *["60.0 [50.0, 70.0]", "–"] * 2]
    assert random_mean(metrics_of(()), Task.JOINT) == 20.0
    assert random_mean(metrics_of(()), Task.FIXED) is None
    assert standings(metrics_of(("random",)), Split.VALIDATION) == []


def test_a_policy_with_numbers_on_one_task_only_is_left_out() -> None:
    metrics = {name: value for name, value in metrics_of(("random", "ranker")).items() if not name.startswith("test.fixed.ranker")}
    assert [standing.policy for standing in standings(metrics)] == [RANDOM]


def test_the_ladder_is_taller_with_learned_policies_and_equal_for_equal_numbers() -> None:
    means = dict.fromkeys(Task, 20.0)
    some = standings(metrics_of(tuple(policy.name for policy in UNLEARNED)))
    every = standings(metrics_of(tuple(policy.name for policy in POLICIES)))
    assert (len(some), len(every)) == (len(UNLEARNED), len(POLICIES))
    small, large = (ladder_points_figure(own, means, "title") for own in (some, every))
    assert small == ladder_points_figure(some, means, "title")
    assert _height(large) > _height(small)
    assert len(SERIES) >= 3


def _height(png: bytes) -> int:
    return int.from_bytes(png[20:24], "big")


def test_the_chain_shows_the_numbers_and_is_the_same_again() -> None:
    numbers = {"scenes": "1,235 scenes"}
    assert chain_figure(numbers) == chain_figure(numbers) != chain_figure({})


def test_an_execution_that_ended_before_it_let_go_is_refused() -> None:
    class Candidate:
        candidate_id = "full-0000-t0-g00"

    moment = Moment(Phase.TRANSPORT, 0.0, None, None, None, 0.0, 0.0)  # type: ignore[arg-type]
    recording = Recording(None, Candidate(), {"exec_status": "collided"}, (moment,), None)  # type: ignore[arg-type]
    assert _moment(recording, Phase.TRANSPORT, 1.0) is moment
    with pytest.raises(ReportError, match="full-0000-t0-g00: has no phase settle, only transport"):
        _moment(recording, Phase.SETTLE, 1.0)


@pytest.mark.parametrize("name", FRONT_PICTURES)
def test_what_is_in_the_repository_is_a_small_picture(name: str) -> None:
    content = (PICTURES / f"{name}.png").read_bytes()
    assert content.startswith(b"\x89PNG")
    assert len(content) <= 300_000
    assert Path("reports/pictures") == PICTURES.relative_to(Path(__file__).resolve().parents[2])
