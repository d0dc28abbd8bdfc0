"""The audit report: counts, exact intervals and names of what disagrees; audits that do not fit the labels are refused."""

from __future__ import annotations

from typing import Any

import pyarrow as pa
import pytest
from scipy import stats

from reports.audit import N_LISTED, audit_report
from reports.report import ReportError
from tables import schemas
from tables.store import table_from_rows
from tests.reports.shuffled import backwards

Row = dict[str, Any]


def audited(stored: Row, *, depth_m: float | None = None, finds: str | None = None) -> Row:
    """An audit of a candidate: its path with this overlap, or its rejection, which holds unless another status is found."""
    status = stored["plan_status"]
    is_path = status == "solved"
    kind = "path_geometry" if is_path else "search_budget" if status == "budget_spent" else "rejection"
    depth_m = -0.004 if depth_m is None else depth_m
    return {
        "candidate_id": stored["candidate_id"],
        "audit": kind,
        "stored_status": status,
        "audited_status": None if is_path else finds or status,
        "depth_m": depth_m if is_path else None,
        "deepest_pair": "transport: object / table" if is_path else None,
        "clearance_m": 0.003 - max(0.0, depth_m) if is_path else None,
        "n_configurations": 600,
        "agrees": depth_m <= 0.001 if is_path else finds != "solved",
    }


def by_status(release_tables: dict[str, pa.Table]) -> dict[str, list[Row]]:
    groups: dict[str, list[Row]] = {}
    for row in release_tables["candidates"].to_pylist():
        groups.setdefault(row["plan_status"], []).append(row)
    return groups


def rejected_status(groups: dict[str, list[Row]]) -> str:
    return max((status for status in groups if status not in ("solved", "budget_spent")), key=lambda status: len(groups[status]))


def test_labels_that_hold_are_reported_with_exact_intervals(release_tables: dict[str, pa.Table]) -> None:
    groups = by_status(release_tables)
    reason = rejected_status(groups)
    rows = [audited(row) for row in [*groups["solved"][:500], *groups[reason][:50]]]
    audits = table_from_rows(schemas.AUDITS, rows)
    report = audit_report(audits, release_tables["candidates"], tier="pilot")
    for n in (500, 50):
        highest = 100 * (1 - 0.025 ** (1 / n))  # the exact upper end for 0 of n, in closed form
        assert f"| {n} | 0 | 0.0 [0.0, {highest:.1f}] % |" in report.markdown
    assert report.metrics["path_geometry.n"] == 500
    assert report.metrics["path_geometry.disagreements"] == 0
    assert report.metrics["path_geometry.configurations"] == 300_000
    assert report.metrics["path_geometry.deepest_mm"] == pytest.approx(-4.0)
    assert report.metrics["path_geometry.least_clearance_mm"] == pytest.approx(3.0)
    assert report.metrics["rejection.weighted_flip_rate"] == 0.0
    assert "disagree." not in report.markdown
    assert report == audit_report(backwards({"": audits})[""], release_tables["candidates"], tier="pilot")


def test_overlaps_and_flips_are_counted_and_named(release_tables: dict[str, pa.Table]) -> None:
    """One path 2.5 mm deep, one a mere touch, 3 of 40 rejections flip, 2 have another reason."""
    groups = by_status(release_tables)
    reason = rejected_status(groups)
    solved, rejected = groups["solved"][:100], groups[reason][:40]
    rows = [audited(row, depth_m={7: 0.0025, 8: 0.0004}.get(k)) for k, row in enumerate(solved)]
    other = next(status for status in ("no_ik", "ik_in_collision") if status != reason)
    rows += [audited(row, finds="solved" if k < 3 else other if k < 5 else None) for k, row in enumerate(rejected)]
    report = audit_report(table_from_rows(schemas.AUDITS, rows), release_tables["candidates"], tier="pilot")
    assert report.metrics["path_geometry.disagreements"] == 1
    assert report.metrics["path_geometry.deepest_mm"] == pytest.approx(2.5)
    assert report.metrics[f"rejection.{reason}.flips"] == 3
    low, high = stats.binomtest(3, 40).proportion_ci(method="exact")
    population = len(groups[reason])
    assert f"| `{reason}` | {population:,} | 40 | 3 | 7.5 [{100 * low:.1f}, {100 * high:.1f}] % | 2 |" in report.markdown
    assert report.metrics["rejection.weighted_flip_rate"] == pytest.approx(3 / 40)
    assert "1 disagree." in report.markdown
    assert "3 disagree." in report.markdown
    for row in (solved[7], *rejected[:3]):
        assert f"| {row['candidate_id']} |" in report.markdown
    # The touch is listed with its depth, but does not disagree.
    assert f"| {solved[8]['candidate_id']} | transport: object / table | 0.40 |" in report.markdown
    line = next(line for line in report.markdown.splitlines() if line.startswith("| all |"))
    assert [cell.strip() for cell in line.split("|")[2:4]] == ["100", "1"]
    assert [cell.strip() for cell in line.split("|")[5:-1]] == ["2", "60,000", "2.50", "0.50"]


def test_flips_are_weighted_by_how_often_their_reason_is_given(release_tables: dict[str, pa.Table]) -> None:
    groups = by_status(release_tables)
    first, second = sorted((s for s in groups if s not in ("solved", "budget_spent")), key=lambda s: -len(groups[s]))[:2]
    assert len(groups[first]) != len(groups[second])
    rows = [audited(row, finds="solved") for row in groups[second][:10]] + [audited(row) for row in groups[first][:10]]
    report = audit_report(table_from_rows(schemas.AUDITS, rows), release_tables["candidates"], tier="pilot")
    expected = len(groups[second]) / (len(groups[first]) + len(groups[second]))
    assert report.metrics["rejection.weighted_flip_rate"] == pytest.approx(expected)


def test_a_long_list_is_cut(release_tables: dict[str, pa.Table]) -> None:
    rows = [audited(row, depth_m=0.002) for row in by_status(release_tables)["solved"][:30]]
    report = audit_report(table_from_rows(schemas.AUDITS, rows), release_tables["candidates"], tier="pilot")
    assert f"30 disagree. The first {N_LISTED}:" in report.markdown
    named = sum(f"| {row['candidate_id']} | `solved` |" in report.markdown for row in rows)
    assert named == N_LISTED


def test_no_audits_are_no_rates(release_tables: dict[str, pa.Table]) -> None:
    report = audit_report(table_from_rows(schemas.AUDITS, []), release_tables["candidates"], tier="mini")
    assert report.markdown.count("None were made.") == 2
    assert report.metrics["path_geometry.n"] == 0


def test_an_audit_of_nobody_or_of_another_label_is_an_error(release_tables: dict[str, pa.Table]) -> None:
    candidates = release_tables["candidates"]
    rows = [audited(row) for row in candidates.to_pylist()[:20]]
    with pytest.raises(ReportError, match="is no candidate"):
        audit_report(table_from_rows(schemas.AUDITS, rows), candidates.slice(10), tier="pilot")
    wrong = dict(rows[3], stored_status="start_in_collision")
    with pytest.raises(ReportError, match=f"{wrong['candidate_id']} was audited as start_in_collision, but is stored as"):
        audit_report(table_from_rows(schemas.AUDITS, [wrong]), candidates, tier="pilot")
