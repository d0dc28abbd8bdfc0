from __future__ import annotations

import pyarrow as pa
import pytest

from reports.learning_curve import learning_curve_report, learning_curve_table
from reports.report import ReportError
from reports.success_at_k import success_at_k_report
from tables import schemas
from tables.store import table_from_rows


def of(predictions: pa.Table, variant: str, seed: int | None = None) -> pa.Table:
    """Predictions of a variant as those of the ranker."""
    rows = [row for row in predictions.to_pylist() if row["variant"] == variant and seed in (None, row["seed"])]
    return table_from_rows(schemas.PREDICTIONS, [row | {"variant": "full"} for row in rows])


@pytest.fixture(scope="module")
def curve(release_tables: dict[str, pa.Table], predictions: pa.Table) -> pa.Table:
    """The more scenes, the less noise."""
    by_size = {9: [of(predictions, "no_object_relative")], 36: [of(predictions, "full", 42), of(predictions, "full", 43)]}
    return learning_curve_table(by_size, release_tables["candidates"], release_tables["splits"])


def test_the_table_holds_the_validation_split_alone(curve: pa.Table, release_tables: dict[str, pa.Table], predictions: pa.Table) -> None:
    known = {row["scene_id"] for row in release_tables["splits"].to_pylist() if row["split"] == "validation"}
    ids = sorted(row["candidate_id"] for row in release_tables["candidates"].to_pylist() if row["scene_id"] in known)
    rows = curve.to_pylist()
    for n in (9, 36):
        for seed in (42, 43):
            assert [row["candidate_id"] for row in rows if (row["n_train_scenes"], row["seed"]) == (n, seed)] == ids
    stored = {(row["seed"], row["candidate_id"]): row for row in of(predictions, "full").to_pylist()}
    assert all(
        row[name] == stored[row["seed"], row["candidate_id"]][name]
        for row in rows
        if row["n_train_scenes"] == 36
        for name in ("log_p_plan", "log_p_exec")
    )


def test_a_point_is_what_the_other_report_says_of_the_same_predictions(
    curve: pa.Table, release_tables: dict[str, pa.Table], predictions: pa.Table
) -> None:
    made = learning_curve_report(release_tables, curve, tier="pilot", seed=42)
    for n, variant in ((9, "no_object_relative"), (36, "full")):
        alone = success_at_k_report(release_tables, of(predictions, variant), tier="pilot", seed=42).metrics
        for task in ("joint", "fixed"):
            for end in ("", "_low", "_high"):
                name = f"validation.{task}"
                assert made.metrics[f"{name}.full.n{n}.s1{end}"] == pytest.approx(alone[f"{name}.ranker.s1{end}"])
    assert len(made.tables["learning_curve-trainings"]) == 2 * 2 * 2
    assert "| Paper's ranker | 9 | 25 % | 2 |" in made.markdown
    for task in ("joint", "fixed"):
        # Two sizes two doublings apart.
        rise = made.metrics[f"validation.{task}.full.n36.s1"] - made.metrics[f"validation.{task}.full.n9.s1"]
        slope = f"validation.{task}.full.s1_of_twice_the_scenes"
        assert made.metrics[slope] == pytest.approx(rise / 2)
        assert made.metrics[f"{slope}_low"] <= made.metrics[slope] <= made.metrics[f"{slope}_high"]
    assert "test.fixed" not in " ".join(made.metrics)


def test_sizes_that_cannot_be_and_lost_candidates_are_refused(curve: pa.Table, release_tables: dict[str, pa.Table]) -> None:
    rows = curve.to_pylist()
    for n in (0, 37):
        wrong = table_from_rows(schemas.LEARNING_CURVE, [row | {"n_train_scenes": n} for row in rows if row["n_train_scenes"] == 9])
        with pytest.raises(ReportError, match=f"learning_curve: full of {n} scenes, must be in .1, 36."):
            learning_curve_report(release_tables, wrong, tier="pilot", seed=42)
    with pytest.raises(ReportError, match="learning_curve: 0 rows"):
        learning_curve_report(release_tables, curve.slice(0, 0), tier="pilot", seed=42)
    with pytest.raises(ReportError, match="has none"):
        learning_curve_report(release_tables, curve.slice(1), tier="pilot", seed=42)
