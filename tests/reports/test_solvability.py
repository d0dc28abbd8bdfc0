from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import polars as pl
import pyarrow as pa
import pytest

from reports.solvability import solvability_of, solvability_report
from tables import schemas
from tables.store import table_from_columns
from tests.reports.conftest import scores_of


def largest(tables: dict[str, pa.Table], predictions: pa.Table, split: str, seed: int) -> list[tuple[float, bool]]:
    """Largest p_succ of every fixed-target group of a split and whether it holds a success, with dictionaries and loops."""
    in_split = {row["scene_id"] for row in tables["splits"].to_pylist() if row["split"] == split}
    score = scores_of(predictions, "full", seed)
    groups: dict[tuple[str, int], list[tuple[float, bool]]] = {}
    for row in tables["candidates"].to_pylist():
        if row["scene_id"] in in_split:
            own = math.exp(score[row["candidate_id"]]), bool(row["y_pipe"])
            groups.setdefault((row["scene_id"], row["target_id"]), []).append(own)
    return [(max(p for p, _ in group), any(success for _, success in group)) for group in groups.values()]


def test_the_numbers_are_those_of_a_count_by_hand(release_tables: dict[str, pa.Table], predictions: pa.Table) -> None:
    report = solvability_report(release_tables, predictions, tier="pilot", seed=42)
    areas, recalls, lost = [], [], []
    for seed in (42, 43):
        test, known = (largest(release_tables, predictions, split, seed) for split in ("test", "validation"))
        solvable, unsolvable = ([p for p, is_true in test if is_true is kind] for kind in (True, False))
        areas.append(np.mean([(a > b) + (a == b) / 2 for a in solvable for b in unsolvable]))

        def balanced(threshold: float, groups: list[tuple[float, bool]]) -> float:
            shares = [np.mean([(p >= threshold) is kind for p, is_true in groups if is_true is kind]) for kind in (True, False)]
            return float(np.mean(shares))

        p = sorted({p for p, _ in known})
        steps = [p[0], *((a + b) / 2 for a, b in pairwise(p))]
        chosen = max(steps, key=lambda threshold, known=known: balanced(threshold, known))
        recalls.append(np.mean([p >= chosen for p in solvable]))
        lost.append(np.mean([p < chosen for p in unsolvable]))
    name = "test.fixed.ranker.solvability"
    assert report.metrics[f"{name}.auroc"] == pytest.approx(np.mean(areas))
    assert report.metrics[f"{name}.recall_solvable"] == pytest.approx(np.mean(recalls))
    assert report.metrics[f"{name}.recall_unsolvable"] == pytest.approx(np.mean(lost))
    assert report.metrics[f"{name}.balanced_accuracy"] == pytest.approx((np.mean(recalls) + np.mean(lost)) / 2)
    assert (report.metrics[f"{name}.n_solvable"], report.metrics[f"{name}.n_unsolvable"]) == (len(solvable), len(unsolvable))
    for own in ("auroc", "balanced_accuracy", "recall_solvable", "recall_unsolvable"):
        assert report.metrics[f"{name}.{own}_low"] < report.metrics[f"{name}.{own}"] < report.metrics[f"{name}.{own}_high"]
    assert "| paper | 1,896 | 959 | 937 | 97.77 | 94.30 | 94.89 | 93.70 |" in report.markdown


def test_a_ranker_that_knows_nothing_and_one_that_knows_all(release_tables: dict[str, pa.Table]) -> None:
    """The same score for every candidate is worth half; scores that are the labels tell all groups apart."""
    rows = release_tables["candidates"].to_pylist()
    log_p = {"full": [-1.0] * len(rows), "local": [-0.1 if row["y_pipe"] else -3.0 for row in rows]}
    table = table_from_columns(
        schemas.PREDICTIONS,
        {
            "variant": [name for name in log_p for _ in rows],
            "seed": [42] * 2 * len(rows),
            "candidate_id": 2 * [row["candidate_id"] for row in rows],
            "log_p_plan": [value for own in log_p.values() for value in own],
            "log_p_exec": [0.0] * 2 * len(rows),
        },
    )
    metrics = solvability_report(release_tables, table, tier="pilot", seed=42).metrics
    for name in ("auroc", "balanced_accuracy"):
        nothing, everything = f"test.fixed.ranker.solvability.{name}", f"test.fixed.local.solvability.{name}"
        assert metrics[nothing] == 0.5
        assert metrics[f"{nothing}_low"] < 0.5 < metrics[f"{nothing}_high"]
        assert metrics[everything] == metrics[f"{everything}_high"] == 1.0
        assert metrics[f"{everything}_low"] < 1.0, "so few groups do not make it certain"


def test_balanced_accuracy_is_as_unsure_as_the_kind_of_which_there_are_few() -> None:
    """Five unsolvable groups, all recognised: their recall may be anything from 57 %, so the mean of both recalls is no surer than half."""
    labels = np.arange(100) >= 5
    groups = pl.DataFrame({"scene_id": [f"s{k:03d}" for k in range(100)], "best": labels.astype(float), "success": labels})
    own = solvability_of([groups], [groups], 1, "x")
    assert own.balanced_accuracy is not None
    assert own.recall_unsolvable is not None
    assert own.balanced_accuracy.value == 1.0
    assert 1.0 - own.balanced_accuracy.low > 0.49 * (1.0 - own.recall_unsolvable.low) > 0.2
    assert own.area is not None
    assert own.area.low < 0.95
