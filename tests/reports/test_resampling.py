"""Resampled means, differences, ratios and areas agree with what they are defined as, and say as often as they should that two differ."""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reports.metrics import auroc, auroc_interval, proportion
from reports.resampling import SceneBootstrap, auroc_draws, auroc_estimate, paired_difference, pairs_that_differ

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


def test_the_error_of_few_trainings_is_that_of_t_and_of_each_policy_by_itself() -> None:
    """Of groups that scenes do not differ in, all that is left is that trainings do."""
    bootstrap = SceneBootstrap(SCENES, 1)
    rows = np.tile([[0.5], [0.6], [0.7]], 160)
    one, other = bootstrap.mean(rows, "one"), bootstrap.mean(rows, "other")
    assert one.value == pytest.approx(0.6)
    t = 4.3027  # 97.5 % point with two degrees of freedom
    own = one.estimate()
    assert (own.high - own.low) / 2 == pytest.approx(t * 0.1 / math.sqrt(3), rel=0.05)
    assert abs(np.corrcoef(one.draws, other.draws)[0, 1]) < 0.06
    assert np.array_equal(one.draws, bootstrap.mean(rows, "one").draws)
    once = bootstrap.mean(rows[:1], "one").estimate()
    assert (once.low, once.high) == pytest.approx((0.5, 0.5)), "of one training nothing is known but itself"


@pytest.mark.parametrize("deviation", [0.02, 0.04])
def test_policies_that_differ_by_their_trainings_alone_are_rarely_said_to_differ(deviation: float) -> None:
    """Three trainings each of two policies of one mean: wrong in at most 5 of 100 benchmarks, by the interval and by the letters."""
    rng = np.random.default_rng(5)
    n_interval = n_letters = 0
    for number in range(100):
        easy = np.repeat(rng.normal(0.0, 0.2, 40), 4)
        bootstrap = SceneBootstrap(SCENES, number)
        means = {
            name: bootstrap.mean(rng.random((3, 160)) < np.clip(0.7 + easy + rng.normal(0.0, deviation, (3, 1)), 0, 1), name)
            for name in ("a", "b")
        }
        gain = (means["a"] - means["b"]).estimate()
        n_interval += not gain.low <= 0.0 <= gain.high
        n_letters += bool(pairs_that_differ(means))
    assert max(n_interval, n_letters) <= 9  # 5 expected, standard deviation 2.2


@pytest.mark.parametrize(("n_true", "n_false", "area"), [(234, 5, 0.95), (40, 12, 0.8), (20, 5, 0.9)])
def test_the_interval_of_an_area_of_few_units_holds_it(n_true: int, n_false: int, area: float) -> None:
    rng = np.random.default_rng(7)
    shift = math.sqrt(2.0) * NormalDist().inv_cdf(area)
    n_held, widths = 0, []
    for _ in range(400):
        true, false = rng.normal(shift, 1.0, n_true), rng.normal(0.0, 1.0, n_false)
        low, high = auroc_interval(float((true[:, None] > false).mean()), n_true, n_false)
        n_held += low <= area <= high
        widths.append(high - low)
    assert n_held >= 0.92 * 400
    assert max(widths) < 0.8


def test_areas_of_nothing_and_of_everything_have_a_width_on_one_side() -> None:
    assert auroc_interval(1.0, 234, 5)[1] == 1.0
    assert 0.5 < auroc_interval(1.0, 234, 5)[0] < 0.97
    assert auroc_interval(0.0, 5, 234) == pytest.approx(tuple(1 - x for x in auroc_interval(1.0, 5, 234))[::-1], abs=1e-6)
    labels = np.arange(60) % 12 == 0
    few = auroc_estimate(labels[None].astype(float), labels, [f"s{k:02d}" for k in range(60)], 1)
    assert few is not None
    assert (few.value, few.high) == (1.0, 1.0)
    assert few.low < 0.95, "five units of a kind that are told apart do not make it certain"
    many = auroc_estimate(labels[None].astype(float), labels, [f"s{k % 30:02d}" for k in range(60)], 1)
    assert many is not None
    assert auroc_estimate(np.zeros((1, 60)), np.ones(60, dtype=bool), SCENES[:60], 1) is None


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
    unit = np.unique(scenes, return_inverse=True)[1]
    for weights in bootstrap.scene_weights[:50, unit].astype(int):
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
