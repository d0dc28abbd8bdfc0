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
from reports.figures import LadderBar, funnel_figure, ladder_figure, shares_figure, status_figure
from reports.load import Task, candidate_frame, group_frame, of_scheme, scheme_note
from reports.metrics import Estimate, coverage, group_ranks, proportion
from reports.policies import POLICIES, RANDOM, ranked
from reports.ranking import KS, TASK_TITLE, rank_groups, timing_frame
from reports.report import Report
from reports.split_sizes import size_rows, splits_figure
from splits.markdown import count, percent, share, table
from tables.vocabulary import AdmissionStatus, Category, ExecStatus, LiftStatus, PlanStatus, SplitScheme

MIN_LIFTED_SHARE = 0.75  # of an object's admitted grasps; a pool that lifts less asks for a reason

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
    outcomes, figures = _outcomes(frame, grasps, tier)
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


def _outcomes(frame: pl.DataFrame, grasps: pl.DataFrame, tier: str) -> tuple[list[str], dict[str, bytes]]:
    admitted = grasps.filter(pl.col("admission_status") == AdmissionStatus.ADMITTED.value)
    lifted = admitted.filter(pl.col("lift_status") == LiftStatus.LIFTED.value)
    planned = frame.filter("y_plan")
    stages = [
        ("pool grasps in scenes", grasps.height, "grasps"),
        ("admitted", admitted.height, "grasps"),
        ("lifted", lifted.height, "grasps"),
        ("with every target", frame.height, "candidates"),
        ("planned", planned.height, "candidates"),
        ("success", int(frame["success"].sum()), "candidates"),
    ]
    blocks = ["## Outcomes", f"![What is left after each stage of {tier}](profile-funnel.png)"]
    figures = {"profile-funnel": funnel_figure(stages, f"From grasps to successes, {tier}")}
    for column, statuses, good, rows, of in (
        ("admission_status", AdmissionStatus, AdmissionStatus.ADMITTED, grasps, "pool grasps in scenes"),
        ("lift_status", LiftStatus, LiftStatus.LIFTED, admitted, "admitted grasps"),
        ("plan_status", PlanStatus, PlanStatus.SOLVED, frame, "candidates"),
        ("exec_status", ExecStatus, ExecStatus.SUCCESS, planned, "planned candidates"),
    ):
        names = [status.value for status in statuses]
        counts = _status_counts(rows, column)
        blocks.append(f"### `{column}` of {of}")
        blocks.append(_status_table(counts, column, names))
        stem = f"profile-{column}"
        figures[stem] = status_figure(counts, names, good.value, f"{column} of {of}, {tier}")
        blocks.append(f"![{column} by category]({stem}.png)")
    return [*blocks, "### By object", *_hard_to_lift(admitted), _objects_table(frame, grasps)], figures


def _status_counts(rows: pl.DataFrame, column: str) -> dict[str, dict[str, int]]:
    """Number of each status, all together and by category."""
    counts = {"all": dict(rows.group_by(column).len().iter_rows())}
    for category in Category:
        own = rows.filter(pl.col("category") == category.value)
        if not own.is_empty():
            counts[category.value] = dict(own.group_by(column).len().iter_rows())
    return counts


def _status_table(counts: Mapping[str, Mapping[str, int]], column: str, statuses: Sequence[str]) -> str:
    totals = {label: sum(row.values()) for label, row in counts.items()}
    rows = [[f"`{status}`", *(share(row.get(status, 0), totals[label]) for label, row in counts.items())] for status in statuses]
    failed = [sum(n for status, n in row.items() if status != statuses[0]) for row in counts.values()]
    if column == "exec_status":
        rows.append(["*any failure*", *(share(n, total) for n, total in zip(failed, totals.values(), strict=True))])
    return table([column, *(f"{label} ({total:,})" for label, total in totals.items())], rows)


def _objects_table(frame: pl.DataFrame, grasps: pl.DataFrame) -> str:
    rows: list[list[object]] = []
    for object_id in sorted(grasps["object_id"].unique()):
        own = grasps.filter(pl.col("object_id") == object_id)
        admitted = own.filter(pl.col("admission_status") == AdmissionStatus.ADMITTED.value)
        candidates = frame.filter(pl.col("object_id") == object_id)
        planned = candidates.filter("y_plan")
        rows.append(
            [
                f"`{object_id}`",
                own["scene_id"].n_unique(),
                f"{admitted.height / max(1, own['scene_id'].n_unique()):.1f}",
                percent(_share_of(admitted, pl.col("lift_status") == LiftStatus.LIFTED.value)),
                _reasons(admitted.filter(pl.col("lift_status") != LiftStatus.LIFTED.value), "lift_status"),
                count(candidates.height),
                percent(_share_of(candidates, pl.col("y_plan"))),
                percent(_share_of(planned, pl.col("success"))),
            ]
        )
    return table(
        ["object", "scenes", "admitted a scene", "lifted of admitted", "others", "candidates", "planned", "success of planned"], rows
    )


def _hard_to_lift(admitted: pl.DataFrame) -> list[str]:
    """Objects whose grasps do not lift as a roboticist would expect."""
    lifted = (pl.col("lift_status") == LiftStatus.LIFTED.value).mean()
    shares = admitted.group_by("object_id").agg(lifted.alias("lifted")).filter(pl.col("lifted") < MIN_LIFTED_SHARE).sort("object_id")
    names = ", ".join(f"`{name}` ({percent(share_lifted)})" for name, share_lifted in shares.iter_rows())
    text = f"Below {percent(MIN_LIFTED_SHARE)} of admitted grasps lifted: {names}. The card in `objects/catalogue.toml` says why."
    return [text] if names else []


def _reasons(rows: pl.DataFrame, column: str) -> str | None:
    """How often each status occurs, the most frequent first."""
    counts = rows.group_by(column).len().sort(["len", column], descending=[True, False]).rows()
    return ", ".join(f"`{status}` {n}" for status, n in counts) or None


def _share_of(frame: pl.DataFrame, what: pl.Expr) -> float | None:
    return frame.filter(what).height / frame.height if frame.height else None


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
        parts[value] = (covered, percent(_share_of(own, pl.col("y_plan"))), percent(_share_of(planned, pl.col("success"))))
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
