"""Report on the dataset itself: sizes, outcomes, coverage, ladder of policies, and what the labels cost; no trained model takes part.

`python -m reports.profile data/release/pilot [--split object] [--out DIR]`
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence

import polars as pl
import pyarrow as pa

from pipelines.frames import frame_of
from reports import paper
from reports.command import Asked, report_command
from reports.core_time import core_time_section
from reports.figures import LadderBar, ladder_figure, shares_figure
from reports.load import Task, candidate_frame, group_frame, of_scheme, scheme_note
from reports.metrics import Estimate, coverage, group_ranks, proportion
from reports.outcomes import outcomes_section, share_of
from reports.policies import POLICIES, RANDOM, ranked
from reports.ranking import KS, TASK_TITLE, rank_groups, timing_frame
from reports.report import Report
from reports.split_sizes import size_rows, splits_figure
from splits.markdown import count, percent, table
from tables.vocabulary import AdmissionStatus, Category, LiftStatus, SplitScheme

_UNLEARNED = tuple(policy for policy in POLICIES if not policy.is_learned)


def profile_report(tables: Mapping[str, pa.Table], *, tier: str, seed: int, scheme: SplitScheme = SplitScheme.SCENE) -> Report:
    """Report `profile`.

    Args:
        tables: a release: `candidates`, `grasps`, `scenes`, `targets`, `splits`, `policy_features`, and `timings` where costs are wanted.
        tier: printed in the title.
        seed: seed of the hash order.
        scheme: by what scenes are dealt to the splits, whose sizes are shown; everything else is over all of them.
    """
    frame = candidate_frame(tables, seed, scheme)
    groups = {task: group_frame(tables, task, scheme) for task in Task}
    grasps = frame_of(tables["grasps"], ["scene_id", "object_id", "admission_status", "lift_status"])
    grasps = grasps.join(groups[Task.JOINT].select("scene_id", "category"), on="scene_id")
    timings = timing_frame(tables)
    sizes, metrics = _sizes(frame, groups, grasps, scheme)
    outcomes, figures = outcomes_section(frame, grasps, tier)
    covered, covered_metrics, covered_figure = _coverage(frame, groups, tier)
    ladder, ladder_metrics, ladder_png = _ladder(frame, timings, tier)
    costs, cost_metrics = core_time_section(timings, frame.height)
    figures |= {
        "profile-splits": splits_figure(frame, groups, f"{tier}{of_scheme(scheme)}".replace("`", "")),
        "profile-coverage": covered_figure,
        "profile-ladder": ladder_png,
    }
    blocks = [
        f"# Dataset profile of tier {tier}{of_scheme(scheme)}",
        *scheme_note(scheme),
        "*Paper* are the figures of a dataset made by the same protocol in Isaac Sim and cuMotion: landmarks, not targets. Intervals are"
        " 95 % and take into account that groups of a scene are alike.",
        "## Sizes",
        sizes,
        "![Scenes, groups and candidates by split](profile-splits.png)",
        *outcomes,
        *covered,
        *ladder,
        *costs,
    ]
    return Report("profile", "\n\n".join(blocks) + "\n", figures, metrics | covered_metrics | ladder_metrics | cost_metrics)


def _sizes(
    frame: pl.DataFrame, groups: Mapping[Task, pl.DataFrame], grasps: pl.DataFrame, scheme: SplitScheme
) -> tuple[str, dict[str, float]]:
    scenes = groups[Task.JOINT].select("scene_id")
    per_scene = scenes.join(
        grasps.group_by("scene_id").agg(
            (pl.col("admission_status") == AdmissionStatus.ADMITTED.value).sum().alias("admitted"),
            (pl.col("lift_status") == LiftStatus.LIFTED.value).fill_null(False).sum().alias("lifted"),
        ),
        on="scene_id",
        how="left",
    ).join(frame.group_by("scene_id").agg(pl.len().alias("candidates")), on="scene_id", how="left")
    per_scene = per_scene.fill_null(0)
    n_paper = sum(paper.N_CANDIDATES.values())
    theirs = {
        "candidates": f"{n_paper / paper.N_SCENES:.1f} (derived)",
        "lifted": f"{n_paper / paper.N_SCENES / 8:.1f} (derived)",
        "admitted": None,
    }
    rows: list[list[object]] = [
        ["objects", groups[Task.JOINT]["object_id"].n_unique(), paper.N_OBJECTS],
        ["scenes", count(scenes.height), count(paper.N_SCENES)],
        ["candidates", count(frame.height), count(n_paper)],
    ]
    metrics = {"n_scenes": float(scenes.height), "n_candidates": float(frame.height)}
    for name, label in (("admitted", "admitted grasps a scene"), ("lifted", "lifted grasps a scene"), ("candidates", "candidates a scene")):
        values = per_scene[name].to_numpy()
        rows.append([label, f"{values.mean():.1f} (min {values.min()}, max {values.max()})", theirs[name]])
        metrics[f"{name}_per_scene"] = float(values.mean())
    n_fixed = max(1, groups[Task.FIXED].height)
    rows.append(["candidates a fixed-target group", f"{frame.height / n_fixed:.1f}", f"{paper.CANDIDATES_PER_FIXED_GROUP_TEST} (test)"])
    rows += size_rows(frame, scheme)
    return table(["", "ours", "paper"], rows), metrics


def _coverage(frame: pl.DataFrame, groups: Mapping[Task, pl.DataFrame], tier: str) -> tuple[list[str], dict[str, float], bytes]:
    metrics: dict[str, float] = {}
    ranks = {task: group_ranks(ranked(frame, RANDOM, task), task) for task in Task}
    overall: list[list[object]] = []
    for task in Task:
        estimate = coverage(groups[task], ranks[task], task)
        overall.append([TASK_TITLE[task], groups[task].height, estimate, f"{paper.COVERAGE['test', task]:.2f} (test)"])
        if estimate is not None:
            metrics[f"coverage.{task.value}"] = estimate.value
    by_resting = _parts(frame, groups[Task.FIXED], ranks[Task.FIXED], Task.FIXED, "resting")
    by_pose = {
        f"{category}, {resting}": part for category in Category for resting, part in _by_category(frame, groups, ranks, category).items()
    }
    rows = []
    for column, label in (("category", "category"), ("n_obstacles", "obstacles")):
        joint = _parts(frame, groups[Task.JOINT], ranks[Task.JOINT], Task.JOINT, column)
        fixed = _parts(frame, groups[Task.FIXED], ranks[Task.FIXED], Task.FIXED, column)
        rows += [[f"{label}: {name}", joint[name][0], *fixed[name]] for name in joint]
    rows += [[f"target {name}", None, *part] for name, part in by_resting.items()]
    rows += [[f"{name}", None, *part] for name, part in by_pose.items()]
    blocks = [
        "## Coverage",
        "A group is covered when it holds a success; a group without candidates is not.",
        table(["groups", "number", "covered [95 %]", "paper"], overall),
        table(["part", "joint covered", "fixed covered", "planned", "success of planned"], rows),
        "![Coverage of fixed-target groups by resting pose](profile-coverage.png)",
    ]
    figure = shares_figure(
        {name.replace(", target ", ", "): part[0] for name, part in by_pose.items()},
        f"Fixed-target groups that hold a success, {tier}",
        "covered groups [%]",
        paper.COVERAGE["test", Task.FIXED],
    )
    return blocks, metrics, figure


_Part = tuple[Estimate | None, str, str]  # coverage, share planned, share of success among planned


def _by_category(
    frame: pl.DataFrame, groups: Mapping[Task, pl.DataFrame], ranks: Mapping[Task, pl.DataFrame], category: Category
) -> dict[object, _Part]:
    of_category = pl.col("category") == category.value
    own = groups[Task.FIXED].filter(of_category)
    return _parts(frame.filter(of_category), own, ranks[Task.FIXED], Task.FIXED, "resting")


def _parts(frame: pl.DataFrame, groups: pl.DataFrame, ranks: pl.DataFrame, task: Task, column: str) -> dict[object, _Part]:
    """Coverage and outcome shares of each value of a column."""
    parts: dict[object, _Part] = {}
    for value in groups[column].unique().sort():
        asked = groups.filter(pl.col(column) == value)
        own = frame.filter(pl.col(column) == value)
        planned = own.filter("y_plan")
        covered = coverage(asked, ranks.join(asked.select(task.group), on=task.group), task)
        parts[value] = (covered, percent(share_of(own, pl.col("y_plan"))), percent(share_of(planned, pl.col("success"))))
    return parts


def _ladder(frame: pl.DataFrame, timings: pl.DataFrame, tier: str) -> tuple[list[str], dict[str, float], bytes]:
    blocks = ["## The ladder of policies, all splits"]
    metrics: dict[str, float] = {}
    panels = {}
    for task in Task:
        rankings = [rank_groups(frame, policy, task, timings) for policy in _UNLEARNED]
        rows, bars = [], []
        for ranking in rankings:
            theirs = paper.RANKING[task, ranking.policy.name]
            rows.append([ranking.policy.label, *(cell for k in KS for cell in (ranking.s[k], f"{theirs.s(k):.2f}"))])
            bars.append(LadderBar(ranking.policy.label, ranking.s, {k: theirs.s(k) for k in KS}))
            for k, estimate in ranking.s.items():
                if estimate is not None:
                    metrics[f"{task.value}.{ranking.policy.name}.s{k}"] = estimate.value
        panels[f"{TASK_TITLE[task]}, {rankings[0].covered.height:,} covered groups"] = bars
        header = ["policy", *(cell for k in KS for cell in (f"S{k} [95 %]", "paper (test)"))]
        blocks += [f"### {TASK_TITLE[task]}, {rankings[0].covered.height:,} covered groups", table(header, rows)]
    blocks.append("![S_K of the policies that learn nothing](profile-ladder.png)")
    for task, columns in ((Task.JOINT, ("category", "n_obstacles")), (Task.FIXED, ("category", "n_obstacles", "resting"))):
        blocks += [f"### S1 by part, {TASK_TITLE[task].lower()}", _ladder_by_part(frame, task, columns)]
    return blocks, metrics, ladder_figure(panels, f"The ladder of policies that learn nothing, {tier}, all splits")


def _ladder_by_part(frame: pl.DataFrame, task: Task, columns: Sequence[str]) -> str:
    ranks = {policy: group_ranks(ranked(frame, policy, task), task) for policy in _UNLEARNED}
    facts = frame.select(*dict.fromkeys((*task.group, *columns))).unique()
    rows = []
    for column in columns:
        for value in facts[column].unique().sort():
            own = facts.filter(pl.col(column) == value).select(task.group).unique()
            cells: list[object] = []
            for policy in _UNLEARNED:
                covered = ranks[policy].join(own, on=task.group).filter(pl.col("first_success").is_not_null()).sort(task.group)
                cells.append(proportion((covered["first_success"] == 1).to_numpy(), covered["scene_id"].to_list()))
            rows.append([f"{column.replace('n_obstacles', 'obstacles')}: {value}", covered.height, *cells])
    return table(["part", "covered groups", *(policy.label for policy in _UNLEARNED)], rows)


def main(arguments: Sequence[str] | None = None) -> int:
    def make(asked: Asked) -> Report:
        return profile_report(asked.tables, tier=asked.tier, seed=asked.seed, scheme=asked.scheme)

    return report_command("profile", make, arguments, takes_predictions=False)


if __name__ == "__main__":
    sys.exit(main())
