"""Whether predicted probabilities mean what they say: expected calibration error and Brier score of each head; order is metrics.py's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import polars as pl
from jaxtyping import Bool, Float

from reports.metrics import Estimate
from reports.resampling import SceneBootstrap
from splits.markdown import percent, table

N_BINS = 15  # of equal width, as in Guo et al., On Calibration of Modern Neural Networks (ICML 2017)

TITLES = {"plan": "a plan exists", "exec": "success, given a plan", "success": "success"}


@dataclass(frozen=True, slots=True)
class Calibration:
    """How one probability fits what happened.

    Attributes:
        rate, mean: share of candidates that it happened to, and mean probability.
        ece: expected calibration error: mean over candidates of the distance between probability and rate in their bin.
        brier: mean squared error of the probability; None without an interval below `metrics.MIN_SCENES` scenes.
        brier_of_rate: that of saying the rate for every candidate.
    """

    n: int
    rate: float
    mean: float
    ece: float
    brier: float
    brier_interval: Estimate | None
    brier_of_rate: float


def expected_calibration_error(p: Float[np.ndarray, "n"], happened: Bool[np.ndarray, "n"], n_bins: int = N_BINS) -> float:
    """Mean over candidates of |mean probability - rate| of their bin; bins have equal width, and 1 is in the last."""
    bins = np.minimum((np.asarray(p) * n_bins).astype(np.int64), n_bins - 1)
    gaps = np.bincount(bins, weights=np.asarray(p) - np.asarray(happened, dtype=np.float64), minlength=n_bins)
    return float(np.abs(gaps).sum() / len(p))


def calibration_of(p: Float[np.ndarray, "n"], happened: Bool[np.ndarray, "n"], scene_ids: list[str], seed: int) -> Calibration | None:
    """Calibration of one probability of some candidates; None without candidates."""
    p, outcome = np.asarray(p, dtype=np.float64), np.asarray(happened, dtype=np.float64)
    if not len(p):
        return None
    bootstrap, rate = SceneBootstrap(scene_ids, seed), float(outcome.mean())
    brier = bootstrap.mean((p - outcome) ** 2)
    interval = brier.estimate() if bootstrap.is_telling else None
    ece = expected_calibration_error(p, np.asarray(happened))
    return Calibration(len(p), rate, float(p.mean()), ece, brier.value, interval, rate * (1.0 - rate))


def calibration_section(frame: pl.DataFrame, seed: int, prefix: str) -> tuple[list[str], dict[str, float]]:
    """Markdown blocks and metrics.

    Args:
        frame: candidates of one split with `p_plan` and `p_exec`, probabilities of a plan and of success given one.
        seed: of the resampling.
        prefix: of the names of the metrics.
    """
    planned = frame.filter("y_plan")
    judged = {
        "plan": calibration_of(frame["p_plan"].to_numpy(), frame["y_plan"].to_numpy(), frame["scene_id"].to_list(), seed),
        "exec": calibration_of(planned["p_exec"].to_numpy(), planned["success"].to_numpy(), planned["scene_id"].to_list(), seed),
        "success": calibration_of(
            (frame["p_plan"] * frame["p_exec"]).to_numpy(), frame["success"].to_numpy(), frame["scene_id"].to_list(), seed
        ),
    }
    rows: list[list[object]] = []
    metrics: dict[str, float] = {}
    for name, own in judged.items():
        if own is None:
            continue
        interval = own.brier_interval
        shown = f"{own.brier:.4f}" + (f" [{interval.low:.4f}, {interval.high:.4f}]" if interval else "")
        brier_cells = [f"{100 * own.ece:.2f} %", shown, f"{own.brier_of_rate:.4f}"]
        rows.append([TITLES[name], f"{own.n:,}", percent(own.rate), percent(own.mean), *brier_cells])
        metrics |= {f"{prefix}.{name}.ece": own.ece, f"{prefix}.{name}.brier": own.brier, f"{prefix}.{name}.rate": own.rate}
        if interval is not None:
            metrics |= {f"{prefix}.{name}.brier_low": interval.low, f"{prefix}.{name}.brier_high": interval.high}
    header = ["probability of", "candidates", "happens", "mean probability", "ECE", "Brier score [95 %]", "Brier score of the rate"]
    text = (
        f"ECE is over {N_BINS} bins of equal width. The last column is the Brier score of whoever says the rate of this split for every"
        " candidate: a probability with a higher one knows less than that."
    )
    return [text, table(header, rows)], metrics
