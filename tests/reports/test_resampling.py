"""Resampled means, differences, ratios and areas agree with what they are defined as, and say as often as they should that two differ."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reports.metrics import auroc, proportion
from reports.resampling import SceneBootstrap, auroc_draws, paired_difference, pairs_that_differ

SCENES = [f"s{k // 4:03d}" for k in range(160)]


def test_a_paired_difference_is_narrower_than_its_parts() -> None:
    rng = np.random.default_rng(3)
    scenes = [f"s{k // 4:03d}" for k in range(160)]
    base = np.repeat(rng.random(40) < 0.5, 4)
    better = base | (rng.random(160) < 0.3)
    gain, part = paired_difference(better, base, scenes, 1), proportion(better, scenes)
    assert gain is not None
    assert part is not None
    assert gain.value == pytest.approx(better.mean() - base.mean())
    assert 0.0 < gain.low < gain.value < gain.high
    assert gain.high - gain.low < part.high - part.low
    assert paired_difference(better[:8], base[:8], scenes[:8], 1) is None
    assert paired_difference(better[::-1], base[::-1], scenes[::-1], 1) == gain


def test_a_difference_of_equal_policies_is_exactly_nothing() -> None:
    bootstrap = SceneBootstrap(SCENES, 1)
    hits = np.random.default_rng(0).random(160) < 0.5
    gain = (bootstrap.mean(hits) - bootstrap.mean(hits)).estimate()
    assert (gain.value, gain.low, gain.high) == (0.0, 0.0, 0.0)


def test_trainings_are_drawn_too_and_not_alike_for_two_policies() -> None:
    """Trainings that hit everything or nothing: of two, a mean over a draw of them is 0, 1/2 or 1."""
    bootstrap = SceneBootstrap(SCENES, 1)
    rows = np.stack([np.ones(160), np.zeros(160)])
    one, other = bootstrap.mean(rows, "one"), bootstrap.mean(rows, "other")
    assert set(one.draws) == {0.0, 0.5, 1.0}
    assert np.mean(one.draws == 0.5) == pytest.approx(0.5, abs=0.04)
    assert abs(np.corrcoef(one.draws, other.draws)[0, 1]) < 0.06
    assert np.array_equal(one.draws, bootstrap.mean(rows, "one").draws)


@given(st.lists(st.tuples(st.integers(0, 4), st.booleans(), st.integers(0, 3)), min_size=2, max_size=20))
@settings(max_examples=60, deadline=None)
def test_an_area_is_that_of_the_metric_and_its_draws_are_of_whole_scenes(units: list[tuple[int, bool, int]]) -> None:
    scores, labels = np.array([unit[0] for unit in units], dtype=float), np.array([unit[1] for unit in units])
    scenes = [f"s{unit[2]}" for unit in units]
    bootstrap = SceneBootstrap(scenes, 3)
    area = auroc_draws(scores, labels, bootstrap)
    assert (area is None) == (auroc(scores, labels) is None)
    if area is None:
        return
    assert area.value == pytest.approx(auroc(scores, labels))
    expected = []
    for weights in bootstrap.unit_weights[:50].astype(int):
        drawn = auroc(np.repeat(scores, weights), np.repeat(labels, weights))
        expected += [] if drawn is None else [drawn]
    assert area.draws[: len(expected)] == pytest.approx(expected)


def test_a_ratio_is_of_the_same_draws() -> None:
    bootstrap = SceneBootstrap(SCENES, 1)
    hits = (np.random.default_rng(0).random(160) < 0.5).astype(float)
    ratio = (bootstrap.mean(0.5 * hits) / bootstrap.mean(hits)).estimate()
    assert (ratio.value, ratio.low, ratio.high) == pytest.approx((0.5, 0.5, 0.5))


def test_policies_that_are_alike_are_rarely_said_to_differ_and_others_are() -> None:
    """Five policies of equal rate on the same 40 scenes: in 100 benchmarks some pair is named in about 5; one far better always is."""
    rng = np.random.default_rng(2)
    n_false = 0
    for number in range(100):
        easy = np.repeat(rng.normal(0.0, 0.2, 40), 4)
        bootstrap = SceneBootstrap(SCENES, number)
        alike = {f"p{k}": bootstrap.mean(rng.random(160) < np.clip(0.5 + easy, 0, 1)) for k in range(5)}
        n_false += bool(pairs_that_differ(alike))
        better = alike | {"best": bootstrap.mean(rng.random(160) < 0.97)}
        assert {frozenset(("best", name)) for name in alike} <= pairs_that_differ(better)
    assert n_false <= 12  # 5 expected, standard deviation 2.2; a bootstrap of 40 scenes is a little too sure


def test_a_difference_without_error_counts() -> None:
    bootstrap = SceneBootstrap(SCENES, 1)
    means = {"all": bootstrap.mean(np.ones(160)), "none": bootstrap.mean(np.zeros(160)), "nothing": bootstrap.mean(np.zeros(160))}
    assert pairs_that_differ(means) == {frozenset(("all", "none")), frozenset(("all", "nothing"))}
