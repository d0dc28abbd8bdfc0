"""The ladder of policies on one task: table of S_K beside the paper's, and the same as metrics and bars of a figure."""

from __future__ import annotations

from collections.abc import Sequence

from reports import paper
from reports.entries import Entry, flat
from reports.figures import LadderBar
from reports.metrics import Estimate, expected_random_success
from reports.policies import ORACLE, PLAN_HEAD_ONLY, POLICIES, RANDOM
from reports.ranking import KS
from splits.markdown import table


def ladder_table(entries: Sequence[Entry], *, is_in_paper: bool) -> str:
    """S_K and decision time of every policy, the paper's figures beside them where it has any."""
    rows = [_row(entry, is_in_paper) for entry in entries]
    rows.insert(1, _expected_row(entries[0], is_in_paper))
    header = ["policy", *(cell for k in KS for cell in _with_paper(is_in_paper, f"S{k} [95 %]", "paper"))]
    return table([*header, *_with_paper(is_in_paper, "s / group", "paper")], rows)


def ladder_metrics(prefix: str, entries: Sequence[Entry], covered: Estimate | None) -> dict[str, float]:
    """S_K with intervals, decision times and coverage by name."""
    first = entries[0]
    values: dict[str, float] = {f"{prefix}.n_covered": float(first.covered.height)}
    if covered is not None:
        values |= {f"{prefix}.coverage": covered.value, f"{prefix}.n_groups": float(covered.n)}
    for entry in entries:
        name = f"{prefix}.{entry.policy.name}"
        for k in KS:
            values |= flat(f"{name}.s{k}", entry.s(k))
        cost = entry.rankings[0].cost
        if cost is not None:
            values[f"{name}.decision_ms"] = cost.mean_ms
    for k in KS:
        values |= flat(f"{prefix}.{RANDOM.name}.s{k}_expected", expected_random_success(first.rankings[0].ranks, k))
    return values


def ladder_bars(entries: Sequence[Entry], *, is_in_paper: bool) -> list[LadderBar]:
    """What the figure draws: policies that somebody could use."""
    bars = []
    for entry in entries:
        if entry.policy in POLICIES:
            theirs = paper.RANKING.get((entry.task, entry.policy.name)) if is_in_paper else None
            own = {k: entry.s(k) for k in KS}
            bars.append(LadderBar(entry.policy.label, own, {k: theirs.s(k) for k in KS} if theirs else {}))
    return bars


def _with_paper(is_in_paper: bool, ours: str | None, theirs: str | None) -> list[str | None]:
    return [ours, theirs] if is_in_paper else [ours]


def _row(entry: Entry, is_in_paper: bool) -> list[str | None]:
    policy, task = entry.policy, entry.task
    theirs = paper.RANKING.get((task, policy.name))
    cells: list[str | None] = [policy.label]
    for k in KS:
        in_paper = f"{theirs.s(k):.2f}" if theirs else f"{paper.PLAN_HEAD_S1[task]:.2f}" if policy is PLAN_HEAD_ONLY and k == 1 else None
        cells += _with_paper(is_in_paper, _text(entry.s(k)), in_paper)
    if policy is ORACLE:
        return [*cells, *_with_paper(is_in_paper, None, None)]
    cost = entry.rankings[0].cost
    if cost is not None:
        is_sample = cost.n_groups < entry.rankings[0].ranks.height
        time = f"{cost.mean_ms / 1e3:.3g}" + (f" (of {cost.n_groups:,} groups)" if is_sample else "")
    else:
        time = "nothing to compute" if policy.is_free and not policy.is_learned else "not measured"
    seconds = None
    if theirs is not None and theirs.seconds is not None:
        seconds = f"{'<' if theirs.is_upper_bound else ''}{theirs.seconds:.3f}"
    return [*cells, *_with_paper(is_in_paper, time, seconds)]


def _expected_row(entry: Entry, is_in_paper: bool) -> list[str | None]:
    cells: list[str | None] = ["Random, mean of all orders"]
    for k in KS:
        cells += _with_paper(is_in_paper, _text(expected_random_success(entry.rankings[0].ranks, k)), None)
    return [*cells, *_with_paper(is_in_paper, None, None)]


def _text(value: object | None) -> str | None:
    return None if value is None else str(value)
