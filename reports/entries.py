"""Policies side by side on the same groups: an entry is a policy on one task, with a ranking a training. Reports show them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
import polars as pl
from jaxtyping import Bool, Float

from reports.letters import letter_display
from reports.load import Task
from reports.metrics import MIN_SCENES, Estimate, expected_random_hits, is_hard, proportion
from reports.policies import LEARNED, UNLEARNED, Policy, with_predictions
from reports.ranking import Ranking, rank_groups
from reports.resampling import Draws, SceneBootstrap, pairs_that_differ
from splits.markdown import table

FIRST_RANK = "first_success_rank"  # what it is called among metrics


@dataclass(frozen=True, eq=False)
class Entry:
    """A policy on one task.

    Attributes:
        rankings: one a training, by seed; one where nothing is learned. All are of the same groups.
        seeds: of the trainings; empty where nothing is learned.
    """

    policy: Policy
    task: Task
    rankings: tuple[Ranking, ...]
    seeds: tuple[int, ...] = ()

    @cached_property
    def first_success(self) -> Float[np.ndarray, "r n"]:
        """Rank of the first success of each covered group, a row a training."""
        return np.stack([ranking.covered["first_success"].to_numpy().astype(np.float64) for ranking in self.rankings])

    @property
    def covered(self) -> pl.DataFrame:
        """The groups that hold a success; they are the same in every training."""
        return self.rankings[0].covered

    @property
    def scene_ids(self) -> list[str]:
        """Scene of each covered group."""
        return self.covered["scene_id"].to_list()

    def s(self, k: int, among: Bool[np.ndarray, "n"] | None = None) -> Estimate | None:
        """S_K, the mean over trainings; None where no group is covered.

        Args:
            among: which of the covered groups count; all by default.
        """
        chosen = np.ones(self.covered.height, dtype=bool) if among is None else among
        return proportion(self.first_success[:, chosen] <= k, np.array(self.scene_ids)[chosen].tolist())

    @property
    def is_hard(self) -> Bool[np.ndarray, "n"]:
        """Which covered groups have few successes."""
        return self.covered.select(is_hard().alias("is_hard"))["is_hard"].to_numpy()

    def s_by_training(self, k: int) -> list[float]:
        """S_K of each training, in percent."""
        return [100.0 * float(row.mean()) for row in self.first_success <= k] if self.first_success.shape[1] else []

    def s_draws(self, k: int, bootstrap: SceneBootstrap) -> Draws:
        """S_K under resampling of the covered groups' scenes, and of the trainings."""
        return bootstrap.mean(self.first_success <= k, self.policy.name)

    def rank_draws(self, bootstrap: SceneBootstrap) -> Draws:
        """Mean rank of the first success, resampled alike."""
        return bootstrap.mean(self.first_success, self.policy.name)


def prediction_frames(frame: pl.DataFrame, predictions: pl.DataFrame | None, variant: str) -> dict[int, pl.DataFrame]:
    """Candidates with what each training of a variant predicts, by seed; empty where there is none."""
    if predictions is None:
        return {}
    seeds = sorted(predictions.filter(pl.col("variant") == variant)["seed"].unique().to_list())
    return {seed: with_predictions(frame, predictions, variant, seed) for seed in seeds}


def entry_of(policy: Policy, task: Task, frames: Mapping[int, pl.DataFrame] | pl.DataFrame, timings: pl.DataFrame) -> Entry:
    """Order all groups of a candidate frame, or of one a training, by a policy."""
    if isinstance(frames, pl.DataFrame):
        return Entry(policy, task, (rank_groups(frames, policy, task, timings),))
    return Entry(policy, task, tuple(rank_groups(own, policy, task, timings) for own in frames.values()), tuple(frames))


def entries_of(
    frame: pl.DataFrame, predictions: pl.DataFrame | None, task: Task, timings: pl.DataFrame, policies: Sequence[Policy] = LEARNED
) -> list[Entry]:
    """The policies that learn nothing, then those of the learned ones that there are predictions of."""
    return [
        *(entry_of(policy, task, frame, timings) for policy in UNLEARNED),
        *learned_entries(frame, predictions, task, timings, policies),
    ]


def learned_entries(
    frame: pl.DataFrame, predictions: pl.DataFrame | None, task: Task, timings: pl.DataFrame, policies: Sequence[Policy] = LEARNED
) -> list[Entry]:
    """Those of the learned policies that there are predictions of."""
    frames = {policy: prediction_frames(frame, predictions, policy.variant) for policy in policies}
    return [entry_of(policy, task, own, timings) for policy, own in frames.items() if own]


def comparison(entries: Sequence[Entry], seed: int, prefix: str) -> tuple[str, dict[str, float]]:
    """All pairs of policies compared: a table with letters, best S1 first, and the differences among the metrics.

    Args:
        entries: of one task.
        seed: of the resampling.
        prefix: of the names of the metrics, such as `test.joint`.
    """
    bootstrap = SceneBootstrap(entries[0].scene_ids, seed)
    if not bootstrap.is_telling:
        return f"Which policies differ: not estimated below {MIN_SCENES} scenes.", {}
    s1 = {entry.policy.name: entry.s_draws(1, bootstrap) for entry in entries}
    ranks = {entry.policy.name: entry.rank_draws(bootstrap) for entry in entries}
    label = {entry.policy.name: entry.policy.label for entry in entries}
    by_s1 = sorted(s1, key=lambda name: -s1[name].value)
    s1_letters = letter_display(by_s1, pairs_that_differ(s1))
    rank_letters = letter_display(sorted(ranks, key=lambda name: ranks[name].value), pairs_that_differ(ranks))
    rows = [
        [label[name], f"{100 * s1[name].value:.1f}", s1_letters[name], shown_rank(ranks[name].estimate()), rank_letters[name]]
        for name in by_s1
    ]
    metrics: dict[str, float] = {}
    for name, draws in ranks.items():
        metrics |= flat(f"{prefix}.{name}.{FIRST_RANK}", draws.estimate())
    metrics |= differences(s1, "s1", f"{prefix}.") | differences(ranks, FIRST_RANK, f"{prefix}.")
    return table(["policy", "S1", "S1 differs", "mean rank of the first success [95 %]", "rank differs"], rows, align="lrlrl"), metrics


def differences(means: Mapping[str, Draws], measure: str, prefix: str = "") -> dict[str, float]:
    """Metrics `b_minus_a.measure` of all pairs of policies, each later one minus each earlier one."""
    metrics: dict[str, float] = {}
    for a, b in combinations(means, 2):
        metrics |= flat(f"{prefix}{b}_minus_{a}.{measure}", (means[b] - means[a]).estimate())
    return metrics


def hard_groups(entries: Sequence[Entry]) -> dict[str, Estimate | None]:
    """S1 on the groups with few successes, by policy."""
    return {entry.policy.name: entry.s(1, entry.is_hard) for entry in entries}


def random_mean(entry: Entry, k: int, bootstrap: SceneBootstrap) -> Draws:
    """S_K of a random order, averaged over all orders, on the groups of an entry."""
    return bootstrap.mean(expected_random_hits(entry.rankings[0].ranks, k))


def random_first_rank(entry: Entry, bootstrap: SceneBootstrap) -> Draws:
    """Mean rank of the first success of a random order, averaged over all orders: (n + 1) / (s + 1) for s successes among n."""
    counts = entry.covered.select("n_candidates", "n_success").to_numpy().astype(np.float64)
    return bootstrap.mean((counts[:, 0] + 1.0) / (counts[:, 1] + 1.0))


def shown_rank(estimate: Estimate) -> str:
    """`1.23 [1.10, 1.40]`."""
    return f"{estimate.value:.2f} [{estimate.low:.2f}, {estimate.high:.2f}]"


def flat(name: str, estimate: Estimate | None) -> dict[str, float]:
    """An estimate among metrics: its value, `_low` and `_high`; nothing for None."""
    return {} if estimate is None else {name: estimate.value, f"{name}_low": estimate.low, f"{name}_high": estimate.high}
