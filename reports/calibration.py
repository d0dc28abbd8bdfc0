"""Whether predicted probabilities mean what they say: expected calibration error, Brier score and AUROC of each; order is metrics.py's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from reports.entries import flat
from reports.metrics import Estimate
from reports.resampling import Draws, SceneBootstrap, auroc_estimate
from splits.markdown import percent

N_BINS = 15  # of equal width, as in Guo et al., On Calibration of Modern Neural Networks (ICML 2017)

TITLES = {"plan": "a plan exists", "exec": "success, given a plan", "success": "success"}
COLUMNS = ("probability of", "candidates", "happens", "mean probability", "AUROC [95 %]", "ECE, % [95 %]", "Brier score [95 %]")


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """One probability of some candidates, a row a training, and what happened; there is at least one candidate."""

    p: Float[np.ndarray, "r n"]
    happened: Bool[np.ndarray, "n"]
    scene_ids: Sequence[str]

    @property
    def rate(self) -> float:
        """Share of the candidates that it happened to."""
        return float(self.happened.mean())

    @property
    def brier_of_rate(self) -> float:
        """Brier score of whoever says the rate for every candidate."""
        return self.rate * (1.0 - self.rate)

    def brier(self, bootstrap: SceneBootstrap, name: str) -> Draws:
        """Brier score: mean squared error of the probability."""
        return bootstrap.mean((self.p - self.happened) ** 2, name)

    def ece(self, bootstrap: SceneBootstrap, name: str) -> Draws:
        """Expected calibration error over bins of equal width; resampled, it is that of the candidates of each draw."""
        trainings = []
        n = bootstrap.sums(np.ones((len(self.happened), 1)))[:, 0]
        for p in self.p:
            gaps = np.zeros((len(p), N_BINS))
            gaps[np.arange(len(p)), bins_of(p)] = p - self.happened
            drawn = np.abs(bootstrap.sums(gaps)).sum(axis=1) / n
            trainings.append(Draws(float(np.abs(gaps.sum(axis=0)).sum() / len(p)), drawn, len(p), bootstrap.n_scenes))
        return bootstrap.mean_of(trainings, name)

    def bins(self) -> tuple[Float[np.ndarray, "b"], Float[np.ndarray, "b"], Float[np.ndarray, "b"]]:
        """Mean probability, rate and number of the candidates of each bin that holds any, over all trainings."""
        p, happened = self.p.ravel(), np.tile(self.happened, len(self.p)).astype(np.float64)
        numbers = bins_of(p)
        n, total, hits = (np.bincount(numbers, weights=own, minlength=N_BINS) for own in (np.ones(len(p)), p, happened))
        some = n > 0
        return total[some] / n[some], hits[some] / n[some], n[some]


def bins_of(p: Float[np.ndarray, "n"]) -> np.ndarray:
    """Number of the bin of each probability; 1 is in the last."""
    return np.minimum((np.asarray(p) * N_BINS).astype(np.int64), N_BINS - 1)


@dataclass(frozen=True, slots=True)
class Fit:
    """How well one probability fits what happened.

    Attributes:
        ece, brier: within [0, 1]; their ends are NaN where there are too few scenes to resample.
        auroc: None where it happened to all candidates or to none.
    """

    ece: Estimate
    brier: Estimate
    auroc: Estimate | None

    @classmethod
    def of(cls, judged: Judged, seed: int, name: str) -> Fit:
        """Of the trainings of a policy; equal seeds and scenes are resampled alike."""
        bootstrap = SceneBootstrap(judged.scene_ids, seed)
        ece, brier = (draws.within(0.0, 1.0) for draws in (judged.ece(bootstrap, name), judged.brier(bootstrap, name)))
        if not bootstrap.is_telling:
            ece, brier = (Estimate(own.value, np.nan, np.nan, own.n, own.n_scenes) for own in (ece, brier))
        return cls(ece, brier, auroc_estimate(judged.p, judged.happened, judged.scene_ids, seed, name))

    @property
    def shown_ece(self) -> str:
        """In percent."""
        return _shown(self.ece, "{:.2f}", 100.0)

    @property
    def shown_brier(self) -> str:
        return _shown(self.brier, "{:.4f}")

    def metrics(self, prefix: str) -> dict[str, float]:
        known = {"ece": self.ece, "brier": self.brier, "auroc": self.auroc}
        metrics = {key: value for name, own in known.items() for key, value in flat(f"{prefix}.{name}", own).items()}
        return {key: value for key, value in metrics.items() if not np.isnan(value)}


def row_of(name: str, judged: Judged, fit: Fit) -> list[object]:
    """A row of a table under `COLUMNS`."""
    happens = [f"{len(judged.happened):,}", percent(judged.rate), percent(float(judged.p.mean()))]
    return [TITLES[name], *happens, fit.auroc, fit.shown_ece, fit.shown_brier]


def _shown(own: Estimate, form: str, scale: float = 1.0) -> str:
    value, low, high = (form.format(scale * x) for x in (own.value, own.low, own.high))
    return value if np.isnan(own.low) else f"{value} [{low}, {high}]"
