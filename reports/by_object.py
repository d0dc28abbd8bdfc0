"""S1 object by object, and how sure a difference of two policies is over other objects: objects are the sample, not scenes."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

import numpy as np
from jaxtyping import Float

from reports.entries import Entry, flat
from reports.metrics import Z95, Estimate, error_of_mean
from reports.policies import Policy
from splits.markdown import table

ABOUT_OBJECTS = (
    "Object by object, on the whole test split of `object`. The intervals above are of other scenes with these very objects; other objects"
    " would differ by more, so the last row takes the objects for the sample: the mean of their differences and its 95 % interval, by t."
)


def by_object(entries: Mapping[Policy, Entry], objects: Mapping[str, str]) -> tuple[str, dict[str, float]]:
    """A table with a row an object, S1 of every policy and the differences of all pairs, and these over the objects among the metrics.

    Args:
        entries: policies on the same groups, the means of their trainings.
        objects: object of every scene.

    Returns:
        The table, and `b_minus_a.s1_over_objects` with its interval, which there is of two objects and more.
    """
    object_of = np.array([objects[scene_id] for scene_id in next(iter(entries.values())).scene_ids])
    names = np.unique(object_of)
    s1 = {policy: _means((entry.first_success <= 1).mean(axis=0), object_of, names) for policy, entry in entries.items()}
    pairs = {(a, b): s1[b] - s1[a] for a, b in combinations(s1, 2)}
    rows: list[list[object]] = []
    for k, name in enumerate(names):
        cells = [f"{100 * own[k]:.1f}" for own in s1.values()] + [f"{100 * difference[k]:+.1f}" for difference in pairs.values()]
        rows.append([f"`{name}`", f"{np.count_nonzero(object_of == name):,}", *cells])
    estimates = {pair: _over_objects(difference) for pair, difference in pairs.items()}
    rows.append([f"mean of {len(names)}", f"{len(object_of):,}", *(f"{100 * own.mean():.1f}" for own in s1.values()), *estimates.values()])
    metrics: dict[str, float] = {}
    for (a, b), estimate in estimates.items():
        metrics |= flat(f"{b.name}_minus_{a.name}.s1_over_objects", estimate)
    header = ["object", "covered groups", *(policy.label for policy in s1), *(f"{b.label} − {a.label.lower()}" for a, b in pairs)]
    return table(header, rows), metrics


def _means(values: Float[np.ndarray, "n"], object_of: np.ndarray, names: np.ndarray) -> Float[np.ndarray, "k"]:
    return np.array([values[object_of == name].mean() for name in names])


def _over_objects(differences: Float[np.ndarray, "k"]) -> Estimate | None:
    """Mean over objects with its interval; None of fewer than two."""
    n = len(differences)
    if n < 2:
        return None
    mean, half = float(differences.mean()), Z95 * float(error_of_mean(differences))
    return Estimate(mean, max(-1.0, mean - half), min(1.0, mean + half), n, n)
