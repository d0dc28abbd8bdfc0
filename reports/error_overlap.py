"""Whether trainings and policies fail in the same groups: what is wrong in every training is more the group's doing than the training's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import polars as pl
from jaxtyping import Bool

from reports.load import Task
from reports.policies import LOCAL, RANKER, TREES, Policy
from splits.markdown import share, table
from tables.vocabulary import ExecStatus

_COMPARED = (LOCAL, TREES, RANKER)


def overlap_section(
    first_choices: Mapping[Policy, Sequence[pl.DataFrame]], seeds: Mapping[Policy, Sequence[int]], policy: Policy, task: Task
) -> tuple[list[str], dict[str, float]]:
    """How many covered groups each training of a policy gets wrong at its first choice, all of them, and others too.

    Args:
        first_choices: of each policy, what a training tries first in each covered group, with its `outcome`; groups in one order.
        seeds: of the trainings.
        policy: whose errors these are; others that are compared are so as far as they are there.

    Returns:
        Blocks of Markdown, and the numbers of groups by name.
    """
    wrong = {own: _wrong(first_choices[own]) for own in dict.fromkeys((policy, *_COMPARED)) if own in first_choices}
    n_groups = wrong[policy].shape[1]
    if not n_groups:
        return [], {}
    is_always = {own: rows.all(axis=0) for own, rows in wrong.items()}
    prefix = f"test.{task.value}"
    rows: list[list[object]] = []
    metrics: dict[str, float] = {f"{prefix}.n_covered": float(n_groups)}
    for own, hits in wrong.items():
        for seed, row in zip(seeds[own], hits, strict=True):
            metrics[f"{prefix}.{own.name}.n_wrong_{seed}"] = float(row.sum())
        metrics[f"{prefix}.{own.name}.n_wrong_every_training"] = float(is_always[own].sum())
        too = is_always[policy] & is_always[own]
        if own is not policy:
            metrics[f"{prefix}.{policy.name}.n_wrong_every_training_and_{own.name}"] = float(too.sum())
        n_too = None if own is policy else share(int(too.sum()), int(is_always[policy].sum()))
        by_training = ", ".join(f"{int(row.sum())} ({seed})" for seed, row in zip(seeds[own], hits, strict=True))
        rows.append([own.label, by_training, share(int(is_always[own].sum()), n_groups), n_too])
    everyone = int(np.logical_and.reduce(list(is_always.values())).sum())
    metrics[f"{prefix}.n_wrong_everyone"] = float(everyone)
    n_own, label = int(is_always[policy].sum()), policy.label.lower()
    text = (
        f"Whether it is the training or the group: of {n_groups:,} covered groups {n_own} are wrong at the first choice in every training"
        f" of {label}, {everyone} in every training of every policy in this table."
    )
    header = ["wrong at the first choice", "groups by training (seed)", "in every training", f"of the {n_own} of {label}"]
    return [text, table(header, rows, align="llrr")], metrics


def _wrong(trainings: Sequence[pl.DataFrame]) -> Bool[np.ndarray, "r n"]:
    return np.stack([(own["outcome"] != ExecStatus.SUCCESS.value).to_numpy() for own in trainings])
