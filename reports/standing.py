"""S1 of every policy on both tasks beside the paper's, from the metrics of report `success_at_k`, for terminal, README and site."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from reports import paper
from reports.load import Task
from reports.policies import POLICIES, RANDOM, Policy
from splits.markdown import MISSING
from tables.vocabulary import Split


@dataclass(frozen=True, slots=True)
class S1:
    """First-choice success on covered groups in percent: its 95 % interval, and what the paper reports of the same policy, if anything."""

    value: float
    low: float
    high: float
    paper: float | None

    def __str__(self) -> str:
        """`65.4 [59.1, 71.2]`."""
        return f"{self.value:.1f} [{self.low:.1f}, {self.high:.1f}]"


@dataclass(frozen=True, slots=True)
class Standing:
    """One policy, by task."""

    policy: Policy
    s1: Mapping[Task, S1]

    @property
    def label(self) -> str:
        return self.policy.label

    def cells(self, *, has_paper: bool = True) -> list[str]:
        """Its label, then S1 of each task, each with the paper's S1 behind it."""
        cells = [self.label]
        for s1 in (self.s1[task] for task in Task):
            cells += [str(s1), MISSING if s1.paper is None else f"{s1.paper:.2f}"][: 1 + has_paper]
        return cells


def standings(metrics: Mapping[str, float], split: Split = Split.TEST) -> list[Standing]:
    """Every policy that has numbers on both tasks, those that learn nothing first.

    Args:
        metrics: of report `success_at_k` under the paper's split.
    """
    found = []
    for policy in POLICIES:
        s1 = {task: _s1(metrics, f"{split.value}.{task.value}.{policy.name}.s1", task, policy) for task in Task}
        known = {task: value for task, value in s1.items() if value is not None}
        if len(known) == len(Task):
            found.append(Standing(policy, known))
    return found


def random_mean(metrics: Mapping[str, float], task: Task, split: Split = Split.TEST) -> float | None:
    """S1 of a random order averaged over all orders, in percent."""
    value = metrics.get(f"{split.value}.{task.value}.{RANDOM.name}.s1_expected")
    return None if value is None else 100.0 * value


def read_metrics(path: Path) -> dict[str, float]:
    """Metrics that a report left as JSON."""
    metrics: dict[str, float] = json.loads(path.read_text(encoding="utf-8"))
    return metrics


def _s1(metrics: Mapping[str, float], name: str, task: Task, policy: Policy) -> S1 | None:
    value, low, high = (metrics.get(f"{name}{end}") for end in ("", "_low", "_high"))
    if value is None or low is None or high is None:
        return None
    theirs = paper.RANKING.get((task, policy.name))
    return S1(100 * value, 100 * low, 100 * high, theirs.s1 if theirs else None)
