"""Report of the ranking task: S_K, coverage and decision time of every policy, on the test and validation splits and on all scenes.

`python -m reports.success_at_k data/release/pilot [--split object] [--predictions FILE ...] [--out DIR]`
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import polars as pl
import pyarrow as pa

from pipelines.frames import frame_of
from reports import paper
from reports.command import Asked, report_command
from reports.costs import Costs
from reports.entries import Entry, comparison, entries_of, entry_of, prediction_frames
from reports.figures import ladder_figure
from reports.ladder import ladder_bars, ladder_metrics, ladder_table
from reports.load import Task, candidate_frame, group_frame, of_scheme, scheme_note
from reports.metrics import MIN_SCENES, Estimate, coverage
from reports.policies import IK_AND_GRIPPER, LEARNED, ORACLE, PLAN_HEAD_ONLY, RANKER, Policy, prediction_seeds
from reports.ranking import TASK_TITLE, timing_frame
from reports.report import Report
from reports.strata import strata_section
from tables.vocabulary import Split, SplitScheme

# The paper compares policies with one checkpoint that was designated beforehand; what is told of single groups and trees is of it here.
DESIGNATED_SEED = 42

_SPLITS = ("test", "validation", "all")
_ELSEWHERE = (
    "More on the learned policies is in reports `seed_robustness` (every training), `solvability` (groups without a success),"
    " `planner_calls` (what a ranking saves), `calibration`, `errors` and `learning_curve`."
)


@dataclass(frozen=True, slots=True, eq=False)
class _Inputs:
    """What every section reads."""

    tier: str
    scheme: SplitScheme
    seed: int
    candidates: pl.DataFrame
    predictions: pl.DataFrame | None
    groups: Mapping[Task, pl.DataFrame]
    timings: pl.DataFrame


def success_at_k_report(
    tables: Mapping[str, pa.Table],
    predictions: pa.Table | None = None,
    costs: Costs | None = None,
    *,
    tier: str,
    seed: int,
    scheme: SplitScheme = SplitScheme.SCENE,
) -> Report:
    """Report `success_at_k`.

    Args:
        tables: a release: `candidates`, `splits`, `scenes`, `targets`, `policy_features`, and `timings` where there are no `costs`.
        predictions: table `predictions` of any learned policies (`policies.LEARNED`), any seeds; those without are left out.
        costs: what deciding and planning took; by default what the release's own `timings` say.
        tier: printed in the title.
        seed: seed of the hash order and the resampling.
        scheme: by what scenes are dealt to the splits; the one that the rankers of `predictions` were trained under.
    """
    frame = candidate_frame(tables, seed, scheme)
    scores = None if predictions is None else frame_of(predictions)
    seeds = {policy: own for policy in LEARNED if (own := prediction_seeds(predictions, policy.variant))}
    groups = {task: group_frame(tables, task, scheme) for task in Task}
    costs = costs or Costs(timing_frame(tables), None)
    inputs = _Inputs(tier, scheme, seed, frame, scores, groups, costs.all_timings)

    blocks = [f"# S_K on tier {tier}{of_scheme(scheme)}", *scheme_note(scheme), _introduction(seeds, scheme, costs)]
    metrics: dict[str, float] = {}
    figures: dict[str, bytes] = {}
    for split in _SPLITS:
        section, values, png = _split_section(inputs, split, {task: _entries(inputs, split, task) for task in Task})
        stem = f"success_at_k-{split}"
        blocks += [*section, f"![S_K of the policies with 95 % intervals]({stem}.png)"]
        metrics |= values
        figures[stem] = png
    if seeds:
        blocks.append(_ELSEWHERE)
    return Report("success_at_k", "\n\n".join(blocks) + "\n", figures, metrics)


def _introduction(seeds: Mapping[Policy, Sequence[int]], scheme: SplitScheme, costs: Costs) -> str:
    trained = "; ".join(f"{policy.label} {', '.join(map(str, own))}" for policy, own in seeds.items())
    learned = f"Learned policies are means over their trainings, by seed: {trained}." if seeds else ""
    unscored = "The paper's ranker was not scored: its rows are" if seeds else "No ranker was scored: their rows are"
    missing = "" if RANKER in seeds else f" **{unscored} missing.**"
    in_paper = (
        f" *Paper* is {paper.RANKING_SOURCE}: Isaac Sim and cuMotion there, MuJoCo, PyBullet and OMPL here, so the protocol is the same and"
        " the labels are not."
        if scheme is SplitScheme.SCENE
        else ""
    )
    return (
        "A group is *covered* when it holds a success; S_K is the share of covered groups with a success among the first K tried. Every"
        " policy orders the same candidates and breaks ties by the candidate's hash. Endpoint policies try what passes first and the rest"
        " after it. Intervals are 95 % and take into account that the groups of a scene are alike, and that trainings"
        " differ (of one training: of this very one). Decision time"
        " is core time of one CPU for all of a group's computations, fresh; that of learned policies is wall-clock time from the scene's"
        f" points to scores{f', on {costs.machine}' if costs.machine else ''}; by size of the group it is in report `planner_calls`."
        f"{_planning_time(costs)} {learned}{missing}{in_paper}"
    )


def _planning_time(costs: Costs) -> str:
    """When planning was timed, and why other rows are not."""
    elsewhere = ", so of that split alone" if costs.planning_machine else ""
    planning = f" That of the full-pool planner is planning all of a group's candidates, {costs.planning_measured}{elsewhere}."
    is_timed = costs.timings["stage"].is_in(list(IK_AND_GRIPPER.candidate_stages)).any()
    lacks = " Checks of IK and gripper are *not measured*: they are timed in table `timings` alone, which a light release leaves out."
    return (planning if costs.planning is not None else "") + ("" if is_timed else lacks)


def _entries(inputs: _Inputs, split: str, task: Task) -> list[Entry]:
    """Policies that learn nothing, on every split; those that do, on splits that they were not trained on; then parts and bounds."""
    candidates = _of_split(inputs.candidates, split)
    predictions = None if split == "all" else inputs.predictions
    entries = entries_of(candidates, predictions, task, inputs.timings)
    if any(entry.policy is RANKER for entry in entries):
        frames = prediction_frames(candidates, predictions, PLAN_HEAD_ONLY.variant)
        entries.append(entry_of(PLAN_HEAD_ONLY, task, frames, inputs.timings))
    return [*entries, entry_of(ORACLE, task, candidates, inputs.timings)]


def _split_section(inputs: _Inputs, split: str, entries: Mapping[Task, Sequence[Entry]]) -> tuple[list[str], dict[str, float], bytes]:
    # The paper compares policies on its test split only.
    is_in_paper = split == "test" and inputs.scheme is SplitScheme.SCENE
    blocks = [f"## {split.capitalize()} split" if split != "all" else "## All splits, policies that learn nothing"]
    metrics: dict[str, float] = {}
    panels = {}
    for task, own in entries.items():
        groups = _of_split(inputs.groups[task], split)
        covered = coverage(groups, own[0].rankings[0].ranks, task)
        prefix = f"{split}.{task.value}"
        blocks += _facts(task, split, groups, own[0], covered, inputs.scheme)
        blocks.append(ladder_table(own, is_in_paper=is_in_paper))
        metrics |= ladder_metrics(prefix, own, covered)
        if split != "all":
            more, values = _comparison(own, groups, inputs.seed, prefix)
            blocks += more
            metrics |= values if split == "test" else {}
        panels[f"{TASK_TITLE[task]}, {own[0].covered.height:,} covered groups"] = ladder_bars(own, is_in_paper=is_in_paper)
    title = f"Success at K on covered groups, {inputs.tier}{of_scheme(inputs.scheme)}, {split}"
    return blocks, metrics, ladder_figure(panels, title.replace("`", ""))


def _of_split(frame: pl.DataFrame, split: str) -> pl.DataFrame:
    return frame if split == "all" else frame.filter(pl.col("split") == split)


def _facts(task: Task, split: str, groups: pl.DataFrame, first: Entry, covered: Estimate | None, scheme: SplitScheme) -> list[str]:
    """How many groups there are and hold a success, and whether that is enough to tell anything."""
    ranks = first.rankings[0].ranks
    n_candidates, n_empty = int(ranks["n_candidates"].sum()), groups.height - ranks.height
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
    return blocks


def _comparison(entries: Sequence[Entry], groups: pl.DataFrame, seed: int, prefix: str) -> tuple[list[str], dict[str, float]]:
    """Which policies differ, and where they fail."""
    usable = [entry for entry in entries if entry.policy not in (ORACLE, PLAN_HEAD_ONLY)]
    letters, metrics = comparison(usable, seed, prefix)
    strata, values = strata_section(usable, groups, prefix)
    text = (
        "Two policies that share a letter do not differ at 95 %, all pairs judged together on the same groups, scenes resampled and the"
        " error of few trainings added. Letters of S1 and of the mean rank of the first success in a covered group, the finer measure,"
        " are apart."
    )
    return [text, letters, strata], metrics | values


def _text(value: object | None) -> str | None:
    return None if value is None else str(value)


def main(arguments: Sequence[str] | None = None) -> int:
    def make(asked: Asked) -> Report:
        return success_at_k_report(asked.tables, asked.predictions, tier=asked.tier, seed=asked.seed, scheme=asked.scheme)

    return report_command("success_at_k", make, arguments, needs=(Split.VALIDATION, Split.TEST))


if __name__ == "__main__":
    sys.exit(main())
