"""Report of the ranking task: S_K, coverage and decision time of every policy, on the test and validation splits and on all scenes.

`python -m reports.success_at_k data/release/pilot [--split object] [--predictions FILE ...] [--out DIR]`
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl
import pyarrow as pa

from pipelines.frames import frame_of
from reports import paper
from reports.command import Asked, report_command
from reports.figures import LadderBar, ladder_figure
from reports.load import Task, candidate_frame, group_frame, of_scheme, scheme_note
from reports.metrics import MIN_SCENES, Estimate, coverage, expected_random_success, paired_difference, spread_of
from reports.policies import FULL_PLANNER, ORACLE, PLAN_HEAD_ONLY, POLICIES, RANDOM, RANKER, prediction_seeds, with_predictions
from reports.ranking import KS, TASK_TITLE, Ranking, rank_groups, timing_frame
from reports.report import Report
from reports.solvability import solvability_section
from splits.markdown import table
from tables.vocabulary import Split, SplitScheme

# The paper compares policies with one checkpoint that was designated beforehand.
DESIGNATED_SEED = 42

_SPLITS = ("test", "validation", "all")


@dataclass(frozen=True, slots=True, eq=False)
class _Inputs:
    """What every section reads; `candidates` has predictions where `training_seed` is set."""

    tier: str
    scheme: SplitScheme
    seed: int
    training_seed: int | None
    candidates: pl.DataFrame
    groups: Mapping[Task, pl.DataFrame]
    timings: pl.DataFrame


def success_at_k_report(
    tables: Mapping[str, pa.Table],
    predictions: pa.Table | None = None,
    ranker_timings: pa.Table | None = None,
    *,
    tier: str,
    seed: int,
    scheme: SplitScheme = SplitScheme.SCENE,
) -> Report:
    """Report `success_at_k`.

    Args:
        tables: a release: `candidates`, `splits`, `scenes`, `targets`, `policy_features`, and `timings` where decision times are wanted.
        predictions: table `predictions`; without it the ranker is left out, which the report says.
        ranker_timings: table `timings` with the stage `ranker`, see `ranking.ranker_timing_rows`.
        tier: printed in the title.
        seed: seed of the hash order and the resampling.
        scheme: by what scenes are dealt to the splits; the one that the rankers of `predictions` were trained under.
    """
    frame = candidate_frame(tables, seed, scheme)
    scores = None if predictions is None else frame_of(predictions)
    seeds = prediction_seeds(predictions, "full")
    chosen = DESIGNATED_SEED if DESIGNATED_SEED in seeds else min(seeds, default=None)
    candidates = frame if scores is None or chosen is None else with_predictions(frame, scores, "full", chosen)
    groups = {task: group_frame(tables, task, scheme) for task in Task}
    inputs = _Inputs(tier, scheme, seed, chosen, candidates, groups, timing_frame(tables, ranker_timings))

    blocks = [f"# S_K on tier {tier}{of_scheme(scheme)}", *scheme_note(scheme), _introduction(chosen, seeds, scheme)]
    metrics: dict[str, float] = {}
    figures: dict[str, bytes] = {}
    for split in _SPLITS:
        section, values, png = _split_section(inputs, split)
        stem = f"success_at_k-{split}"
        blocks += [*section, f"![S_K of the policies with 95 % intervals]({stem}.png)"]
        metrics |= values
        figures[stem] = png
    if scores is not None and chosen is not None:
        blocks += _seed_section(frame, scores, seeds, scheme)
        section, values = solvability_section(candidates, scheme)
        blocks += section
        metrics |= values
    return Report("success_at_k", "\n\n".join(blocks) + "\n", figures, metrics)


def _introduction(chosen: int | None, seeds: Sequence[int], scheme: SplitScheme) -> str:
    ranker = (
        f"The ranker is the one trained with seed {chosen} (of {len(seeds)} trained: {', '.join(map(str, seeds))})."
        if chosen is not None
        else "**No ranker was scored: its rows are missing.**"
    )
    in_paper = (
        f" *Paper* is {paper.RANKING_SOURCE}: Isaac Sim and cuMotion there, MuJoCo, PyBullet and OMPL here, so the protocol is the same and"
        " the labels are not."
        if scheme is SplitScheme.SCENE
        else ""
    )
    return (
        "A group is *covered* when it holds a success; S_K is the share of covered groups with a success among the first K tried. Every"
        " policy orders the same candidates and breaks ties by the candidate's hash. Endpoint policies try what passes first and the rest"
        " after it. Intervals are 95 % and take into account that the groups of a scene are alike. Decision time is core time of one CPU"
        " for all of a group's computations, fresh; the ranker's is wall-clock time from the scene's points to scores."
        f" {ranker}{in_paper}"
    )


def _split_section(inputs: _Inputs, split: str) -> tuple[list[str], dict[str, float], bytes]:
    is_scored = inputs.training_seed is not None and split != "all"
    policies = [policy for policy in (*POLICIES, PLAN_HEAD_ONLY, ORACLE) if is_scored or not policy.is_learned]
    candidates = _of_split(inputs.candidates, split)
    blocks = [f"## {split.capitalize()} split" if split != "all" else "## All splits, policies that learn nothing"]
    metrics: dict[str, float] = {}
    panels = {}
    for task in Task:
        groups = _of_split(inputs.groups[task], split)
        rankings = [rank_groups(candidates, policy, task, inputs.timings) for policy in policies]
        covered = coverage(groups, rankings[0].ranks, task)
        blocks += _task_section(task, split, groups, rankings, covered, inputs.scheme)
        if is_scored:
            blocks.append(_gain(rankings, inputs.seed))
        metrics |= _metrics(f"{split}.{task.value}", rankings, covered)
        panels[f"{TASK_TITLE[task]}, {rankings[0].covered.height:,} covered groups"] = _ladder(rankings, split, inputs.scheme)
    title = f"Success at K on covered groups, {inputs.tier}{of_scheme(inputs.scheme)}, {split}"
    return blocks, metrics, ladder_figure(panels, title.replace("`", ""))


def _of_split(frame: pl.DataFrame, split: str) -> pl.DataFrame:
    return frame if split == "all" else frame.filter(pl.col("split") == split)


def _task_section(
    task: Task, split: str, groups: pl.DataFrame, rankings: Sequence[Ranking], covered: Estimate | None, scheme: SplitScheme
) -> list[str]:
    first = rankings[0]
    n_candidates = int(first.ranks["n_candidates"].sum())
    n_empty = groups.height - first.ranks.height
    in_paper = paper.COVERAGE.get((split, task)) if scheme is SplitScheme.SCENE else None
    blocks = [
        f"### {TASK_TITLE[task]}, {split}",
        f"{groups.height:,} groups of {groups['scene_id'].n_unique():,} scenes, {n_candidates / max(1, groups.height):.1f} candidates"
        f" each{f', {n_empty} without any' if n_empty else ''}. Coverage {_text(covered)} %, {first.covered.height:,} groups"
        + (f"; paper {in_paper:.2f} %." if in_paper is not None else "."),
    ]
    n_scenes = first.covered["scene_id"].n_unique()
    if n_scenes < MIN_SCENES:
        blocks.append(
            f"> **Only {n_scenes} scenes with {first.covered.height} covered groups: the intervals are wide, and differences between"
            " policies inside them mean nothing.**"
        )
    # The paper compares policies on its test split only.
    is_in_paper = split == "test" and scheme is SplitScheme.SCENE
    rows = [_row(ranking, is_in_paper) for ranking in rankings]
    rows.insert(1, _expected_row(first, is_in_paper))
    header = ["policy", *(cell for k in KS for cell in _with_paper(is_in_paper, f"S{k} [95 %]", "paper"))]
    return [*blocks, table([*header, *_with_paper(is_in_paper, "s / group", "paper")], rows), _calls_table(rankings, is_in_paper)]


def _with_paper(is_in_paper: bool, ours: str | None, theirs: str | None) -> list[str | None]:
    return [ours, theirs] if is_in_paper else [ours]


def _row(ranking: Ranking, is_in_paper: bool) -> list[str | None]:
    policy, task = ranking.policy, ranking.task
    theirs = paper.RANKING.get((task, policy.name))
    cells: list[str | None] = [policy.label]
    for k in KS:
        in_paper = f"{theirs.s(k):.2f}" if theirs else f"{paper.PLAN_HEAD_S1[task]:.2f}" if policy is PLAN_HEAD_ONLY and k == 1 else None
        cells += _with_paper(is_in_paper, _text(ranking.s[k]), in_paper)
    if policy is ORACLE:
        return [*cells, *_with_paper(is_in_paper, None, None)]
    if ranking.cost is not None:
        is_sample = ranking.cost.n_groups < ranking.ranks.height
        time = f"{ranking.cost.mean_ms / 1e3:.3g}" + (f" (of {ranking.cost.n_groups:,} groups)" if is_sample else "")
    else:
        time = "nothing to compute" if policy.is_free else "not measured"
    seconds = None
    if theirs is not None and theirs.seconds is not None:
        seconds = f"{'<' if theirs.is_upper_bound else ''}{theirs.seconds:.3f}"
    return [*cells, *_with_paper(is_in_paper, time, seconds)]


def _expected_row(ranking: Ranking, is_in_paper: bool) -> list[str | None]:
    cells: list[str | None] = ["Random, mean of all orders"]
    for k in KS:
        value = expected_random_success(ranking.ranks, k)
        cells += _with_paper(is_in_paper, None if value is None else f"{100 * value:.1f}", None)
    return [*cells, *_with_paper(is_in_paper, None, None)]


def _calls_table(rankings: Sequence[Ranking], is_in_paper: bool) -> str:
    rows: list[list[str | None]] = []
    for ranking in rankings:
        if ranking.policy in (FULL_PLANNER, ORACLE):
            continue  # the one plans everything before it tries anything, the other knows
        calls = ranking.ranks["first_plan"].drop_nulls().to_numpy()
        if not len(calls):
            continue
        theirs = None
        if ranking.policy is RANKER:
            theirs = f"{paper.PLANNER_CALLS_MEAN[ranking.task]:.2f} / {paper.PLANNER_CALLS_MEDIAN} / {paper.PLANNER_CALLS_P90}"
        median, p90 = np.median(calls), np.quantile(calls, 0.9, method="higher")
        ours = f"{calls.mean():.2f} / {median:g} / {p90:g}"
        rows.append([ranking.policy.label, *_with_paper(is_in_paper, ours, theirs), f"{len(calls):,}"])
    header = ["planner calls until the first plan", *_with_paper(is_in_paper, "mean / median / p90", "paper"), "groups with a plan"]
    return table(header, rows)


def _gain(rankings: Sequence[Ranking], seed: int) -> str:
    by_policy = {ranking.policy.name: ranking for ranking in rankings}
    ours, other = by_policy[RANKER.name].covered, by_policy[FULL_PLANNER.name].covered
    hits = [(covered["first_success"] == 1).to_numpy() for covered in (ours, other)]
    gain = paired_difference(hits[0], hits[1], ours["scene_id"].to_list(), seed)
    if gain is None:
        return f"S1 of the ranker minus the full-pool planner's: not estimated below {MIN_SCENES} scenes."
    return f"S1 of the ranker minus the full-pool planner's, paired over scenes: {gain} points."


def _seed_section(frame: pl.DataFrame, scores: pl.DataFrame, seeds: Sequence[int], scheme: SplitScheme) -> list[str]:
    rows = []
    for split in ("validation", "test"):
        for task in Task:
            values: dict[int, list[float]] = {k: [] for k in KS}
            for training_seed in seeds:
                own = _of_split(with_predictions(frame, scores, "full", training_seed), split)
                for k, estimate in rank_groups(own, RANKER, task, timing_frame({})).s.items():
                    values[k] += [] if estimate is None else [100 * estimate.value]
            in_paper = map(str, paper.SEEDS[split, task]) if scheme is SplitScheme.SCENE else [None] * len(KS)
            cells = [cell for k, theirs in zip(KS, in_paper, strict=True) for cell in (_text(spread_of(values[k])), theirs)]
            rows.append([f"{split}, {TASK_TITLE[task].lower()}", *cells])
    header = ["ranker", *(cell for k in KS for cell in (f"S{k}", "paper"))]
    what = (
        f"Mean ± sample standard deviation over {len(seeds)} seeds ({', '.join(map(str, seeds))})"
        if len(seeds) > 1
        else f"One seed ({seeds[0]}), so no deviation"
    )
    return ["## Training seeds", f"{what}; paper: {paper.SEEDS_SOURCE}.", table(header, rows)]


def _metrics(prefix: str, rankings: Sequence[Ranking], covered: Estimate | None) -> dict[str, float]:
    first = rankings[0]
    values: dict[str, float] = {f"{prefix}.n_covered": float(first.covered.height)}
    if covered is not None:
        values |= {f"{prefix}.coverage": covered.value, f"{prefix}.n_groups": float(covered.n)}
    for ranking in rankings:
        name = f"{prefix}.{ranking.policy.name}"
        for k, estimate in ranking.s.items():
            if estimate is not None:
                values |= {f"{name}.s{k}": estimate.value, f"{name}.s{k}_low": estimate.low, f"{name}.s{k}_high": estimate.high}
        if ranking.cost is not None:
            values[f"{name}.decision_ms"] = ranking.cost.mean_ms
    for k in KS:
        expected = expected_random_success(first.ranks, k)
        if expected is not None:
            values[f"{prefix}.{RANDOM.name}.s{k}_expected"] = expected
    return values


def _ladder(rankings: Sequence[Ranking], split: str, scheme: SplitScheme) -> list[LadderBar]:
    is_in_paper = split == "test" and scheme is SplitScheme.SCENE
    bars = []
    for ranking in rankings:
        if ranking.policy in POLICIES:
            theirs = paper.RANKING.get((ranking.task, ranking.policy.name)) if is_in_paper else None
            bars.append(LadderBar(ranking.policy.label, ranking.s, {k: theirs.s(k) for k in KS} if theirs else {}))
    return bars


def _text(value: object | None) -> str | None:
    return None if value is None else str(value)


def main(arguments: Sequence[str] | None = None) -> int:
    def make(asked: Asked) -> Report:
        return success_at_k_report(asked.tables, asked.predictions, tier=asked.tier, seed=asked.seed, scheme=asked.scheme)

    return report_command("success_at_k", make, arguments, needs=(Split.VALIDATION, Split.TEST))


if __name__ == "__main__":
    sys.exit(main())
