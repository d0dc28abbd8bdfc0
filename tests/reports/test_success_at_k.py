from __future__ import annotations

import pyarrow as pa
import pytest

from reports.costs import Costs
from reports.ranking import timing_frame
from reports.report import Report, ReportError
from reports.success_at_k import success_at_k_report
from tables import schemas
from tables.store import table_from_columns, table_from_rows
from tests.reports.conftest import scores_of
from tests.reports.shuffled import backwards


@pytest.fixture(scope="module")
def report(release_tables: dict[str, pa.Table], predictions: pa.Table) -> Report:
    return success_at_k_report(release_tables, predictions, tier="pilot", seed=42)


def by_hand(tables: dict[str, pa.Table], predictions: pa.Table, split: str, seed: int) -> tuple[float, float, int]:
    """Fixed-target S1 of one training of the ranker, coverage and number of covered groups, with dictionaries and loops."""
    in_split = {row["scene_id"] for row in tables["splits"].to_pylist() if row["split"] == split}
    score = scores_of(predictions, "full", seed)
    groups: dict[tuple[str, int], list[tuple[float, bool]]] = {
        (row["scene_id"], row["target_id"]): [] for row in tables["targets"].to_pylist() if row["scene_id"] in in_split
    }
    for row in tables["candidates"].to_pylist():
        if row["scene_id"] in in_split:
            groups[row["scene_id"], row["target_id"]].append((score[row["candidate_id"]], bool(row["y_pipe"])))
    covered = [group for group in groups.values() if any(success for _, success in group)]
    return sum(max(group)[1] for group in covered) / len(covered), len(covered) / len(groups), len(covered)


def test_the_report_states_what_a_count_by_hand_gives(report: Report, release_tables: dict[str, pa.Table], predictions: pa.Table) -> None:
    for split in ("test", "validation"):
        (one, coverage, n_covered), (other, _, _) = (by_hand(release_tables, predictions, split, seed) for seed in (42, 43))
        assert report.metrics[f"{split}.fixed.ranker.s1"] == pytest.approx((one + other) / 2)
        assert report.metrics[f"{split}.fixed.coverage"] == pytest.approx(coverage)
        assert report.metrics[f"{split}.fixed.n_covered"] == n_covered
        assert f"{n_covered} groups" in report.markdown


def test_all_policies_and_the_papers_figures_are_there(report: Report) -> None:
    test_part = report.markdown.split("## Validation split")[0]
    for figures in ("15.95", "20.26", "39.66", "41.81", "72.84", "85.78", "255.746", "0.655", "79.67", "78.45"):
        assert f"| {figures} |" in test_part
    for label in ("Random (hash order)", "IK only", "Detached gripper", "IK + gripper", "Full-pool planner", "Paper's ranker", "Oracle"):
        assert test_part.count(f"\n| {label}") >= 2
    for task in ("joint", "fixed"):
        assert report.metrics[f"test.{task}.oracle.s1"] == 1.0
        assert report.metrics[f"test.{task}.ranker.s1_low"] <= report.metrics[f"test.{task}.ranker.s1"]
        s = [report.metrics[f"test.{task}.ranker.s{k}"] for k in (1, 3, 5)]
        assert s == sorted(s)


def test_the_ranker_is_never_judged_on_what_it_trained_on(report: Report) -> None:
    assert not [name for name in report.metrics if name.startswith("all.") and "ranker" in name]
    assert "all.joint.full_planner.s1" in report.metrics


def test_decision_times_are_measured_or_said_not_to_be(report: Report, release_tables: dict[str, pa.Table], predictions: pa.Table) -> None:
    in_test = _test_scenes(release_tables)
    n_candidates = sum(row["scene_id"] in in_test for row in release_tables["candidates"].to_pylist())
    # The synthetic stages cost 0.4, 2 and 8 ms a candidate.
    assert report.metrics["test.joint.full_planner.decision_ms"] == pytest.approx(8.0 * n_candidates / len(in_test))
    assert report.metrics["test.joint.ik_and_gripper.decision_ms"] == pytest.approx(2.4 * n_candidates / len(in_test))
    assert "test.joint.ranker.decision_ms" not in report.metrics
    assert "| not measured |" in report.markdown
    ids = sorted(in_test)
    timed = table_from_columns(schemas.TIMINGS, {"stage": ["ranker"] * 2, "item_id": ids[:2], "core_ms": [10.0, 20.0]})
    costs = Costs(timing_frame(release_tables, timed), None)
    with_times = success_at_k_report(release_tables, predictions, costs, tier="pilot", seed=42)
    assert with_times.metrics["test.joint.ranker.decision_ms"] == 15.0
    assert "| 0.015 (of 2 groups) |" in with_times.markdown


def test_planning_costs_of_the_test_split_time_the_full_pool_planner_there_alone(release_tables: dict[str, pa.Table]) -> None:
    """As of a light release, which has no timings; the others are said to be unmeasured, and why."""
    in_test = _test_scenes(release_tables)
    ids = [row["candidate_id"] for row in _rows(release_tables) if row["scene_id"] in in_test]
    planning = table_from_columns(schemas.PLANNER_COSTS, {"candidate_id": ids, "core_ms": [float(k % 97) for k in range(len(ids))]})
    costs = Costs(timing_frame({}), planning, planning_machine="a machine")
    light = success_at_k_report(release_tables, None, costs, tier="pilot", seed=42)
    mean_ms = sum(k % 97 for k in range(len(ids))) / len(in_test)
    assert light.metrics["test.joint.full_planner.decision_ms"] == pytest.approx(mean_ms)
    assert [name for name in light.metrics if "decision_ms" in name and name.startswith(("validation", "all"))] == []
    assert "test.joint.ik_only.decision_ms" not in light.metrics
    introduction = light.markdown.split("## ")[0]
    assert "measured on a machine by planning the test candidates again, so of that split alone." in introduction
    assert "Checks of IK and gripper are *not measured*" in introduction
    # What a release itself timed is told of every split, and what was measured again goes before it.
    both = success_at_k_report(release_tables, None, Costs(timing_frame(release_tables), planning), tier="pilot", seed=42)
    assert both.metrics["test.joint.full_planner.decision_ms"] == pytest.approx(mean_ms)
    assert "validation.joint.full_planner.decision_ms" in both.metrics
    assert "*not measured*" not in both.markdown.split("## ")[0]


def test_rows_in_another_order_give_the_same_report(report: Report, release_tables: dict[str, pa.Table], predictions: pa.Table) -> None:
    again = success_at_k_report(backwards(release_tables), backwards({"": predictions})[""], tier="pilot", seed=42)
    assert again.markdown == report.markdown
    assert again.figures == report.figures


def test_without_a_ranker_the_report_says_so(release_tables: dict[str, pa.Table]) -> None:
    report = success_at_k_report(release_tables, tier="pilot", seed=42)
    assert "**No ranker was scored: their rows are missing.**" in report.markdown
    assert not [name for name in report.metrics if "ranker" in name]


def test_few_scenes_are_said_loudly(release_tables: dict[str, pa.Table]) -> None:
    """Three test scenes left of twelve."""
    test = sorted(row["scene_id"] for row in release_tables["splits"].to_pylist() if row["split"] == "test")
    dropped = set(test[3:])
    fewer = {
        name: table.filter(pa.array([row["scene_id"] not in dropped for row in table.to_pylist()]))
        for name, table in release_tables.items()
        if name in ("candidates", "splits", "scenes", "targets")
    }
    report = success_at_k_report(release_tables | fewer, tier="mini", seed=42)
    assert "> **Only 3 scenes with 3 covered groups: the intervals are wide" in report.markdown
    assert report.metrics["test.joint.random.s5_high"] - report.metrics["test.joint.random.s5_low"] > 0.5


def test_a_split_without_a_covered_group_still_reports(release_tables: dict[str, pa.Table], predictions: pa.Table) -> None:
    planned = {"full-0004", "full-0009"}
    lost = [row["scene_id"] in planned or row["scene_id"] not in _test_scenes(release_tables) for row in _rows(release_tables)]
    fewer = release_tables["candidates"].filter(pa.array(lost))
    none = fewer.filter(pa.array([row["scene_id"] not in planned or not row["y_pipe"] for row in fewer.to_pylist()]))
    report = success_at_k_report(release_tables | {"candidates": none}, predictions, tier="pilot", seed=42)
    assert report.metrics["test.joint.coverage"] == 0.0
    assert "test.joint.ranker.s1" not in report.metrics
    assert "10 without any" in report.markdown


def _rows(tables: dict[str, pa.Table]) -> list[dict[str, object]]:
    return list(tables["candidates"].to_pylist())


def _test_scenes(tables: dict[str, pa.Table]) -> set[str]:
    return {row["scene_id"] for row in tables["splits"].to_pylist() if row["split"] == "test"}


def test_candidates_without_a_score_stop_the_report(release_tables: dict[str, pa.Table], predictions: pa.Table) -> None:
    test = _test_scenes(release_tables)
    some = predictions.filter(pa.array([row["candidate_id"][:9] != min(test) for row in predictions.to_pylist()]))
    with pytest.raises(ReportError, match=f"predictions: {min(test)}-t0-g.. has none"):
        success_at_k_report(release_tables, some, tier="pilot", seed=42)


def test_pairs_of_policies_are_compared_with_letters(report: Report) -> None:
    """The ranker, of labels with little noise, differs from a random order and stands above it in every measure."""
    metrics = report.metrics
    for task in ("joint", "fixed"):
        gain = f"test.{task}.ranker_minus_random.s1"
        assert metrics[gain] == pytest.approx(metrics[f"test.{task}.ranker.s1"] - metrics[f"test.{task}.random.s1"])
        assert metrics[f"{gain}_low"] > 0.0
        ranks = [metrics[f"test.{task}.{name}.first_success_rank"] for name in ("ranker", "random")]
        assert metrics[f"test.{task}.ranker_minus_random.first_success_rank"] == pytest.approx(ranks[0] - ranks[1])
        assert 1.0 <= ranks[0] < ranks[1]
    shown = report.markdown.split("| policy | S1 | S1 differs |")[2].split("\n\n")[0].splitlines()[2:]
    letters = {cells[1].strip(): set(cells[3].strip()) for cells in (line.split("|") for line in shown)}
    assert len(letters) == 6
    assert not letters["Paper's ranker"] & letters["Random (hash order)"]


def test_s1_by_stratum_adds_up(report: Report, release_tables: dict[str, pa.Table]) -> None:
    section = report.markdown.split("| covered groups with |")[2].split("\n\n")[0].splitlines()[2:]
    n = {cells[1].strip(): int(cells[2]) for cells in (line.split("|") for line in section)}
    for stratum in ("category", "obstacles", "resting pose"):
        parts = {name: count for name, count in n.items() if name.startswith(stratum)}
        assert len(parts) == 3
        assert sum(parts.values()) == report.metrics["test.fixed.n_covered"]
    column = {"category": "category", "obstacles": "n_obstacles", "resting pose": "resting"}
    for stratum, name in column.items():
        weighted = [
            count * report.metrics[f"test.fixed.ranker.{name}_{label.removeprefix(stratum).strip()}.s1"]
            for label, count in n.items()
            if label.startswith(stratum)
        ]
        assert sum(weighted) == pytest.approx(report.metrics["test.fixed.n_covered"] * report.metrics["test.fixed.ranker.s1"])


def test_every_learned_policy_with_predictions_has_its_rows(release_tables: dict[str, pa.Table], predictions: pa.Table) -> None:
    rows = [row | {"variant": {"full": "local", "direct": "trees"}.get(row["variant"], row["variant"])} for row in predictions.to_pylist()]
    report = success_at_k_report(release_tables, table_from_rows(schemas.PREDICTIONS, rows), tier="pilot", seed=42)
    for policy in ("local", "trees"):
        assert f"test.fixed.{policy}.s1_low" in report.metrics
    assert "test.fixed.ranker.s1" not in report.metrics
    assert "test.fixed.trees_minus_local.s1" in report.metrics
    assert "**The paper's ranker was not scored: its rows are missing.**" in report.markdown
    assert "by seed: Local ranker 42, 43; Trees, derived geometry 42, 43." in report.markdown
