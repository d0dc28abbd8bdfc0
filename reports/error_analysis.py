"""Report of errors: the groups that a learned policy gets most wrong, how to look at each, and what becomes of first choices that fail.

`make reports` makes it; films run stored plans again, so they need a release with its plans and the recipe that it was made with.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import polars as pl
import pyarrow as pa

from pipelines.frames import frame_of
from reports.entries import flat, prediction_frames
from reports.error_films import Films, error_films
from reports.error_overlap import overlap_section
from reports.figures import status_figure
from reports.load import Task, candidate_frame, of_scheme, scheme_note
from reports.metrics import Estimate, is_hard, proportion
from reports.policies import FULL_PLANNER, IK_AND_GRIPPER, LEARNED, LOCAL, Policy, ranked
from reports.ranking import TASK_TITLE
from reports.report import Report, ReportError
from splits.commands import regenerate_command
from splits.markdown import share, table
from tables.vocabulary import ExecStatus, Split, SplitScheme

N_WORST = 20
DESIGNATED_SEED = 42  # single groups are shown as one training orders them
_N_COLOURS = 8  # failing statuses that have a colour of their own

OUTCOME = pl.coalesce(pl.col("exec_status").cast(pl.String), pl.col("plan_status").cast(pl.String)).alias("outcome")


def worst_groups(frame: pl.DataFrame, policy: Policy, task: Task, n: int = N_WORST) -> pl.DataFrame:
    """Covered groups whose first choice fails: those whose first success comes latest, then by regret and name.

    Args:
        frame: candidates of a split with `score` of one training.

    Returns:
        A row a group with `n_candidates`, `n_success`, `rank` of the first success, `regret` (score of the first choice minus that of the
        success with the highest score, nats), `tried` (outcomes of what was tried before it, in order), `first_id` and `success_id`.
    """
    ordered = ranked(frame, policy, task).with_columns(OUTCOME)
    is_before = pl.col("rank") < pl.col("rank").filter("success").min()
    groups = ordered.group_by(task.group, maintain_order=True).agg(
        pl.col("object_id").first(),
        pl.col("n_obstacles").first(),
        pl.len().alias("n_candidates"),
        pl.col("success").sum().alias("n_success"),
        pl.col("rank").filter("success").min().alias("rank"),
        (pl.col("score").first() - pl.col("score").filter("success").max()).alias("regret"),
        pl.col("outcome").filter(is_before).alias("tried"),
        pl.col("candidate_id").first().alias("first_id"),
        pl.col("candidate_id").filter("success").first().alias("success_id"),
    )
    return groups.filter(pl.col("rank") > 1).sort(-pl.col("rank").cast(pl.Int64), -pl.col("regret"), *task.group).head(n)


def errors_report(
    tables: Mapping[str, pa.Table],
    predictions: pa.Table,
    films: Films | None = None,
    *,
    tier: str,
    seed: int,
    scheme: SplitScheme = SplitScheme.SCENE,
    provenance: Mapping[str, str] | None = None,
) -> Report:
    """Report `errors`, of the test split: of the local ranker, or of the first learned policy that there are predictions of.

    Args:
        tables: `candidates`, `splits`, `scenes`, `targets`, `policy_features` of a release.
        predictions: rows of any learned policies.
        films: what films are made of.
        tier: printed in the title, and in the commands.
        seed: of the hash order.
        scheme: by what scenes are dealt to the splits.
        provenance: of the release, for the commands; none is the benchmark's.

    Raises:
        ReportError: predictions of no learned policy.
    """

    def command(name: str) -> str:
        return regenerate_command(name, provenance or {}, tier, f"--filmstrip {name}.png")

    frame = candidate_frame(tables, seed, scheme).filter(pl.col("split") == Split.TEST.value)
    scores, shown = frame_of(predictions), films or Films()
    learned = {policy: own for policy in LEARNED if (own := prediction_frames(frame, scores, policy.variant))}
    if not learned:
        raise ReportError("predictions: 0 learned policies, must be at least 1")
    policy = LOCAL if LOCAL in learned else next(iter(learned))
    own_seed = DESIGNATED_SEED if DESIGNATED_SEED in learned[policy] else min(learned[policy])
    title = f"# Errors of {policy.label.lower()} on tier {tier}{of_scheme(scheme)}, test split"
    blocks, metrics, figures = [title, *scheme_note(scheme), _about(policy, own_seed)], dict[str, float](), dict[str, bytes]()
    rows: list[dict[str, object]] = []
    counted: list[dict[str, object]] = []
    for task in Task:
        worst = worst_groups(learned[policy][own_seed], policy, task)
        section, pictures = _worst_section(worst, task, command, shown)
        blocks += [f"## {TASK_TITLE[task]}: the groups that it gets most wrong", *section]
        figures |= pictures
        rows += [{"task": task.value, "policy": policy.name, "seed": own_seed} | _plain(group) for group in worst.iter_rows(named=True)]
    orders = {IK_AND_GRIPPER: [frame], FULL_PLANNER: [frame], **{own: list(trained.values()) for own, trained in learned.items()}}
    for task in Task:
        firsts = {own: [_first_choices(each, own, task) for each in frames] for own, frames in orders.items()}
        section, values = _failures(firsts[policy], policy, task)
        same, n_wrong = overlap_section(firsts, {own: list(trained) for own, trained in learned.items()}, policy, task)
        counts = {own.label: Counter(name for each in trainings for name in each["outcome"]) for own, trainings in firsts.items()}
        figures[f"errors-first_choice-{task.value}"] = _outcome_figure(counts, f"What becomes of the first choice, {tier}, {task.value}")
        blocks += [f"## {TASK_TITLE[task]}: first choices that fail", *section, *same]
        blocks.append(f"![What becomes of the first choice of each policy in covered groups](errors-first_choice-{task.value}.png)")
        metrics |= values | n_wrong
        for order, trainings in firsts.items():
            failing = _share_of(trainings, pl.col("outcome") != ExecStatus.SUCCESS.value)
            metrics |= flat(f"test.{task.value}.{order.name}.first_choice_fails", failing)
            counted += _counted(trainings, order, task)
    return Report("errors", "\n\n".join(blocks) + "\n", figures, metrics, {"errors-worst": rows, "errors-first_choice": counted})


def _about(policy: Policy, seed: int) -> str:
    return (
        f"Covered groups in which {policy.label.lower()}, training {seed}, tries the most candidates before one succeeds. *Regret* is the"
        " log probability of success that it gave to its first choice minus that of its best success: how sure it was of the wrong one."
        " What was tried is named by status: of planning where there was no plan, else of execution. Every candidate can be made again"
        " from its id and looked at: with a plan as a film, without one as the hand at its place and the reason."
    )


def _worst_section(worst: pl.DataFrame, task: Task, command: Callable[[str], str], films: Films) -> tuple[list[str], dict[str, bytes]]:
    if worst.is_empty():
        return ["There is none: no group is covered, or the first choice succeeds in every one."], {}
    rows = [
        [_name(group), group["object_id"], group["n_obstacles"], group["n_candidates"], group["n_success"], group["rank"],
         f"{group['regret']:.2f}", _tried(group["tried"]), f"`{group['first_id']}`", f"`{group['success_id']}`"]
        for group in worst.iter_rows(named=True)
    ]  # fmt: skip
    header = [
        "group",
        "object",
        "obstacles",
        "candidates",
        "successes",
        "first success at",
        "regret",
        "tried before",
        "first choice",
        "success",
    ]
    commands = "\n".join(command(name) for name in worst["first_id"])
    shown = [table(header, rows, align="llrrrrrlll"), _told(worst), "First choices, to be looked at:", f"```sh\n{commands}\n```"]
    pictures, why_not = error_films(worst["first_id"].to_list(), films)
    if not pictures:
        return [*shown, f"No films: {why_not}."], {}
    by_stem = {f"errors-{task.value}{f'-{k}' if k > 1 else ''}": picture for k, picture in enumerate(pictures, 1)}
    text = (
        f"First choices of the first {min(films.n, worst.height)}, a row each: target green, obstacles brown; where there was no plan, the"
        " state after the lift and beside it the hand, orange, at the place that it could not be brought to."
    )
    return [*shown, text, *(f"![First choices of the worst groups]({stem}.png)" for stem in by_stem)], by_stem


def _told(worst: pl.DataFrame) -> str:
    """What the worst groups have in common: how few successes, and of which objects."""
    n_hard = worst.select(is_hard().sum()).item()
    objects = Counter(worst["object_id"].sort()).most_common()
    shown = ", ".join(f"{name} {n}" for name, n in objects)
    return f"{n_hard} of these {worst.height} hold one or two successes; by object: {shown}."


def _name(group: Mapping[str, Any]) -> str:
    return group["scene_id"] if "target_id" not in group else f"{group['scene_id']}-t{group['target_id']}"


def _tried(outcomes: Sequence[str]) -> str:
    """`3 off_target, 1 no_ik`, in the order in which they were first tried."""
    return ", ".join(f"{n} {name}" for name, n in Counter(outcomes).items()) or "nothing"


def _plain(group: Mapping[str, Any]) -> dict[str, object]:
    """A group as a row of a CSV, the same columns in both tasks."""
    rest = {name: value for name, value in group.items() if name not in ("scene_id", "target_id", "tried")}
    return {"scene_id": group["scene_id"], "target_id": group.get("target_id"), **rest, "tried": " ".join(group["tried"])}


def _first_choices(frame: pl.DataFrame, policy: Policy, task: Task) -> pl.DataFrame:
    """What is tried first in each covered group, with its `outcome`."""
    covered = frame.filter(pl.col("success").any().over(task.group))
    return ranked(covered, policy, task).filter(pl.col("rank") == 1).with_columns(OUTCOME).sort(task.group)


def _share_of(trainings: Sequence[pl.DataFrame], is_it: pl.Expr) -> Estimate | None:
    hits = np.stack([own.select(is_it.alias("hit"))["hit"].to_numpy() for own in trainings])
    return proportion(hits, trainings[0]["scene_id"].to_list())


def _failures(trainings: Sequence[pl.DataFrame], policy: Policy, task: Task) -> tuple[list[str], dict[str, float]]:
    """First choices by what becomes of them and by category, over all trainings."""
    both = pl.concat(own.select("category", "outcome") for own in trainings)
    if both.is_empty():
        return ["No group is covered."], {}
    categories = sorted(both["category"].cast(pl.String).unique().to_list())
    counts = Counter(both.select(pl.col("category").cast(pl.String), "outcome").iter_rows())
    n_of = {category: sum(n for (own, _), n in counts.items() if own == category) for category in categories}
    totals = Counter(both["outcome"])
    outcomes = sorted(totals, key=lambda name: (name != ExecStatus.SUCCESS.value, -totals[name], name))
    rows: list[list[object]] = []
    metrics: dict[str, float] = {}
    for name in outcomes:
        estimate = _share_of(trainings, pl.col("outcome") == name)
        rows.append([name.replace("_", " "), estimate, *(share(counts[category, name], n_of[category]) for category in categories)])
        metrics |= flat(f"test.{task.value}.{policy.name}.first_choice.{name}", estimate)
    header = ["first choice", "all covered groups, % [95 %]", *(f"{category}, n = {n_of[category]:,}" for category in categories)]
    trained = f"{len(trainings)} trainings" if len(trainings) > 1 else "one training"
    return [f"{policy.label}, {trained}: a group counts once a training.", table(header, rows)], metrics


def _counted(trainings: Sequence[pl.DataFrame], policy: Policy, task: Task) -> list[dict[str, object]]:
    both = pl.concat(own.select(pl.col("category").cast(pl.String), "outcome") for own in trainings)
    return [
        {"task": task.value, "policy": policy.name, "n_trainings": len(trainings), "category": category, "outcome": name, "n": n}
        for (category, name), n in sorted(Counter(both.iter_rows()).items())
    ]


def _outcome_figure(counts: Mapping[str, Mapping[str, int]], title: str) -> bytes:
    """Outcomes as shares, those that are rare together as one."""
    total = Counter[str]()
    for own in counts.values():
        total.update(own)
    good = ExecStatus.SUCCESS.value
    failing = sorted((name for name in total if name != good), key=lambda name: (-total[name], name))
    common, rare = failing[:_N_COLOURS], failing[_N_COLOURS:]
    shown = {
        label: {name: own.get(name, 0) for name in (good, *common)} | {"other": sum(own.get(name, 0) for name in rare)}
        for label, own in counts.items()
    }
    return status_figure(shown, [good, *common, "other"], good, title)
