from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pyarrow as pa
import pytest
from scipy import stats

from reports.repeatability import choose_tasks, repeatability_report
from reports.report import ReportError
from tables import schemas
from tables.identity import rng_for
from tables.store import table_from_rows
from tests.reports.shuffled import backwards

IDS = ["candidate_id", "scene_id", "target_id"]
Row = dict[str, Any]


def attempt(stored: Row, perturbation: str, repeat: int, *, flip: bool = False, replan: bool = False) -> Row:
    """A repeat of a candidate that comes out the same, or with the other execution outcome, or unplanned."""
    row = {"candidate_id": stored["candidate_id"], "perturbation": perturbation, "repeat": repeat}
    exec_status = stored["exec_status"]
    if flip and stored["y_plan"]:
        exec_status = "off_target" if exec_status == "success" else "success"
    plan_status = "no_ik" if replan else stored["plan_status"]
    exec_status = None if replan else exec_status
    plan_matches, exec_matches = plan_status == stored["plan_status"], exec_status == stored["exec_status"]
    row |= {"plan_status": plan_status, "exec_status": exec_status, "final_position_error_m": None, "final_rotation_error_rad": None}
    return row | {"plan_matches": plan_matches, "exec_matches": exec_matches, "is_identical": plan_matches and exec_matches}


def fresh_attempts(tables: dict[str, pa.Table], differs: Callable[[int], dict[str, bool]]) -> pa.Table:
    stored = {row["candidate_id"]: row for row in tables["candidates"].to_pylist()}
    tasks = choose_tasks(tables["candidates"].select(IDS), 42)
    rows = [
        attempt(stored[task.candidate_id], "fresh_process", repeat, **differs(number))
        for number, task in enumerate(tasks)
        for repeat in range(task.n_repeats)
    ]
    return table_from_rows(schemas.ATTEMPTS, rows)


def test_tasks_are_chosen_without_looking(release_tables: dict[str, pa.Table]) -> None:
    candidates = release_tables["candidates"]
    for column in ("y_plan", "y_pipe", "exec_status", "tolerance_margin"):
        with pytest.raises(ReportError, match=f"label column '{column}' is present \\(1 are, must be 0\\)"):
            choose_tasks(candidates.select([*IDS, column]), 42)
    tasks = choose_tasks(candidates.select(IDS), 42)
    assert tasks == choose_tasks(backwards({"": candidates.select(IDS)})[""], 42)
    assert tasks != choose_tasks(candidates.select(IDS), 43)


def test_tasks_are_fifty_groups_with_one_candidate_each_and_fifteen_repeated(release_tables: dict[str, pa.Table]) -> None:
    tasks = choose_tasks(release_tables["candidates"].select(IDS), 42)
    assert len({(task.scene_id, task.target_id) for task in tasks}) == 50
    assert all(task.candidate_id.startswith(f"{task.scene_id}-t{task.target_id}-") for task in tasks)
    assert sum(task.n_repeats for task in tasks) == 80
    assert [task.n_repeats for task in tasks] == [3] * 15 + [1] * 35
    # A scene that is added leaves the order of the others as it is.
    fewer = (
        release_tables["candidates"]
        .select(IDS)
        .filter(pa.compute.not_equal(release_tables["candidates"]["scene_id"].cast("string"), "full-0000"))
    )
    kept = [task.candidate_id for task in choose_tasks(fewer, 42, 1_000)]
    assert kept == [t.candidate_id for t in choose_tasks(release_tables["candidates"].select(IDS), 42, 1_000) if t.scene_id != "full-0000"]


def test_labels_that_repeat_are_reported_with_an_exact_interval(release_tables: dict[str, pa.Table]) -> None:
    report = repeatability_report(fresh_attempts(release_tables, lambda number: {}), release_tables["candidates"], tier="pilot")
    highest = 100 * (1 - 0.025 ** (1 / 50))  # the exact upper end for 0 of 50, in closed form
    assert report.markdown.count(f"| 50/50 | 45/45 | 0/50: 0.0 [0.0, {highest:.1f}] % |") == 5
    assert report.metrics["fresh.n_executions"] == 80.0
    assert all(report.metrics[f"fresh.{stage}.mismatches"] == 0 for stage in ("plan_status", "exec_status", "success", "three_class"))


def test_what_differs_is_counted_by_stage(release_tables: dict[str, pa.Table]) -> None:
    """Task 20, executed once, is not planned in the repeat; every other one is as stored."""
    stored = {row["candidate_id"]: row for row in release_tables["candidates"].to_pylist()}
    tasks = choose_tasks(release_tables["candidates"].select(IDS), 42)
    number = next(n for n, task in enumerate(tasks) if n >= 15 and stored[task.candidate_id]["exec_status"] == "success")
    attempts = fresh_attempts(release_tables, lambda n: {"replan": n == number})
    report = repeatability_report(attempts, release_tables["candidates"], tier="pilot")
    low, high = stats.binomtest(1, 50).proportion_ci(method="exact")
    assert report.markdown.count(f"| 49/50 | 45/45 | 1/50: 2.0 [{100 * low:.1f}, {100 * high:.1f}] % |") == 5


def test_flips_are_placed_by_margin_category_and_perturbation(release_tables: dict[str, pa.Table]) -> None:
    """Labels within 0.1 of the tolerance flip half of the time, others never."""
    planned = [row for row in release_tables["candidates"].to_pylist() if row["y_plan"]][:300]
    rows = []
    n_near = n_flipped = 0
    for row in planned:
        for perturbation in ("hold_0.10s", "friction_+5%"):
            is_near = abs(row["tolerance_margin"]) < 0.1
            flip = is_near and rng_for(1, "flip", row["candidate_id"], perturbation).random() < 0.5
            n_near, n_flipped = n_near + is_near, n_flipped + flip
            rows.append(attempt(row, perturbation, 0, flip=flip))
    attempts = table_from_rows(schemas.ATTEMPTS, rows)
    report = repeatability_report(attempts, release_tables["candidates"], tier="pilot")
    assert 0 < n_flipped < n_near < len(rows)
    assert report.metrics["executed.flip_rate"] == pytest.approx(n_flipped / len(rows))
    stored = {row["candidate_id"]: row["transport_slip_m"] for row in release_tables["candidates"].to_pylist()}
    n_slipping = sum(not row["exec_matches"] and stored[row["candidate_id"]] >= 0.005 for row in rows)
    assert f"Of {n_flipped} flips, {n_slipping} slip 5 mm or more." in report.markdown
    bins = {line.split(" |")[0][2:]: line for line in report.markdown.splitlines() if line.startswith(("| 0", "| from"))}
    assert sum(int(bins[name].split("|")[2]) for name in ("0 to 0.05", "0.05 to 0.1")) == n_near
    assert all(": 0.0 [" in line for name, line in bins.items() if name not in ("0 to 0.05", "0.05 to 0.1"))
    assert "None were made." in report.markdown
    assert report == repeatability_report(backwards({"": attempts})[""], release_tables["candidates"], tier="pilot")


def test_an_attempt_of_nobody_is_an_error(release_tables: dict[str, pa.Table]) -> None:
    attempts = fresh_attempts(release_tables, lambda number: {})
    with pytest.raises(ReportError, match="is no candidate"):
        repeatability_report(attempts, release_tables["candidates"].slice(0, 10), tier="pilot")


def test_an_attempt_that_compares_wrongly_is_an_error(release_tables: dict[str, pa.Table]) -> None:
    rows = fresh_attempts(release_tables, lambda number: {}).to_pylist()
    rows[3]["exec_matches"] = False
    with pytest.raises(ReportError, match=f"{rows[3]['candidate_id']}.*exec_matches False"):
        repeatability_report(table_from_rows(schemas.ATTEMPTS, rows), release_tables["candidates"], tier="pilot")
