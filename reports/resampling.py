"""How sure a mean over groups, a difference or a ratio of two is, when scenes and the trainings of a policy are resampled together.

Everything that rests on the same groups shares the draws of scenes, so differences are paired. A policy that was trained several times
has a row a training: each draw adds the error of their mean, drawn for each policy by itself, and wider for the few that there are, as
metrics.proportion has it, where a share by itself has its interval (it keeps its width near 100 %). Of a policy that was trained once
nobody knows how much another training would differ: its draws are of this very training.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float

from reports.metrics import MIN_SCENES, N_DRAWS, Z95, Estimate, auroc_interval, error_of_mean
from tables.identity import rng_for

LEVEL = 0.95


@dataclass(frozen=True, slots=True, eq=False)
class Draws:
    """A number and what resampling makes of it; `a - b` and `a / b` are of the same draws."""

    value: float
    draws: Float[np.ndarray, "d"]
    n: int
    n_scenes: int

    def __sub__(self, other: Draws) -> Draws:
        return Draws(self.value - other.value, self.draws - other.draws, self.n, self.n_scenes)

    def __truediv__(self, other: Draws) -> Draws:
        """The ratio; draws whose denominator is 0 are left out."""
        is_defined = other.draws != 0.0
        return Draws(self.value / other.value, self.draws[is_defined] / other.draws[is_defined], self.n, self.n_scenes)

    def estimate(self) -> Estimate:
        """The value with its percentile interval."""
        low, high = np.quantile(self.draws, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
        return Estimate(self.value, float(low), float(high), self.n, self.n_scenes)

    def within(self, least: float, most: float) -> Estimate:
        """The same of a number that cannot be outside of bounds, as a draw may be to which the error of trainings was added."""
        own = self.estimate()
        return replace(own, low=max(least, own.low), high=min(most, own.high))


class SceneBootstrap:
    """Draws of the scenes that some groups belong to.

    Args:
        scene_ids: of every group, or whatever is counted.
        seed: of the resampling; equal scenes and seed give equal draws.
    """

    def __init__(self, scene_ids: Sequence[str], seed: int) -> None:
        self._names, self._scene = np.unique(np.asarray(scene_ids), return_inverse=True)
        self._n_units = np.bincount(self._scene).astype(np.float64)
        self._seed, self.n_scenes = seed, len(self._names)
        if self.n_scenes:
            rng = rng_for(seed, "bootstrap", self.n_scenes)
            share = np.full(self.n_scenes, 1.0 / self.n_scenes)
            self._weights = rng.multinomial(self.n_scenes, share, size=N_DRAWS).astype(np.float64)

    @property
    def is_telling(self) -> bool:
        """Whether there are scenes enough: with fewer than `MIN_SCENES` a percentile interval is far too narrow."""
        return self.n_scenes >= MIN_SCENES

    @property
    def scene_weights(self) -> Float[np.ndarray, "d s"]:
        """How often each draw holds each scene."""
        return self._weights

    def n_of_scene(self, kind: Bool[np.ndarray, "n"]) -> Float[np.ndarray, "s"]:
        """Number of the units of a kind in each scene."""
        return np.bincount(self._scene[kind], minlength=self.n_scenes).astype(np.float64)

    def won(self, scores: Float[np.ndarray, "n"], labels: Bool[np.ndarray, "n"]) -> Float[np.ndarray, "s s"]:
        """Pairs of a true unit of one scene and a false one of another in which the true one scores higher, ties counting half."""
        of_true, scene_of_true = scores[labels], self._scene[labels]
        won = np.zeros((self.n_scenes, self.n_scenes))
        for scene in np.unique(self._scene[~labels]):
            of_false = np.sort(scores[~labels & (self._scene == scene)])
            below = np.searchsorted(of_false, of_true, "left") + np.searchsorted(of_false, of_true, "right")
            won[:, scene] = np.bincount(scene_of_true, weights=0.5 * below, minlength=self.n_scenes)
        return won

    def mean(self, values: Float[np.ndarray, "n"] | Float[np.ndarray, "r n"], name: str = "") -> Draws:
        """Mean over the units and, where there are several, the trainings.

        Args:
            values: a value a unit, or a row of them a training.
            name: of the policy that was trained: two that were trained equally often are not drawn alike.
        """
        rows = np.atleast_2d(np.asarray(values, dtype=np.float64))
        sums = np.stack([np.bincount(self._scene, weights=row, minlength=self.n_scenes) for row in rows])
        by_training = (self._weights @ sums.T) / (self._weights @ self._n_units)[:, None]
        return Draws(float(rows.mean()), self._over_trainings(by_training, name), rows.shape[1], self.n_scenes)

    def sums(self, values: Float[np.ndarray, "n b"]) -> Float[np.ndarray, "d b"]:
        """Sums over the units of each draw, a column a kind of value: for what is no mean."""
        by_scene = np.zeros((self.n_scenes, values.shape[1]))
        np.add.at(by_scene, self._scene, values)
        return np.asarray(self._weights @ by_scene)

    def mean_of(self, trainings: Sequence[Draws], name: str = "") -> Draws:
        """Mean of a number that was resampled with these draws for each training of a policy, the trainings resampled too."""
        by_training = np.stack([own.draws for own in trainings], axis=1)
        return Draws(
            float(np.mean([own.value for own in trainings])), self._over_trainings(by_training, name), trainings[0].n, self.n_scenes
        )

    def _over_trainings(self, by_training: Float[np.ndarray, "e r"], name: str) -> Float[np.ndarray, "e"]:
        """Mean over the trainings with the error that it has for being of few; draws of scenes that gave no number are left out before."""
        n, r = by_training.shape
        if r == 1:
            return by_training[:, 0]
        drawn = rng_for(self._seed, "bootstrap-trainings", name, r).standard_normal(N_DRAWS)[:n]
        return np.asarray(by_training.mean(axis=1) + error_of_mean(by_training) * drawn)


def paired_difference(
    hits_a: Bool[np.ndarray, "n"] | Float[np.ndarray, "n"],
    hits_b: Bool[np.ndarray, "n"] | Float[np.ndarray, "n"],
    scene_ids: Sequence[str],
    seed: int,
) -> Estimate | None:
    """Share of hits of a minus that of b on the same units, with an interval from resampled scenes; None below `MIN_SCENES` scenes."""
    bootstrap = SceneBootstrap(scene_ids, seed)
    difference = np.asarray(hits_a, dtype=np.float64) - np.asarray(hits_b, dtype=np.float64)
    return bootstrap.mean(difference).estimate() if bootstrap.is_telling else None


def pairs_that_differ(means: Mapping[str, Draws]) -> set[frozenset[str]]:
    """Pairs of policies whose difference is not 0, all pairs judged together: in 95 of 100 benchmarks none of them is named wrongly.

    A difference counts where it is larger than its standard error times the 95 % point of the largest such ratio over all pairs, as the
    draws have it (single-step max-t: Westfall and Young, 1993). A difference that every draw repeats exactly has no error.
    """
    pairs = {frozenset(pair): means[pair[0]] - means[pair[1]] for pair in combinations(sorted(means), 2)}
    errors = {pair: float(np.std(difference.draws, ddof=1)) for pair, difference in pairs.items()}
    uncertain = [pair for pair in pairs if errors[pair] > _ROUNDING]
    if not uncertain:
        return {pair for pair, difference in pairs.items() if abs(difference.value) > _ROUNDING}
    ratios = np.stack([np.abs(pairs[pair].draws - pairs[pair].value) / errors[pair] for pair in uncertain])
    critical = float(np.quantile(ratios.max(axis=0), LEVEL))
    return {pair for pair, difference in pairs.items() if abs(difference.value) > max(critical * errors[pair], _ROUNDING)}


def auroc_draws(scores: Float[np.ndarray, "n"], labels: Bool[np.ndarray, "n"], bootstrap: SceneBootstrap) -> Draws | None:
    """Area under the ROC curve, ties counting half, of the units that a bootstrap was made for; None where a kind is missing.

    Draws without one of both kinds are left out.
    """
    labels = np.asarray(labels, dtype=bool)
    if labels.all() or not labels.any():
        return None
    won = bootstrap.won(np.asarray(scores, dtype=np.float64), labels)
    n_true, n_false = (bootstrap.n_of_scene(kind) for kind in (labels, ~labels))

    def areas(weights: Float[np.ndarray, "d s"]) -> Float[np.ndarray, "e"]:
        pairs = (weights @ n_true) * (weights @ n_false)
        is_defined = pairs > 0.0
        return np.asarray(((weights @ won) * weights).sum(axis=1)[is_defined] / pairs[is_defined])

    value = float(areas(np.ones((1, bootstrap.n_scenes)))[0])
    return Draws(value, areas(bootstrap.scene_weights), len(labels), bootstrap.n_scenes)


def auroc_estimate(
    scores: Float[np.ndarray, "r n"], labels: Bool[np.ndarray, "n"], scene_ids: Sequence[str], seed: int, name: str = ""
) -> Estimate | None:
    """Area under the ROC curve, the mean over trainings, with its interval; None where a kind of unit is missing.

    Where one kind is in fewer than `MIN_SCENES` scenes it is the interval of `metrics.auroc_interval`, for as many units of each kind as
    scenes that hold it, and the error of the trainings added to it: resampled, five units of a kind that are told apart seem certain.

    Args:
        scores: of each unit, a row a training.
        name: of the policy that was trained.
    """
    bootstrap = SceneBootstrap(scene_ids, seed)
    areas = [own for row in scores if (own := auroc_draws(row, labels, bootstrap)) is not None]
    if not areas:
        return None
    n_true, n_false = (int((bootstrap.n_of_scene(kind) > 0).sum()) for kind in (labels, ~labels))
    if min(n_true, n_false) >= MIN_SCENES:
        return bootstrap.mean_of(areas, name).within(0.0, 1.0)
    values = np.array([own.value for own in areas])
    value = float(values.mean())
    low, high = auroc_interval(value, n_true, n_false)
    error = Z95 * float(error_of_mean(values))
    low, high = max(0.0, value - np.hypot(value - low, error)), min(1.0, value + np.hypot(high - value, error))
    return Estimate(value, float(low), float(high), len(labels), bootstrap.n_scenes)


_ROUNDING = 1e-12
