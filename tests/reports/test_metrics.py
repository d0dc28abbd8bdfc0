from __future__ import annotations

import math
from itertools import permutations

import numpy as np
import polars as pl
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import stats

from reports.load import Task
from reports.metrics import (
    auroc,
    best_threshold,
    clopper_pearson,
    coverage,
    expected_random_success,
    group_ranks,
    proportion,
    recalls,
    spread_of,
    success_at_k,
    wilson,
)


@st.composite
def ranked_frames(draw: st.DrawFn) -> pl.DataFrame:
    """Candidates of a few small groups in tried order; success only where planned."""
    rows = []
    for scene in range(draw(st.integers(1, 4))):
        for target in range(draw(st.integers(1, 3))):
            outcomes = draw(st.lists(st.sampled_from(["none", "plan", "success"]), min_size=1, max_size=6))
            for rank, outcome in enumerate(outcomes, 1):
                rows.append((f"full-{scene:04d}", target, rank, outcome != "none", outcome == "success"))
    return pl.DataFrame(rows, schema=["scene_id", "target_id", "rank", "y_plan", "success"], orient="row")


def brute_force_s_k(frame: pl.DataFrame, k: int) -> float | None:
    """S_K of fixed-target groups as it is defined, without any table operation."""
    groups: dict[tuple[str, int], list[tuple[int, bool]]] = {}
    for scene_id, target_id, rank, _, success in frame.iter_rows():
        groups.setdefault((scene_id, target_id), []).append((rank, success))
    covered = [sorted(group) for group in groups.values() if any(success for _, success in group)]
    if not covered:
        return None
    return sum(any(success for _, success in group[:k]) for group in covered) / len(covered)


@given(ranked_frames(), st.integers(1, 7))
@settings(max_examples=100, deadline=None)
def test_s_k_agrees_with_its_definition(frame: pl.DataFrame, k: int) -> None:
    estimate = success_at_k(group_ranks(frame, Task.FIXED), k)
    expected = brute_force_s_k(frame, k)
    assert (estimate is None) == (expected is None)
    if estimate is not None and expected is not None:
        assert estimate.value == pytest.approx(expected)
        assert 0.0 <= estimate.low <= estimate.value + 1e-12
        assert estimate.value - 1e-12 <= estimate.high <= 1.0


@given(ranked_frames())
@settings(max_examples=60, deadline=None)
def test_s_k_grows_with_k_and_ends_at_one(frame: pl.DataFrame) -> None:
    ranks = group_ranks(frame, Task.FIXED)
    estimates = [success_at_k(ranks, k) for k in range(1, 8)]
    assume(estimates[0] is not None)
    values = [estimate.value for estimate in estimates if estimate is not None]
    assert values == sorted(values)
    assert values[-1] == 1.0  # no group has more than six candidates


@given(ranked_frames(), st.randoms(use_true_random=False))
@settings(max_examples=60, deadline=None)
def test_the_order_of_rows_means_nothing(frame: pl.DataFrame, random: object) -> None:
    order = list(range(frame.height))
    random.shuffle(order)  # type: ignore[attr-defined]
    assert group_ranks(frame[order], Task.FIXED).equals(group_ranks(frame, Task.FIXED))
    assert success_at_k(group_ranks(frame[order], Task.JOINT), 1) == success_at_k(group_ranks(frame, Task.JOINT), 1)


def test_coverage_counts_groups_without_candidates() -> None:
    frame = pl.DataFrame(
        [("a", 0, 1, True, True), ("a", 1, 1, True, False), ("b", 0, 1, False, False)],
        schema=["scene_id", "target_id", "rank", "y_plan", "success"],
        orient="row",
    )
    groups = pl.DataFrame({"scene_id": ["a", "a", "b", "b", "c"], "target_id": [0, 1, 0, 1, 0]})
    fixed = coverage(groups, group_ranks(frame, Task.FIXED), Task.FIXED)
    joint = coverage(groups.select("scene_id").unique(), group_ranks(frame, Task.JOINT), Task.JOINT)
    assert fixed is not None
    assert joint is not None
    assert (fixed.value, fixed.n, fixed.n_scenes) == (1 / 5, 5, 3)
    assert joint.value == pytest.approx(1 / 3)
    assert joint.n == 3


@given(st.lists(st.booleans(), min_size=1, max_size=6), st.integers(1, 7))
@settings(max_examples=80, deadline=None)
def test_expected_random_success_is_the_mean_over_all_orders(outcomes: list[bool], k: int) -> None:
    assume(any(outcomes))
    ranks = pl.DataFrame({"scene_id": ["a"], "n_candidates": [len(outcomes)], "n_success": [sum(outcomes)], "first_success": [1]})
    orders = list(permutations(outcomes))
    brute = sum(any(order[:k]) for order in orders) / len(orders)
    estimate = expected_random_success(ranks, k)
    assert estimate is not None
    assert estimate.value == pytest.approx(brute)


@given(st.lists(st.tuples(st.integers(0, 4), st.booleans()), min_size=2, max_size=25))
@settings(max_examples=100, deadline=None)
def test_auroc_is_the_share_of_pairs_in_the_right_order(units: list[tuple[int, bool]]) -> None:
    scores, labels = np.array([score for score, _ in units], dtype=float), np.array([label for _, label in units])
    pairs = [(t > f) + 0.5 * (t == f) for t in scores[labels] for f in scores[~labels]]
    area = auroc(scores, labels)
    assert (area is None) == (not pairs)
    if area is not None:
        assert area == pytest.approx(np.mean(pairs))


@given(st.lists(st.tuples(st.floats(0, 1), st.booleans()), min_size=2, max_size=25))
@settings(max_examples=100, deadline=None)
def test_no_threshold_beats_the_best(units: list[tuple[float, bool]]) -> None:
    scores, labels = np.array([score for score, _ in units]), np.array([label for _, label in units])
    threshold = best_threshold(scores, labels)
    assert (threshold is None) == (labels.all() or not labels.any())
    if threshold is None:
        assert recalls(scores, labels, 0.5) is None
        return
    best = recalls(scores, labels, threshold)
    assert best is not None
    assert best.balanced_accuracy == (best.recall_true + best.recall_false) / 2 >= 0.5
    for other in scores:
        judged = recalls(scores, labels, float(other))
        assert judged is not None
        assert judged.balanced_accuracy <= best.balanced_accuracy + 1e-12


@given(st.integers(0, 30), st.integers(1, 30))
@settings(max_examples=60, deadline=None)
def test_clopper_pearson_leaves_a_fortieth_in_either_tail(k: int, n: int) -> None:
    """The definition: at the ends of the interval, k or more (k or fewer) of n has a probability of 2.5 %."""
    assume(k <= n)
    estimate = clopper_pearson(k, n)
    assert estimate is not None
    assert estimate.value == k / n
    if k > 0:
        assert stats.binom.sf(k - 1, n, estimate.low) == pytest.approx(0.025, abs=1e-6)
    if k < n:
        assert stats.binom.cdf(k, n, estimate.high) == pytest.approx(0.025, abs=1e-6)
    assert clopper_pearson(0, 0) is None


@given(st.integers(1, 200), st.floats(0.0, 1.0))
def test_wilson_solves_the_score_equation(n: int, value: float) -> None:
    """At either end p the observed share is 1.96 standard errors of p away; the ends of [0, 1] are where it is cut off."""
    for end in wilson(value, n):
        if 1e-9 < end < 1 - 1e-9:
            assert abs(value - end) == pytest.approx(stats.norm.ppf(0.975) * math.sqrt(end * (1 - end) / n), rel=1e-6, abs=1e-9)


def test_one_group_a_scene_gives_wilson_and_alike_groups_widen_it() -> None:
    hits = np.array([True] * 12 + [False] * 8)
    alone = proportion(hits, [f"s{k:02d}" for k in range(20)])
    assert alone is not None
    assert (alone.low, alone.high) == pytest.approx(wilson(0.6, 20))
    same = proportion(hits, [f"s{k // 4}" for k in range(20)])  # scenes of four equal outcomes each
    mixed = proportion(np.array([True, True, True, False, False] * 4), [f"s{k // 5}" for k in range(20)])
    assert same is not None
    assert mixed is not None
    assert same.value == mixed.value == 0.6
    assert same.high - same.low > mixed.high - mixed.low > alone.high - alone.low


@pytest.mark.parametrize("share", [0.3, 0.97])
def test_intervals_hold_the_truth_about_as_often_as_they_say(share: float) -> None:
    """Scenes of 1 to 8 groups whose success rates vary (intra-scene correlation 0.2), 400 simulated reports of 30 scenes."""
    rng = np.random.default_rng(7)
    n_held = 0
    for _ in range(400):
        sizes = rng.integers(1, 9, 30)
        rates = rng.beta(4.0 * share, 4.0 * (1 - share), 30)
        hits = np.concatenate([rng.random(size) < rate for size, rate in zip(sizes, rates, strict=True)])
        estimate = proportion(hits, np.repeat(np.arange(30), sizes).astype(str).tolist())
        assert estimate is not None
        n_held += estimate.low <= share <= estimate.high
    # 95 % of 400 is 380 with a standard deviation of 4.4; the method is known to run from 92 % to 99 %.
    assert 362 <= n_held <= 398


def test_trainings_that_differ_widen_the_interval_and_equal_ones_do_not() -> None:
    scenes = [f"s{k // 2:02d}" for k in range(60)]
    rng = np.random.default_rng(5)
    good, bad = rng.random(60) < 0.9, rng.random(60) < 0.5
    one, three = proportion(good, scenes), proportion(np.stack([good] * 3), scenes)
    assert one is not None
    assert three is not None
    assert (three.low, three.high) == pytest.approx((one.low, one.high))
    mixed = np.stack([good, bad, good])
    wide, narrow = proportion(mixed, scenes), proportion(mixed.mean(axis=0), scenes)
    assert wide is not None
    assert narrow is not None
    assert wide.value == pytest.approx(mixed.mean())
    assert wide.low < narrow.low
    assert wide.high > narrow.high


@pytest.mark.parametrize("seed_sd", [0.0, 0.05])
def test_intervals_over_trainings_hold_the_truth(seed_sd: float) -> None:
    """Three trainings whose rates differ, on the same 40 scenes of 4 groups whose rates differ too: 300 simulated reports."""
    rng = np.random.default_rng(11)
    n_held = 0
    for _ in range(300):
        scene = rng.normal(0.0, 0.08, 40)
        rate = np.clip(0.8 + scene[None, :] + rng.normal(0.0, seed_sd, 3)[:, None], 0.0, 1.0)
        estimate = proportion(rng.random((3, 160)) < np.repeat(rate, 4, axis=1), np.repeat(np.arange(40), 4).astype(str).tolist())
        assert estimate is not None
        n_held += estimate.low <= 0.8 <= estimate.high
    assert n_held >= 279  # 95 % of 300 is 285 with a standard deviation of 3.8; few trainings make it hold more


def test_a_spread_needs_two_seeds() -> None:
    assert spread_of([]) is None
    assert str(spread_of([85.0])) == "85.00"
    assert str(spread_of([85.0, 86.0, 87.0])) == "86.00 ± 1.00"
