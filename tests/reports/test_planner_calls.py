from __future__ import annotations

from dataclasses import replace

import numpy as np
import polars as pl
import pyarrow as pa
import pytest

from pipelines.frames import frame_of
from reports.costs import Costs
from reports.decision_times import decision_time_rows
from reports.load import Task
from reports.planner_calls import Stop, planned_in_order, planner_calls_report
from reports.planner_costs import planner_costs
from reports.ranking import timing_frame
from reports.report import Report, ReportError
from tables import schemas
from tables.store import table_from_columns
from tests.reports.conftest import scores_of

TIMED = {"ranker": 50.0, "local": 10.0}


@pytest.fixture(scope="module")
def times(release_tables: dict[str, pa.Table]) -> pa.Table:
    """Decision times of the joint groups of the test split."""
    scenes = [row["scene_id"] for row in release_tables["splits"].to_pylist() if row["split"] == "test"]
    return table_from_columns(
        schemas.TIMINGS,
        {"stage": ["ranker"] * len(scenes), "item_id": scenes, "core_ms": [TIMED["ranker"]] * len(scenes)},
    )


def costs_of(tables: dict[str, pa.Table], times: pa.Table) -> Costs:
    """Every candidate's planning takes another time."""
    ids = sorted(tables["candidates"]["candidate_id"].to_pylist())
    planning = table_from_columns(schemas.PLANNER_COSTS, {"candidate_id": ids, "core_ms": [float(k % 97 + 1) for k in range(len(ids))]})
    return Costs(timing_frame({}, times), planning, "a machine")


@pytest.fixture(scope="module")
def report(release_tables: dict[str, pa.Table], predictions: pa.Table, times: pa.Table) -> Report:
    return planner_calls_report(release_tables, predictions, costs_of(release_tables, times), tier="pilot", seed=42)


def test_the_seconds_of_a_group_made_by_hand() -> None:
    """Four candidates of 1, 2, 4 and 8 s: the second has the first plan, the third the first success; the other group has neither."""
    ordered = pl.DataFrame(
        {
            "scene_id": ["a"] * 4 + ["b"] * 2,
            "rank": [1, 2, 3, 4, 1, 2],
            "y_plan": [False, True, True, True, False, False],
            "success": [False, False, True, False, False, False],
            "planning_s": [1.0, 2.0, 4.0, 8.0, 16.0, 32.0],
        }
    )
    a, b = planned_in_order(ordered[::-1], Task.JOINT).iter_rows(named=True)
    assert a == {
        "scene_id": "a", "first_plan": 2, "first_success": 3, "n_candidates": 4,
        "first_plan_s": 3.0, "first_success_s": 7.0, "any_s": 3.0, "everything_s": 15.0,
    }  # fmt: skip
    assert b == {
        "scene_id": "b", "first_plan": None, "first_success": None, "n_candidates": 2,
        "first_plan_s": None, "first_success_s": None, "any_s": 48.0, "everything_s": 48.0,
    }  # fmt: skip


def test_calls_and_seconds_of_the_ranker_are_those_of_a_count_by_hand(
    report: Report, release_tables: dict[str, pa.Table], predictions: pa.Table, times: pa.Table
) -> None:
    test = {row["scene_id"] for row in release_tables["splits"].to_pylist() if row["split"] == "test"}
    planning = {row["candidate_id"]: row["core_ms"] / 1e3 for row in costs_of(release_tables, times).planning.to_pylist()}
    calls, until_plan, until_end, everything = [], [], [], []
    for seed in (42, 43):
        score = scores_of(predictions, "full", seed)
        groups: dict[str, list[tuple[float, bool, float]]] = {}
        for row in release_tables["candidates"].to_pylist():
            if row["scene_id"] in test:
                own = score[row["candidate_id"]], row["y_plan"], planning[row["candidate_id"]]
                groups.setdefault(row["scene_id"], []).append(own)
        for group in groups.values():
            order = sorted(group, reverse=True)
            first = next((k for k, (_, has_plan, _) in enumerate(order, 1) if has_plan), None)
            everything.append(sum(s for _, _, s in group))
            until_end.append(sum(s for _, _, s in order[:first]))
            calls += [] if first is None else [first]
            until_plan += [] if first is None else [until_end[-1]]
    metrics, name = report.metrics, "test.joint.ranker"
    assert metrics[f"{name}.calls"] == pytest.approx(np.mean(calls))
    assert metrics[f"{name}.calls_median"] == np.median(calls)
    assert metrics[f"{name}.first_plan.planning_s"] == pytest.approx(np.mean(until_plan))
    assert metrics[f"{name}.decision_s"] == TIMED["ranker"] / 1e3
    assert metrics[f"{name}.first_plan.total_s"] == pytest.approx(np.mean(until_plan) + TIMED["ranker"] / 1e3)
    assert metrics["test.joint.any.everything_s"] == pytest.approx(np.mean(everything))
    assert metrics[f"{name}.any.speed_up"] == pytest.approx(np.mean(everything) / (np.mean(until_end) + TIMED["ranker"] / 1e3))
    assert metrics[f"{name}.any.speed_up_low"] < metrics[f"{name}.any.speed_up"] < metrics[f"{name}.any.speed_up_high"]
    gain = "test.joint.random_minus_ranker.calls"
    assert metrics[gain] == pytest.approx(metrics["test.joint.random.calls"] - metrics[f"{name}.calls"])
    counted = [row for row in report.tables["planner_calls-distribution"] if (row["task"], row["policy"]) == ("joint", "ranker")]
    assert sum(row["calls"] * row["n_groups"] for row in counted) == sum(calls)


def test_an_order_never_plans_more_than_everything_nor_stops_later_for_a_plan_than_for_a_success(report: Report) -> None:
    for task in Task:
        for policy in ("random", "ik_only", "ranker"):
            own = {stop: report.metrics[f"test.{task.value}.{policy}.{stop.key}.planning_s"] for stop in Stop}
            assert own[Stop.END] <= report.metrics[f"test.{task.value}.any.everything_s"]
    assert "test.fixed.ranker.first_plan.total_s" not in report.metrics, "no fixed group was timed"
    assert "| Paper's ranker | not timed |" in report.markdown
    assert "measured on **a machine**" in report.markdown
    assert "handed to it, measured when the labels were made; nothing" in report.markdown
    for figure in ("1.17", "1.47"):
        assert f"| {figure} |" in report.markdown


def test_without_planning_costs_calls_are_printed_and_what_is_missing_is_said(
    release_tables: dict[str, pa.Table], predictions: pa.Table, report: Report
) -> None:
    bare = planner_calls_report(
        release_tables, predictions, Costs(timing_frame({}), None, why_no_planning="no file"), tier="pilot", seed=42
    )
    assert "Not known: no file." in bare.markdown
    assert not [name for name in bare.metrics if name.endswith("_s")]
    assert {name: value for name, value in report.metrics.items() if "calls" in name} == {
        name: value for name, value in bare.metrics.items() if "calls" in name
    }


def test_planning_that_was_measured_again_says_where(release_tables: dict[str, pa.Table], times: pa.Table) -> None:
    again = replace(costs_of(release_tables, times), planning_machine="another machine")
    made = planner_calls_report(release_tables, None, again, tier="pilot", seed=42)
    assert "handed to it, measured on another machine by planning the test candidates again; nothing" in made.markdown
    assert "when the labels were made" not in made.markdown


def test_costs_are_those_of_the_planning_stage_and_of_every_candidate(release_tables: dict[str, pa.Table], times: pa.Table) -> None:
    made = planner_costs(release_tables["timings"], release_tables["candidates"])
    # The synthetic planner costs 8 ms a candidate.
    assert set(made["core_ms"].to_pylist()) == {8.0}
    assert made["candidate_id"].to_pylist() == sorted(release_tables["candidates"]["candidate_id"].to_pylist())
    last = release_tables["timings"].filter(pa.compute.not_equal(release_tables["timings"]["item_id"], made["candidate_id"][0]))
    with pytest.raises(ReportError, match=f"timings: {made['candidate_id'][0]} has no row of stage planning_labels"):
        planner_costs(last, release_tables["candidates"])
    few = Costs(timing_frame({}, times), made.slice(0, 3))
    with pytest.raises(ReportError, match=r"planner_costs: .* has no row"):
        planner_calls_report(release_tables, None, few, tier="pilot", seed=42)


def test_decision_times_are_told_by_size_of_the_group(release_tables: dict[str, pa.Table]) -> None:
    candidates = frame_of(release_tables["candidates"], ["scene_id", "target_id"])
    sizes = dict(candidates.group_by("scene_id").agg(pl.len()).iter_rows())
    rows = {"stage": ["local"] * len(sizes), "item_id": list(sizes), "core_ms": [float(n) for n in sizes.values()]}
    made = decision_time_rows(candidates, pl.DataFrame(rows))
    assert {(row["task"], row["policy"]) for row in made} == {("joint", "local")}
    assert sum(int(str(row["n_groups"])) for row in made) == len(sizes)
    for row in made:
        low, _, high = str(row["size"]).partition(" to ")
        assert int(low) <= row["mean_candidates"] <= int(high)
        assert row["mean_ms"] == row["mean_candidates"]
