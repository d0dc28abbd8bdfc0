"""The ceiling is what the best is worth, not what the luckiest got; robust S1 is the mean of the first choices' replicates."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reports.ceiling import ceiling_report, cross_fitted_best
from reports.report import ReportError
from tables import schemas
from tables.identity import parse_candidate_id
from tables.store import table_from_rows
from tests.reports.replicates import replicates_of
from tests.reports.shuffled import backwards

Tables = Mapping[str, pa.Table]


@pytest.mark.parametrize("share", [0.2, 0.7, 0.95])
def test_picking_among_equals_is_worth_what_each_of_them_is(share: float) -> None:
    """Thirty candidates of one probability, five replicates: the largest mean is far above it, the cross-fitted one is not."""
    rng = np.random.default_rng(1)
    groups = rng.random((1500, 30, 5)) < share
    fitted = np.array([cross_fitted_best(group) for group in groups])
    naive = groups.mean(axis=2).max(axis=1)
    assert fitted.mean() == pytest.approx(share, abs=4 * fitted.std() / np.sqrt(len(fitted)))
    assert naive.mean() > share + min(0.04, 0.8 * (1.0 - share))


def test_one_that_is_better_is_found() -> None:
    """One candidate at 0.95 among nineteen at 0.3: the value lies between what a choice of four looks must give and the best."""
    rng = np.random.default_rng(2)
    share = np.array([0.95] + [0.3] * 19)
    fitted = np.mean([cross_fitted_best(rng.random((20, 5)) < share[:, None]) for _ in range(2000)])
    # With four looks: the expected probability of whoever has most successes, ties shared, by simulation of the choice alone.
    looks = rng.binomial(4, share, size=(20000, 20))
    is_best = looks == looks.max(axis=1, keepdims=True)
    expected = ((is_best * share).sum(axis=1) / is_best.sum(axis=1)).mean()
    assert fitted == pytest.approx(expected, abs=0.02)
    assert 0.3 < fitted < 0.95


@given(st.lists(st.lists(st.booleans(), min_size=4, max_size=4), min_size=1, max_size=6))
@settings(max_examples=100, deadline=None)
def test_the_cross_fit_is_as_defined(outcomes: list[list[bool]]) -> None:
    held_out = []
    for k in range(4):
        others = [sum(own[:k] + own[k + 1 :]) for own in outcomes]
        best = [own[k] for own, n in zip(outcomes, others, strict=True) if n == max(others)]
        held_out.append(sum(best) / len(best))
    assert cross_fitted_best(np.array(outcomes)) == pytest.approx(sum(held_out) / 4)


def test_certain_outcomes_have_the_ceiling_of_the_label() -> None:
    assert cross_fitted_best(np.array([[True] * 5, [False] * 5])) == 1.0
    assert cross_fitted_best(np.zeros((3, 5), dtype=bool)) == 0.0
    for wrong in (np.zeros((0, 5), dtype=bool), np.zeros((3, 1), dtype=bool)):
        with pytest.raises(ValueError, match="must be of at least 1 candidate and 2 replicates"):
            cross_fitted_best(wrong)


def test_where_replicates_repeat_the_label_everything_is_s1(release_tables: Tables, predictions: pa.Table) -> None:
    same = replicates_of(release_tables, lambda row: 1.0 if row["y_pipe"] else 0.0)
    metrics = ceiling_report(release_tables, same, predictions, tier="full", seed=42).metrics
    for task in ("joint", "fixed"):
        assert metrics[f"test.{task}.ceiling"] == 1.0
        assert metrics[f"test.{task}.oracle.s1"] == metrics[f"test.{task}.oracle.robust_s1"] == 1.0
        for policy in ("random", "full_planner", "ranker"):
            assert metrics[f"test.{task}.{policy}.robust_s1"] == metrics[f"test.{task}.{policy}.s1"]
            assert metrics[f"test.{task}.{policy}.s1_of_ceiling"] == metrics[f"test.{task}.{policy}.s1"]
    assert (metrics["success_flips"], metrics["failure_flips"]) == (0.0, 0.0)


def test_known_probabilities_give_known_numbers(release_tables: Tables, predictions: pa.Table) -> None:
    """Stored successes hold at 0.8 and failures never succeed: the best is worth 0.8, the oracle too, every policy 0.8 of its S1."""
    uncertain = replicates_of(release_tables, lambda row: 0.8 if row["y_pipe"] else 0.0, n=8)
    report = ceiling_report(release_tables, uncertain, predictions, tier="full", seed=42)
    metrics = report.metrics
    assert metrics["test.fixed.ceiling"] == pytest.approx(0.8, abs=0.05)
    assert metrics["test.fixed.oracle.robust_s1"] == pytest.approx(0.8, abs=0.05)
    assert metrics["test.fixed.ranker.robust_s1"] == pytest.approx(0.8 * metrics["test.fixed.ranker.s1"], abs=0.05)
    assert metrics["test.fixed.ranker.s1_of_ceiling"] == pytest.approx(metrics["test.fixed.ranker.s1"] / metrics["test.fixed.ceiling"])
    assert metrics["test.fixed.ceiling_low"] < 0.8 < metrics["test.fixed.ceiling_high"]
    assert metrics["success_flips"] == pytest.approx(0.2, abs=0.03)
    again = ceiling_report(backwards(release_tables), backwards({"": uncertain})[""], predictions, tier="full", seed=42)
    assert again == report


def test_replicates_of_some_scenes_judge_these_scenes(release_tables: Tables, predictions: pa.Table) -> None:
    rows = replicates_of(release_tables, lambda row: 1.0 if row["y_pipe"] else 0.0).to_pylist()
    scenes = sorted({parse_candidate_id(row["candidate_id"]).scene_id for row in rows})[:10]
    some = table_from_rows(schemas.TEST_REPLICATES, [row for row in rows if parse_candidate_id(row["candidate_id"]).scene_id in scenes])
    report = ceiling_report(release_tables, some, predictions, tier="full", seed=42)
    of_these = {**release_tables, "splits": only_in_test(release_tables["splits"], set(scenes))}
    assert report.metrics == ceiling_report(of_these, some, predictions, tier="full", seed=42).metrics
    assert "in 10 of its 12 scenes, the first in the order of their hash" in report.markdown


def only_in_test(splits: pa.Table, scene_ids: set[str]) -> pa.Table:
    rows = [row | {"split": "test" if row["scene_id"] in scene_ids else "train"} for row in splits.to_pylist()]
    return table_from_rows(schemas.SPLITS, rows)


def test_replicates_of_others_and_missing_ones_are_named(release_tables: Tables) -> None:
    rows = replicates_of(release_tables).to_pylist()
    first = rows[0]["candidate_id"]
    foreign = table_from_rows(schemas.TEST_REPLICATES, [*rows, {**rows[0], "candidate_id": "full-0000-t0-g04"}])
    with pytest.raises(ReportError, match="full-0000-t0-g04 is no planned test candidate"):
        ceiling_report(release_tables, foreign, tier="full", seed=42)
    for left, found in ((rows[5:], 0), (rows[1:], 4)):
        with pytest.raises(ReportError, match=f"{first} has {found} replicates, must have 5 \\(1 candidates have fewer"):
            ceiling_report(release_tables, table_from_rows(schemas.TEST_REPLICATES, left), tier="full", seed=42)
