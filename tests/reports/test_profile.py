from __future__ import annotations

import pyarrow as pa
import pytest

from reports.profile import profile_report
from reports.report import Report
from tests.reports.shuffled import backwards


@pytest.fixture(scope="module")
def report(release_tables: dict[str, pa.Table]) -> Report:
    return profile_report(release_tables, tier="pilot", seed=42)


def test_sizes_and_statuses_are_counts_of_the_tables(report: Report, release_tables: dict[str, pa.Table]) -> None:
    rows = release_tables["candidates"].to_pylist()
    grasps = release_tables["grasps"].to_pylist()
    n_lifted = sum(row["lift_status"] == "lifted" for row in grasps)
    assert report.metrics["n_candidates"] == len(rows)
    assert report.metrics["lifted_per_scene"] == pytest.approx(n_lifted / 60)
    assert report.metrics["candidates_per_scene"] == pytest.approx(len(rows) / 60)
    n_solved = sum(row["y_plan"] for row in rows)
    assert f"| `solved` | {n_solved:,} ({100 * n_solved / len(rows):.1f} %) |" in report.markdown
    n_failed = sum(row["y_pipe"] is False for row in rows)
    assert f"| *any failure* | {n_failed:,} ({100 * n_failed / n_solved:.1f} %) |" in report.markdown
    mugs = [row for row in rows if row["object_id"] == "mug_01"]
    planned = [row for row in mugs if row["y_plan"]]
    (line,) = [line for line in report.markdown.splitlines() if line.startswith("| `mug_01` |")]
    assert line.endswith(
        f"| {len(mugs):,} | {100 * len(planned) / len(mugs):.1f} % | {100 * sum(row['y_pipe'] for row in planned) / len(planned):.1f} % |"
    )


def test_objects_whose_grasps_rarely_lift_are_named(report: Report, release_tables: dict[str, pa.Table]) -> None:
    lifted: dict[str, list[bool]] = {}
    for row in release_tables["grasps"].to_pylist():
        if row["admission_status"] == "admitted":
            lifted.setdefault(row["object_id"], []).append(row["lift_status"] == "lifted")
    shares = {name: sum(own) / len(own) for name, own in lifted.items()}
    names = [f"`{name}` ({100 * share:.1f} %)" for name, share in sorted(shares.items()) if share < 0.75]
    assert ("Below 75.0 % of admitted grasps lifted: " in report.markdown) == bool(names)
    for name in names:
        assert name in report.markdown


def test_coverage_of_a_part_is_counted_over_its_groups(report: Report, release_tables: dict[str, pa.Table]) -> None:
    asked = {(row["scene_id"], row["target_id"]) for row in release_tables["targets"].to_pylist() if row["resting"] == "lying"}
    held = {(row["scene_id"], row["target_id"]) for row in release_tables["candidates"].to_pylist() if row["y_pipe"]}
    (line,) = [line for line in report.markdown.splitlines() if line.startswith("| target lying |")]
    assert line.split("|")[3].strip().startswith(f"{100 * len(asked & held) / len(asked):.1f} [")
    all_held = len(held) / release_tables["targets"].num_rows
    assert report.metrics["coverage.fixed"] == pytest.approx(all_held)


def test_costs_come_from_the_timings(report: Report, release_tables: dict[str, pa.Table]) -> None:
    n, n_planned = len(release_tables["candidates"]), sum(release_tables["candidates"]["y_plan"].to_pylist())
    # The synthetic planner costs 8 ms a candidate and the execution 120 ms a planned one; endpoint tests make no labels.
    assert report.metrics["candidates_per_core_hour"] == pytest.approx(n / (8.0 * n + 120.0 * n_planned) * 3.6e6)
    assert report.metrics["core_ms.policy_gripper"] == pytest.approx(2.0)
    without = profile_report({k: v for k, v in release_tables.items() if k != "timings"}, tier="pilot", seed=42)
    assert "## Core time\n\nNot measured." in without.markdown


def test_the_paper_stands_beside_and_no_learned_policy_takes_part(report: Report) -> None:
    for figure in ("249,648", "1,235", "97.89", "50.58", "| 15.95 |", "| 59.65 |"):
        assert figure in report.markdown
    assert "Ranker" not in report.markdown
    assert not [name for name in report.metrics if "ranker" in name]


def test_rows_in_another_order_give_the_same_report(report: Report, release_tables: dict[str, pa.Table]) -> None:
    assert profile_report(backwards(release_tables), tier="pilot", seed=42) == report


def test_the_figures_are_pictures(report: Report) -> None:
    assert set(report.figures) == {
        "profile-splits", "profile-funnel", "profile-admission_status", "profile-lift_status", "profile-plan_status", "profile-exec_status",
        "profile-coverage", "profile-ladder",
    }  # fmt: skip
    assert all(png.startswith(b"\x89PNG\r\n") and len(png) > 5_000 for png in report.figures.values())
