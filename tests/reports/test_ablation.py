from __future__ import annotations

import pyarrow as pa
import pytest

from reports.ablation import VARIANTS, ablation_report
from reports.report import ReportError
from reports.success_at_k import success_at_k_report
from tests.reports.shuffled import backwards


def test_variants_are_compared_on_validation_over_their_seeds(release_tables: dict[str, pa.Table], predictions: pa.Table) -> None:
    report = ablation_report(release_tables, predictions, tier="pilot", seed=42)
    assert all(report.metrics[f"{variant}.n_seeds"] == 2.0 for variant in VARIANTS)
    # The noisier the synthetic predictions, the worse: the variant without the object-relative pose was given the most noise.
    assert report.metrics["no_object_relative.fixed.s1"] < min(
        report.metrics[f"{v}.fixed.s1"] for v in VARIANTS if v != "no_object_relative"
    )
    single = [
        success_at_k_report(release_tables, predictions.filter(pa.compute.equal(predictions["seed"], seed)), tier="pilot", seed=42)
        for seed in (42, 43)
    ]
    values = [one.metrics["validation.fixed.ranker.s1"] for one in single]
    assert report.metrics["full.fixed.s1"] == pytest.approx(sum(values) / 2)
    deviation = 100 * abs(values[0] - values[1]) / 2**0.5
    low, high = (100 * report.metrics[f"full.fixed.s1_{end}"] for end in ("low", "high"))
    assert f"{50 * sum(values):.2f} ± {deviation:.2f} [{low:.1f}, {high:.1f}] | 81.05 ± 0.41 |" in report.markdown
    assert report.metrics["full_minus_direct.fixed.s1"] == pytest.approx(
        report.metrics["full.fixed.s1"] - report.metrics["direct.fixed.s1"]
    )
    assert "test split" in report.markdown


def test_variants_that_differ_have_no_letter_in_common(release_tables: dict[str, pa.Table], predictions: pa.Table) -> None:
    """As these very trainings; of two each nobody knows how much others would differ, so nothing does."""
    once = predictions.filter(pa.compute.equal(predictions["seed"], 42))
    report = ablation_report(release_tables, once, tier="pilot", seed=42)
    rows = {
        cells[1].strip(): cells
        for cells in (line.split("|") for line in report.markdown.splitlines() if line.startswith("|") and "±" in line)
    }
    letters = {name: set(cells[8].strip()) for name, cells in rows.items()}  # of fixed S1
    assert "a" in letters["Full hierarchical model"]
    assert not letters["Full hierarchical model"] & letters["Without object-relative pose"]
    assert report.metrics["full.fixed.s1_low"] < report.metrics["full.fixed.s1"] < report.metrics["full.fixed.s1_high"]


def test_one_seed_has_no_deviation_and_a_missing_variant_a_dash(release_tables: dict[str, pa.Table], predictions: pa.Table) -> None:
    rows = [row["seed"] == 42 and row["variant"] != "direct" for row in predictions.to_pylist()]
    report = ablation_report(release_tables, predictions.filter(pa.array(rows)), tier="pilot", seed=42)
    assert "one seed a variant, so no deviation and no conclusion" in report.markdown
    assert "| Direct final-success head | – | – | 83.40 ± 0.88 | – |" in report.markdown
    assert report.metrics["direct.n_seeds"] == 0.0
    assert "direct.fixed.s1" not in report.metrics
    (line,) = [line for line in report.markdown.splitlines() if line.startswith("| Full hierarchical model")]
    assert line.count("±") == 3  # the paper's alone


def test_rows_in_another_order_give_the_same_report(release_tables: dict[str, pa.Table], predictions: pa.Table) -> None:
    report = ablation_report(release_tables, predictions, tier="pilot", seed=42)
    again = ablation_report(backwards(release_tables), backwards({"": predictions})[""], tier="pilot", seed=42)
    assert again == report


def test_nothing_to_compare_is_an_error(release_tables: dict[str, pa.Table], predictions: pa.Table) -> None:
    with pytest.raises(ReportError, match="0 rows of the variants"):
        ablation_report(release_tables, predictions.slice(0, 0), tier="pilot", seed=42)
