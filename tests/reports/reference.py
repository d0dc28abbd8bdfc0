"""Definitions written out once more, slowly, for tests to compare with."""

from __future__ import annotations

import numpy as np


def expected_calibration_error(p: np.ndarray, happened: np.ndarray, n_bins: int) -> float:
    """Mean over units of |mean probability - rate| of their bin; bins have equal width, and 1 is in the last."""
    bins: dict[int, list[tuple[float, bool]]] = {}
    for own, y in zip(p.tolist(), happened.tolist(), strict=True):
        bins.setdefault(min(int(own * n_bins), n_bins - 1), []).append((own, y))
    return sum(abs(np.mean([own for own, _ in part]) - np.mean([y for _, y in part])) * len(part) for part in bins.values()) / len(p)
