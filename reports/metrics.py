"""Numbers of a ranking and how sure they are. Policies order the candidates (policies.py); each report prints what it needs.

Intervals are 95 %. Candidates and groups of one scene are not independent; every interval but the binomial one takes that into account.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl
from jaxtyping import Bool, Float
from scipy import optimize, stats

from reports.load import Task

N_DRAWS = 4_000  # the ends of a bootstrapped interval then vary between seeds by about 1 % of its width
MIN_SCENES = 10  # below this a percentile bootstrap is far too narrow, and any interval too wide to tell policies apart

HARD = (1, 2)  # successes of a group that a lucky order hardly finds

Z95 = float(stats.norm.ppf(0.975))


@dataclass(frozen=True, slots=True)
class Estimate:
    """A proportion or a difference of two, its 95 % interval, and how many units and scenes it rests on."""

    value: float
    low: float
    high: float
    n: int
    n_scenes: int

    def __str__(self) -> str:
        """`85.8 [81.2, 89.9]`, in percent."""
        return f"{100 * self.value:.1f} [{100 * self.low:.1f}, {100 * self.high:.1f}]"


@dataclass(frozen=True, slots=True)
class Spread:
    """Mean over training seeds and sample standard deviation, in percent; a single seed has no deviation."""

    mean: float
    deviation: float | None = None

    def __str__(self) -> str:
        return f"{self.mean:.2f}" if self.deviation is None else f"{self.mean:.2f} ± {self.deviation:.2f}"


def spread_of(percentages: Sequence[float]) -> Spread | None:
    """Mean and sample standard deviation; None without values."""
    if not percentages:
        return None
    return Spread(float(np.mean(percentages)), float(np.std(percentages, ddof=1)) if len(percentages) > 1 else None)


def group_ranks(ranked: pl.DataFrame, task: Task) -> pl.DataFrame:
    """What an ordering means for each group.

    Args:
        ranked: candidates with `rank` (1 is tried first, unique within a group), `success` and `y_plan`.
        task: what a group is.

    Returns:
        One row a group with `n_candidates`, `n_success`, `first_success` and `first_plan` (null where there is none), sorted by group.
    """
    return (
        ranked.group_by(task.group)
        .agg(
            pl.len().alias("n_candidates"),
            pl.col("success").sum().alias("n_success"),
            pl.col("rank").filter(pl.col("success")).min().alias("first_success"),
            pl.col("rank").filter(pl.col("y_plan")).min().alias("first_plan"),
        )
        .sort(task.group)
    )


def success_at_k(ranks: pl.DataFrame, k: int) -> Estimate | None:
    """S_K: share of covered groups with a success among the first k; None where no group is covered."""
    covered = ranks.filter(pl.col("first_success").is_not_null())
    return proportion((covered["first_success"] <= k).to_numpy(), covered["scene_id"].to_list())


def coverage(groups: pl.DataFrame, ranks: pl.DataFrame, task: Task) -> Estimate | None:
    """Share of groups that hold a success; a group without candidates holds none.

    Args:
        groups: every group that was asked for.
        ranks: `group_ranks` of those that have candidates.
    """
    covered = ranks.filter(pl.col("first_success").is_not_null()).select(task.group).with_columns(pl.lit(True).alias("is_covered"))
    joined = groups.join(covered, on=task.group, how="left").with_columns(pl.col("is_covered").fill_null(False))
    return proportion(joined["is_covered"].to_numpy(), joined["scene_id"].to_list())


def expected_random_hits(ranks: pl.DataFrame, k: int) -> Float[np.ndarray, "n"]:
    """How often a uniformly random order has a success among the first k, of each covered group: 1 - C(n - s, k) / C(n, k)."""
    covered = ranks.filter(pl.col("first_success").is_not_null()).select("n_candidates", "n_success")
    return np.array([1.0 - math.comb(n - s, min(k, n)) / math.comb(n, min(k, n)) for n, s in covered.iter_rows()], dtype=np.float64)


def expected_random_success(ranks: pl.DataFrame, k: int) -> Estimate | None:
    """S_K of a uniformly random order, averaged over all orders; None where no group is covered."""
    covered = ranks.filter(pl.col("first_success").is_not_null())
    return proportion(expected_random_hits(ranks, k), covered["scene_id"].to_list())


def is_hard() -> pl.Expr:
    """Groups that hold a success, but so few of them (`HARD`) that a lucky order hardly finds one."""
    return pl.col("n_success").is_in(HARD)


def proportion(
    hits: Bool[np.ndarray, "n"] | Bool[np.ndarray, "r n"] | Float[np.ndarray, "n"] | Float[np.ndarray, "r n"], scene_ids: Sequence[str]
) -> Estimate | None:
    """Share of hits, with an interval that takes into account that units of a scene are alike; None without units.

    It is the interval of Wilson with the effective number of units: n over the design effect, which compares the variance between
    scenes with that of as many independent units, and times (z / t)^2 for the few scenes it was estimated from (Dean and Pagano,
    J. Surv. Stat. Methodol. 3, 2015). One pseudo-scene, half of it hits, keeps the design effect defined where all scenes agree. On
    simulated scenes of 1 to 8 units (3, 15, 46, 239 scenes; shares 0.3, 0.8, 0.97; intra-scene correlation 0, 0.2, 0.6) it held the
    truth in 92 to 100 % of 400 runs each; a percentile bootstrap over scenes in 85 to 100 %, and it has no width where all scenes agree.

    Args:
        hits: of each unit, or what share of it is one; a row of them a training, where a policy was trained several times. The share
            is then the mean over trainings, and their variance, times (t / z)^2 for the few there are, adds to that of the scenes.
    """
    rows = np.atleast_2d(np.asarray(hits, dtype=np.float64))
    if rows.shape[1] == 0:
        return None
    n_hits, n_units = per_scene(rows.mean(axis=0), scene_ids)
    value = float(n_hits.sum() / n_units.sum())
    n_effective = _effective_units(n_hits, n_units)
    if len(rows) > 1 and 0.0 < value < 1.0:
        variance = float(error_of_mean(rows.mean(axis=1))) ** 2
        n_effective = 1.0 / (1.0 / n_effective + variance / (value * (1.0 - value)))
    low, high = wilson(value, n_effective)
    return Estimate(value, low, high, rows.shape[1], len(n_units))


def of_few(n: int) -> float:
    """t / z: how much wider a 95 % interval is whose standard error was estimated from n at least 2 values."""
    return float(stats.t.ppf(0.975, n - 1)) / Z95


def error_of_mean(values: Float[np.ndarray, "*n r"]) -> Float[np.ndarray, "*n"]:
    """Standard error of the mean over the last axis, `of_few` times as large; 0 of a single value, of which nobody knows."""
    r = values.shape[-1]
    return np.asarray(values.std(axis=-1, ddof=1) / np.sqrt(r) * of_few(r)) if r > 1 else np.zeros(values.shape[:-1])


def wilson(value: float, n: float) -> tuple[float, float]:
    """Score interval of Wilson of a proportion of n trials (J. Am. Stat. Assoc. 22, 1927); n may be an effective number."""
    z2 = Z95 * Z95
    centre = (value + z2 / (2 * n)) / (1 + z2 / n)
    half = Z95 / (1 + z2 / n) * math.sqrt(value * (1 - value) / n + z2 / (4 * n * n))
    return max(0.0, centre - half), min(1.0, centre + half)


def clopper_pearson(k: int, n: int) -> Estimate | None:
    """Exact binomial interval of k of n independent trials (Biometrika 26, 1934); None without trials."""
    if n == 0:
        return None
    interval = stats.binomtest(k, n).proportion_ci(confidence_level=0.95, method="exact")
    return Estimate(k / n, float(interval.low), float(interval.high), n, n)


def mean_of_two(a: Estimate, b: Estimate) -> Estimate:
    """Mean of two shares of different units, from their intervals (MOVER: Zou and Donner, Stat. Med. 27, 2008)."""
    value = (a.value + b.value) / 2
    below, above = (math.hypot(x, y) / 2 for x, y in ((a.value - a.low, b.value - b.low), (a.high - a.value, b.high - b.value)))
    return Estimate(value, value - below, value + above, a.n + b.n, max(a.n_scenes, b.n_scenes))


def auroc_interval(area: float, n_true: float, n_false: float) -> tuple[float, float]:
    """95 % score interval of an area under the ROC curve of few independent units (method 5 of Newcombe, Stat. Med. 25, 2006).

    It asks which areas would give the one that was found, with the variance that they would have (Hanley and McNeil, Radiology 143,
    1982), so that it has a width where all units are told apart.
    """
    more = (n_true + n_false) / 2 - 1

    def error(a: float) -> float:
        return Z95 * math.sqrt(a * (1 - a) * (1 + more * (1 - a) / (2 - a) + more * a / (1 + a)) / (n_true * n_false))

    tiny = 1e-9
    low = optimize.brentq(lambda a: area - a - error(a), 0.0, area * (1 - tiny)) if area > tiny else 0.0
    high = optimize.brentq(lambda a: a - area - error(a), area + tiny * (1 - area), 1.0) if area < 1 - tiny else 1.0
    return float(low), float(high)


def auroc(scores: Float[np.ndarray, "n"], labels: Bool[np.ndarray, "n"]) -> float | None:
    """Probability that a true unit scores above a false one, ties counting half; None where one kind is missing."""
    scores, labels = np.asarray(scores, dtype=np.float64), np.asarray(labels, dtype=bool)
    n_true, n_false = int(labels.sum()), int((~labels).sum())
    if not n_true or not n_false:
        return None
    ranks = stats.rankdata(scores)
    return float((ranks[labels].sum() - n_true * (n_true + 1) / 2) / (n_true * n_false))


@dataclass(frozen=True, slots=True)
class Recalls:
    """Recall of both kinds of group at a threshold."""

    recall_true: float
    recall_false: float

    @property
    def balanced_accuracy(self) -> float:
        return (self.recall_true + self.recall_false) / 2


def recalls(scores: Float[np.ndarray, "n"], labels: Bool[np.ndarray, "n"], threshold: float) -> Recalls | None:
    """Recall of true units at or above the threshold and of false ones below it; None where one kind is missing."""
    labels = np.asarray(labels, dtype=bool)
    if labels.all() or not labels.any():
        return None
    is_above = np.asarray(scores, dtype=np.float64) >= threshold
    return Recalls(float(is_above[labels].mean()), float((~is_above[~labels]).mean()))


def best_threshold(scores: Float[np.ndarray, "n"], labels: Bool[np.ndarray, "n"]) -> float | None:
    """Threshold with the largest balanced accuracy, halfway between two scores; the lowest of equals; None where one kind is missing."""
    scores = np.asarray(scores, dtype=np.float64)
    distinct = np.unique(scores)
    between = np.concatenate([distinct[:1], (distinct[:-1] + distinct[1:]) / 2])
    judged = [recalls(scores, labels, float(threshold)) for threshold in between]
    if not judged or judged[0] is None:
        return None
    return float(between[int(np.argmax([r.balanced_accuracy for r in judged if r is not None]))])


def per_scene(values: Float[np.ndarray, "n"], scene_ids: Sequence[str]) -> tuple[Float[np.ndarray, "s"], Float[np.ndarray, "s"]]:
    """Sum and number of the values of each scene, scenes in order of their id."""
    _, scene = np.unique(np.asarray(scene_ids), return_inverse=True)
    return np.bincount(scene, weights=values), np.bincount(scene).astype(np.float64)


def _effective_units(n_hits: Float[np.ndarray, "s"], n_units: Float[np.ndarray, "s"]) -> float:
    """How many independent units the units of these scenes are worth; at most as many as there are."""
    n_scenes, n = len(n_units), float(n_units.sum())
    if n_scenes == n:
        return n
    if n_scenes == 1:
        return 1.0
    mean_units = n / n_scenes
    hits, units = np.append(n_hits, mean_units / 2), np.append(n_units, mean_units)
    value, total = hits.sum() / units.sum(), units.sum()
    between_scenes = len(units) / (len(units) - 1) * float(np.sum((hits - value * units) ** 2)) / total**2
    design_effect = max(1.0, float(between_scenes * total / (value * (1.0 - value))))
    return n / design_effect / of_few(n_scenes) ** 2
