"""The probe's numbers against counts by hand, and its command on a whole release."""

from __future__ import annotations

import json
from pathlib import Path

import pyarrow as pa
import pytest

from model.features import CANDIDATE_GEOMETRY
from reports import trees_probe
from reports.report import Report
from reports.trees_probe import trees_probe_report
from splits.release import write_release
from tables.identity import rng_for
from tables.schemas import PREDICTIONS
from tables.store import read_table, table_from_columns
from tests.model.synthetic_release import RELEASE_SCHEMAS, TOLERANCES, write_synthetic_release
from tests.reports.conftest import scores_of
from tests.reports.shuffled import backwards
from tests.splits.damage import PROVENANCE


def predicted(tables: dict[str, pa.Table], seed: int) -> pa.Table:
    """Trees that know every label, and trees on raw poses that know it the wrong way round."""
    rows = tables["candidates"].to_pylist()
    columns: dict[str, list[object]] = {name: [] for name in PREDICTIONS.names}
    for variant, sign in (("trees", 1.0), ("trees_poses", -1.0)):
        for row in rows:
            log_p_plan, log_p_exec = (-1.0 - sign * (0.5 if label else -0.5) for label in (not row["y_plan"], not row["y_pipe"]))
            values = (variant, seed, row["candidate_id"], log_p_plan, log_p_exec)
            for name, value in zip(PREDICTIONS.names, values, strict=True):
                columns[name].append(value)
    return table_from_columns(PREDICTIONS, columns)


@pytest.fixture(scope="module")
def report(release_tables: dict[str, pa.Table]) -> Report:
    return trees_probe_report(release_tables, predicted(release_tables, 42), split="test", seed=42, title="Trees")


def test_knowing_everything_is_best_and_knowing_it_wrongly_worst(report: Report) -> None:
    for name in ("joint", "fixed", "fixed_hard"):
        assert report.metrics[f"{name}.trees.s1"] == 1.0
    assert report.metrics["fixed.trees_poses.s1"] < report.metrics["fixed.random.s1"] < report.metrics["fixed.full_planner.s1"] < 1.0
    for head in ("plan", "exec", "exec_within"):
        assert report.metrics[f"trees.auroc_{head}"] == 1.0
        assert report.metrics[f"trees_poses.auroc_{head}"] == 0.0
    assert "the first choice of the trees fails in 0.0 [" in report.markdown
    gain = report.metrics["fixed.trees_minus_full_planner.s1"]
    assert gain == pytest.approx(1.0 - report.metrics["fixed.full_planner.s1"])


def test_scores_are_judged_as_a_count_by_hand_does(release_tables: dict[str, pa.Table]) -> None:
    known = predicted(release_tables, 42)
    noise = rng_for(1, "trees-probe-test").normal(size=known.num_rows)
    noisy = table_from_columns(PREDICTIONS, {name: known[name] for name in PREDICTIONS.names} | {"log_p_exec": noise})
    score = scores_of(noisy, "trees", 42)
    in_validation = {row["scene_id"] for row in release_tables["splits"].to_pylist() if row["split"] == "validation"}
    groups: dict[tuple[str, int], list[tuple[float, bool]]] = {}
    for row in release_tables["candidates"].to_pylist():
        if row["scene_id"] in in_validation:
            groups.setdefault((row["scene_id"], row["target_id"]), []).append((score[row["candidate_id"]], bool(row["y_pipe"])))
    covered = [group for group in groups.values() if any(success for _, success in group)]
    hard = [group for group in covered if sum(success for _, success in group) in (1, 2)]
    assert 0 < len(hard) < len(covered)

    report = trees_probe_report(release_tables, noisy, split="validation", seed=42, title="Trees")
    for name, own in (("fixed", covered), ("fixed_hard", hard)):
        assert report.metrics[f"{name}.trees.s1"] == pytest.approx(sum(max(group)[1] for group in own) / len(own))
    assert f"{len(hard)} fixed groups have 1 or 2 successes." in report.markdown


def test_the_order_of_rows_means_nothing(report: Report, release_tables: dict[str, pa.Table]) -> None:
    reversed_tables = backwards({**release_tables, "predictions": predicted(release_tables, 42)})
    again = trees_probe_report(reversed_tables, reversed_tables.pop("predictions"), split="test", seed=42, title="Trees")
    assert again == report


def test_the_command_reports_a_release(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = write_synthetic_release(tmp_path / "made", n_scenes=10, seed=1, n_points=40)
    tables = {schema.name: read_table(schema, made / f"{schema.name}.parquet") for schema in RELEASE_SCHEMAS}
    write_release(tables, tmp_path / "release", "pilot", "0.1.0", PROVENANCE, TOLERANCES)
    assert trees_probe.main([str(tmp_path / "release"), "--cross-validate", "2", "--out", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr().out
    assert (tmp_path / "out" / "trees_probe.md").read_text() in printed
    n_candidates = tables["candidates"].num_rows
    assert read_table(CANDIDATE_GEOMETRY, tmp_path / "out" / "candidate_geometry.parquet", verify=True).num_rows == n_candidates
    scores = read_table(PREDICTIONS, tmp_path / "out" / "predictions.parquet", verify=True)
    metrics = json.loads((tmp_path / "out" / "trees_probe.json").read_text())
    again = trees_probe_report(tables, scores, split="all", seed=42, title="Trees")
    assert metrics == again.metrics
    # Labels of the synthetic release follow from where the hand is: geometry names it, and raw poses do not.
    assert metrics["trees.auroc_plan"] > 0.9


def test_a_folder_that_is_no_release_is_refused_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert trees_probe.main([str(tmp_path), "--out", str(tmp_path / "out")]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ")
    assert not (tmp_path / "out").exists()
