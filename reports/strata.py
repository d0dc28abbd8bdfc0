"""Where a ranking is hard: S1 by category, obstacle count and resting pose of the target, and on groups with one or two successes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import polars as pl

from reports.entries import Entry, flat
from reports.metrics import HARD
from reports.policies import FULL_PLANNER, IK_AND_GRIPPER
from splits.markdown import table

_TITLES = {"category": "category", "n_obstacles": "obstacles", "resting": "resting pose"}
_BESIDE = (IK_AND_GRIPPER, FULL_PLANNER)  # of those that learn nothing: the others are further below


def strata_section(entries: Sequence[Entry], groups: pl.DataFrame, prefix: str) -> tuple[str, dict[str, float]]:
    """A table of S1 with a row a stratum, and the same among the metrics as `<prefix>.<policy>.<stratum>.s1`.

    Args:
        entries: of one task.
        groups: every group with its `category`, `n_obstacles` and, for a fixed target, `resting`.
        prefix: of the names of the metrics, such as `test.fixed`.
    """
    shown = [entry for entry in entries if entry.policy in _BESIDE or entry.policy.is_learned]
    covered = entries[0].covered.join(groups, on=entries[0].task.group, how="left", maintain_order="left")
    strata = [(f"{HARD[0]} or {HARD[1]} successes", "hard", entries[0].is_hard)]
    for column, title in _TITLES.items():
        if column in covered.columns:
            values = covered[column].to_numpy()
            strata += [(f"{title} {value}", f"{column}_{value}", values == value) for value in sorted(set(values.tolist()))]
    rows: list[list[object]] = []
    metrics: dict[str, float] = {}
    for title, name, among in strata:
        estimates = {entry.policy.name: entry.s(1, np.asarray(among)) for entry in shown}
        rows.append([title, f"{int(np.sum(among)):,}", *estimates.values()])
        for policy, estimate in estimates.items():
            metrics |= flat(f"{prefix}.{policy}.{name}.s1", estimate)
    return table(["covered groups with", "n", *(f"S1, {entry.policy.label} [95 %]" for entry in shown)], rows), metrics
