"""Report of what a ranking saves: planner calls until the first plan of every order, and seconds a group against planning everything.

`make reports` makes it; it needs decision times and planning costs, which are tables beside a release.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import Enum

import numpy as np
import polars as pl
import pyarrow as pa
from jaxtyping import Float

from pipelines.frames import frame_of
from reports import paper
from reports.costs import Costs
from reports.decision_times import decision_time_rows, decision_time_section
from reports.entries import flat, prediction_frames, shown_rank
from reports.load import Task, candidate_frame, of_scheme, scheme_note
from reports.metrics import MIN_SCENES, Estimate
from reports.policies import FULL_PLANNER, LEARNED, RANDOM, RANKER, UNLEARNED, Policy, decision_cost, ranked
from reports.ranker_figures import seconds_figure
from reports.ranking import TASK_TITLE
from reports.report import Report, ReportError
from reports.resampling import Draws, SceneBootstrap
from splits.markdown import table
from tables.vocabulary import Split, SplitScheme


class Stop(Enum):
    """Until when candidates are planned, in order: what it is called among metrics, in words, and the rank that it stops at."""

    PLAN = ("first_plan", "until the first plan, groups with a plan", pl.col("first_plan"))
    SUCCESS = ("first_success", "until the first success, covered groups", pl.col("first_success"))
    END = ("any", "until the first plan or the end, all groups with candidates", pl.col("first_plan").fill_null(pl.col("n_candidates")))

    def __init__(self, key: str, title: str, rank: pl.Expr) -> None:
        self.key, self.title, self.rank = key, title, rank


def planned_in_order(ordered: pl.DataFrame, task: Task) -> pl.DataFrame:
    """What becomes of planning the candidates of each group in an order.

    Args:
        ordered: candidates with `rank`, `y_plan`, `success` and `planning_s`.
        task: what a group is.

    Returns:
        A row a group, sorted: `first_plan` and `first_success` (ranks, null where there is none), `n_candidates`, seconds of planning
        until each stop (`first_plan_s`, `first_success_s`, null where there is none, and `any_s`), and `everything_s`.
    """
    firsts = ordered.with_columns(
        pl.col("rank").filter("y_plan").min().over(task.group).alias("first_plan"),
        pl.col("rank").filter("success").min().over(task.group).alias("first_success"),
        pl.len().over(task.group).alias("n_candidates"),
    )
    stops = firsts.with_columns(stop.rank.alias(f"_{stop.key}") for stop in Stop)
    until = [
        pl.when(pl.col(f"_{stop.key}").first().is_not_null())
        .then(pl.col("planning_s").filter(pl.col("rank") <= pl.col(f"_{stop.key}")).sum())
        .alias(f"{stop.key}_s")
        for stop in Stop
    ]
    kept = [pl.col(name).first() for name in ("first_plan", "first_success", "n_candidates")]
    return stops.group_by(task.group).agg(*kept, *until, pl.col("planning_s").sum().alias("everything_s")).sort(task.group)


def planner_calls_report(
    tables: Mapping[str, pa.Table],
    predictions: pa.Table | None,
    costs: Costs,
    *,
    tier: str,
    seed: int,
    scheme: SplitScheme = SplitScheme.SCENE,
) -> Report:
    """Report `planner_calls`, of the test split.

    Args:
        tables: `candidates`, `splits`, `scenes`, `targets`, `policy_features` of a release.
        predictions: rows of any learned policies; None for none.
        costs: what deciding and planning took.
        tier: printed in the title.
        seed: of the hash order and the resampling.
        scheme: by what scenes are dealt to the splits.

    Raises:
        ReportError: planning costs without a candidate of the test split.
    """
    frame = candidate_frame(tables, seed, scheme).filter(pl.col("split") == Split.TEST.value)
    frame = _with_planning(frame, costs.planning)
    scores = None if predictions is None else frame_of(predictions)
    blocks = [f"# Planner calls on tier {tier}{of_scheme(scheme)}, test split", *scheme_note(scheme), _about(costs, scheme)]
    metrics: dict[str, float] = {}
    panels: dict[str, dict[str, tuple[float, Estimate | None, float]]] = {}
    counted: list[dict[str, object]] = []
    for task in Task:
        orders = {
            policy: [planned_in_order(ranked(own, policy, task), task) for own in frames] for policy, frames in _frames(frame, scores)
        }
        prefix = f"test.{task.value}"
        blocks.append(f"## {TASK_TITLE[task]}")
        section, values = _calls(orders, task, seed, prefix, is_paper=scheme is SplitScheme.SCENE)
        blocks += section
        metrics |= values
        counted += _distribution(orders, task)
        if costs.planning is None:
            continue
        decisions = {policy: _decision_s(policy, frame, costs.timings, task) for policy in orders}
        for stop in Stop:
            section, values, bars = _seconds(orders, decisions, stop, task, seed, prefix)
            blocks += section
            metrics |= values
            if stop is Stop.PLAN and bars:
                panels[f"{TASK_TITLE[task]}, {Stop.PLAN.title}"] = bars
    figures = {}
    if panels:
        figures["planner_calls"] = seconds_figure(panels, f"Rank, then plan, {tier}{of_scheme(scheme)}".replace("`", ""))
        blocks.append("![Seconds a group of every order, and of planning everything](planner_calls.png)")
    if costs.planning is None:
        blocks += ["## Seconds a group", f"Not known: {costs.why_no_planning}."]
    times = decision_time_rows(frame, costs.timings)
    blocks += decision_time_section(times, costs.machine)
    more = {"planner_calls-distribution": counted, "planner_calls-decision_times": times}
    return Report("planner_calls", "\n\n".join(blocks) + "\n", figures, metrics, more)


def _about(costs: Costs, scheme: SplitScheme) -> str:
    in_paper = f" Paper: Section VI-A, its ranker; median {paper.PLANNER_CALLS_MEDIAN}, 90th percentile {paper.PLANNER_CALLS_P90}."
    return (
        "Candidates are handed to the planner in the order of a policy until one has a plan. Calls are means over the trainings, and all"
        " orders are of the same groups, so that differences are paired; intervals are 95 %, scenes resampled and the error of few"
        f" trainings added (of one training: of this very one), none below {MIN_SCENES} scenes. **Seconds a group are a sum**: the"
        " policy's mean decision time (wall-clock of learned policies, core time of others) and the core time of our own planner on each"
        f" candidate that is handed to it, {costs.planning_measured}; nothing is counted for execution. Planning everything hands over all"
        " candidates of the group, as the full-pool planner must before it can choose. Policies whose decision was not timed show"
        f" planning alone.{in_paper if scheme is SplitScheme.SCENE else ''}"
    )


def _with_planning(frame: pl.DataFrame, planning: pa.Table | None) -> pl.DataFrame:
    if planning is None:
        return frame.with_columns(pl.lit(0.0).alias("planning_s"))
    own = frame_of(planning).select("candidate_id", (pl.col("core_ms").cast(pl.Float64) / 1e3).alias("planning_s"))
    joined = frame.join(own, on="candidate_id", how="left")
    lost = joined.filter(pl.col("planning_s").is_null()).sort("candidate_id")
    if not lost.is_empty():
        raise ReportError(f"planner_costs: {lost['candidate_id'][0]} has no row ({lost.height} test candidates have none, must be 0)")
    return joined


def _frames(frame: pl.DataFrame, scores: pl.DataFrame | None) -> list[tuple[Policy, list[pl.DataFrame]]]:
    """Every order that hands candidates to a planner; the full-pool planner's is what it is compared with."""
    learned = [(policy, list(prediction_frames(frame, scores, policy.variant).values())) for policy in LEARNED]
    return [*((policy, [frame]) for policy in UNLEARNED if policy is not FULL_PLANNER), *((p, frames) for p, frames in learned if frames)]


def _decision_s(policy: Policy, frame: pl.DataFrame, timings: pl.DataFrame, task: Task) -> float | None:
    if policy.is_free:
        return None if policy.is_learned else 0.0
    cost = decision_cost(policy, frame, timings, task)
    return None if cost is None else cost.mean_ms / 1e3


def _calls(
    orders: Mapping[Policy, list[pl.DataFrame]], task: Task, seed: int, prefix: str, *, is_paper: bool
) -> tuple[list[str], dict[str, float]]:
    """Calls until the first plan, and how many fewer or more they are than in every other order."""
    planned = orders[RANDOM][0].filter(pl.col("first_plan").is_not_null())
    if planned.is_empty():
        return ["No group has a plan."], {}
    bootstrap = SceneBootstrap(planned["scene_id"].to_list(), seed)
    calls = {policy: _column(own, "first_plan") for policy, own in orders.items()}
    draws = {policy: bootstrap.mean(own, policy.name) for policy, own in calls.items()}
    rows: list[list[object]] = []
    metrics = {f"{prefix}.n_groups_with_plan": float(planned.height)}
    for policy, own in calls.items():
        median, p90 = float(np.median(own)), float(np.quantile(own, 0.9, method="higher"))
        theirs = f"{paper.PLANNER_CALLS_MEAN[task]:.2f}" if is_paper and policy is RANKER else None
        rows.append([policy.label, _shown(draws[policy], bootstrap), f"{median:g}", f"{p90:g}", theirs])
        metrics |= {f"{prefix}.{policy.name}.calls_median": median, f"{prefix}.{policy.name}.calls_p90": p90}
        metrics |= _metric(f"{prefix}.{policy.name}.calls", draws[policy], bootstrap)
    text = f"{planned.height:,} of {orders[RANDOM][0].height:,} groups with candidates have a plan."
    blocks = [text, table(["planner calls until the first plan", "mean [95 %]", "median", "90th percentile", "paper, mean"], rows)]
    learned = [policy for policy in orders if policy.is_learned]
    if learned and bootstrap.is_telling:
        cells = [[_difference(draws, row, column) for column in learned] for row in orders]
        header = ["calls of, minus those of", *(policy.label for policy in learned)]
        blocks.append(table(header, [[row.label, *own] for row, own in zip(orders, cells, strict=True)]))
        for column in learned:
            for row in orders:
                if row is not column:
                    metrics |= flat(f"{prefix}.{row.name}_minus_{column.name}.calls", (draws[row] - draws[column]).estimate())
    return blocks, metrics


def _difference(draws: Mapping[Policy, Draws], row: Policy, column: Policy) -> str | None:
    return None if row is column else shown_rank((draws[row] - draws[column]).estimate())


def _seconds(
    orders: Mapping[Policy, list[pl.DataFrame]], decisions: Mapping[Policy, float | None], stop: Stop, task: Task, seed: int, prefix: str
) -> tuple[list[str], dict[str, float], dict[str, tuple[float, Estimate | None, float]]]:
    """Seconds a group until a stop, and by what factor planning everything takes longer."""
    those = orders[RANDOM][0].filter(pl.col(f"{stop.key}_s").is_not_null())
    if those.is_empty():
        return [f"### Seconds {stop.title}", "There is no such group."], {}, {}
    bootstrap = SceneBootstrap(those["scene_id"].to_list(), seed)
    everything = bootstrap.mean(those["everything_s"].to_numpy())
    rows: list[list[object]] = []
    metrics = _metric(f"{prefix}.{stop.key}.everything_s", everything, bootstrap)
    bars: dict[str, tuple[float, Estimate | None, float]] = {}
    for policy, own in orders.items():
        planning_s, decision_s = _column(own, f"{stop.key}_s"), decisions[policy]
        planning = bootstrap.mean(planning_s, policy.name)
        name = f"{prefix}.{policy.name}.{stop.key}"
        metrics |= _metric(f"{name}.planning_s", planning, bootstrap)
        cells: list[object] = ["not timed", _shown(planning, bootstrap, 3), None, None]
        if decision_s is not None:
            total = bootstrap.mean(planning_s + decision_s, policy.name)
            cells = [f"{decision_s:.3f}", cells[1], _shown(total, bootstrap, 3), _shown(everything / total, bootstrap, 1)]
            metrics |= _metric(f"{name}.total_s", total, bootstrap) | _metric(f"{name}.speed_up", everything / total, bootstrap)
            metrics[f"{prefix}.{policy.name}.decision_s"] = decision_s
            bars[policy.label] = (decision_s, total.estimate() if bootstrap.is_telling else _point(total), everything.value)
        rows.append([policy.label, *cells])
    rows.append(["Planning everything", None, _shown(everything, bootstrap, 3), _shown(everything, bootstrap, 3), "1"])
    header = ["seconds a group", "decision", "planning [95 %]", "in all [95 %]", "times faster than everything [95 %]"]
    return [f"### Seconds {stop.title}", f"{those.height:,} groups.", table(header, rows)], metrics, bars


def _point(draws: Draws) -> Estimate:
    return Estimate(draws.value, draws.value, draws.value, draws.n, draws.n_scenes)


def _column(own: Sequence[pl.DataFrame], name: str) -> Float[np.ndarray, "r n"]:
    """A column of the groups that have a value in it, which are the same in every order: a row a training."""
    return np.stack([groups[name].drop_nulls().to_numpy().astype(np.float64) for groups in own])


def _distribution(orders: Mapping[Policy, list[pl.DataFrame]], task: Task) -> list[dict[str, object]]:
    """How many groups take how many calls, over all trainings."""
    rows: list[dict[str, object]] = []
    for policy, own in orders.items():
        values, counts = np.unique(_column(own, "first_plan"), return_counts=True)
        rows += [
            {"task": task.value, "policy": policy.name, "n_trainings": len(own), "calls": int(value), "n_groups": int(n)}
            for value, n in zip(values, counts, strict=True)
        ]
    return rows


def _shown(draws: Draws, bootstrap: SceneBootstrap, digits: int = 2) -> str:
    if not bootstrap.is_telling:
        return f"{draws.value:.{digits}f}"
    own = draws.estimate()
    return f"{own.value:.{digits}f} [{own.low:.{digits}f}, {own.high:.{digits}f}]"


def _metric(name: str, draws: Draws, bootstrap: SceneBootstrap) -> dict[str, float]:
    return flat(name, draws.estimate()) if bootstrap.is_telling else {name: draws.value}
