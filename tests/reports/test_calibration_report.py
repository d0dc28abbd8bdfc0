from __future__ import annotations

import math

import numpy as np
import pyarrow as pa
import pytest

from reports.calibration import N_BINS
from reports.calibration_report import Judged, calibration_report
from reports.report import Report
from reports.resampling import SceneBootstrap
from reports.temperature import fitted_temperature
from tables import schemas
from tables.store import table_from_rows
from tests.reports.reference import expected_calibration_error


@pytest.fixture(scope="module")
def report(release_tables: dict[str, pa.Table], predictions: pa.Table) -> Report:
    return calibration_report(release_tables, predictions, tier="pilot", seed=42)


def test_a_draw_of_ece_is_that_of_the_candidates_it_holds() -> None:
    """Against repeating the candidates of each draw and binning them anew."""
    rng = np.random.default_rng(0)
    scenes, p = [f"s{k % 12:02}" for k in range(240)], rng.random((2, 240))
    judged, bootstrap = Judged(p, rng.random(240) < p[0], scenes), SceneBootstrap(scenes, 3)
    one = Judged(p[:1], judged.happened, scenes).ece(bootstrap, "x")
    for counts, made in zip(bootstrap.scene_weights[:50, np.arange(240) % 12].astype(int), one.draws, strict=False):
        repeated = np.repeat(np.arange(240), counts)
        assert made == pytest.approx(expected_calibration_error(p[0][repeated], judged.happened[repeated], N_BINS))
    values = [expected_calibration_error(own, judged.happened, N_BINS) for own in p]
    assert judged.ece(bootstrap, "x").value == pytest.approx(np.mean(values))
    assert judged.bins()[2].sum() == 2 * 240


def test_scores_before_and_after_are_those_of_a_count_by_hand(
    report: Report, release_tables: dict[str, pa.Table], predictions: pa.Table
) -> None:
    split = {row["scene_id"]: row["split"] for row in release_tables["splits"].to_pylist()}
    labels = {row["candidate_id"]: row for row in release_tables["candidates"].to_pylist()}
    scores: dict[str, list[float]] = {state: [] for state in ("before", "after")}
    for seed in (42, 43):
        parts: dict[str, list[tuple[list[float], bool, bool]]] = {"validation": [], "test": []}
        for row in predictions.to_pylist():
            own = labels[row["candidate_id"]]
            if (row["variant"], row["seed"]) == ("full", seed) and split[own["scene_id"]] in parts:
                logits = [row[f"log_p_{head}"] - math.log(-math.expm1(row[f"log_p_{head}"])) for head in ("plan", "exec")]
                parts[split[own["scene_id"]]].append((logits, own["y_plan"], bool(own["y_pipe"])))
        known = parts["validation"]
        temperatures = [
            fitted_temperature(np.array([x[0] for x, _, _ in known]), np.array([plan for _, plan, _ in known])),
            fitted_temperature(np.array([x[1] for x, plan, _ in known if plan]), np.array([good for _, plan, good in known if plan])),
        ]
        for head, own_t in zip(("plan", "exec"), temperatures, strict=True):
            assert report.metrics[f"temperature.ranker.{head}_seed_{seed}"] == pytest.approx(own_t, rel=1e-4)
        for state, ts in (("before", (1.0, 1.0)), ("after", temperatures)):
            p = [math.prod(1 / (1 + math.exp(-x / t)) for x, t in zip(logits, ts, strict=True)) for logits, _, _ in parts["test"]]
            scores[state].append(float(np.mean([(own - good) ** 2 for own, (_, _, good) in zip(p, parts["test"], strict=True)])))
    for state, own in scores.items():
        assert report.metrics[f"test.ranker.success.{state}.brier"] == pytest.approx(np.mean(own), rel=1e-4)


def test_scaling_mends_a_head_that_is_too_sure(report: Report, release_tables: dict[str, pa.Table], predictions: pa.Table) -> None:
    """Logits made four times as large ask for a temperature four times as high, and what is scaled is what it was."""
    rows = [row for row in predictions.to_pylist() if row["variant"] == "full"]
    for row in rows:
        for head in ("log_p_plan", "log_p_exec"):
            logit = row[head] - math.log(-math.expm1(row[head]))
            row[head] = -float(np.logaddexp(0.0, -4.0 * logit))
    sure = calibration_report(release_tables, table_from_rows(schemas.PREDICTIONS, rows), tier="pilot", seed=42)
    for head in ("plan", "exec"):
        name = f"temperature.ranker.{head}_seed_42"
        assert sure.metrics[name] == pytest.approx(4.0 * report.metrics[name], rel=1e-3)
        assert sure.metrics[f"test.ranker.{head}.before.brier"] > sure.metrics[f"test.ranker.{head}.after.brier"]
        for measure in ("brier", "brier_low", "brier_high"):
            after = f"test.ranker.{head}.after.{measure}"
            assert sure.metrics[after] == pytest.approx(report.metrics[after], rel=1e-3)


def test_one_temperature_a_head_and_training_is_printed(report: Report) -> None:
    section = report.markdown.split("## Temperatures")[1]
    for seed in (42, 43):
        shown = " | ".join(f"{report.metrics[f'temperature.ranker.{head}_seed_{seed}']:.3f}" for head in ("plan", "exec"))
        assert f"| Paper's ranker | {seed} | {shown} |" in section
    assert {(row["probability"], row["scaling"]) for row in report.tables["calibration-bins"]} == {
        (name, state) for name in ("plan", "exec", "success") for state in ("before", "after")
    }
