"""Report of label repeatability: which candidates are executed again, chosen blindly, and how often the label comes out the same.

They are executed in pipelines/proofs/; this module chooses before any outcome is read, and compares afterwards.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import polars as pl
import pyarrow as pa

from pipelines.frames import frame_of
from reports import paper
from reports.figures import shares_figure
from reports.metrics import Estimate, clopper_pearson
from reports.report import Report, ReportError
from splits.markdown import table
from tables.identity import order_key
from tables.schemas import LABEL_COLUMNS
from tables.vocabulary import Perturbation, PlanStatus

# As many of the chosen tasks as the paper repeats, and as often.
N_TASKS_REPEATED = paper.N_TASKS_REPEATED
N_REPEATS = paper.N_REPEATS // paper.N_TASKS_REPEATED

# |tolerance_margin| of the stored label: 0 is exactly at the tolerance, 1 exactly on the target or twice the tolerance away.
_MARGIN_BINS = (0.0, 0.05, 0.1, 0.25, 0.5, 0.75, 1.0, float("inf"))

# Largest motion in the hand before release, of the stored execution, in millimetres.
_SLIP_BINS = (0.0, 1.0, 2.0, 5.0, 10.0, 20.0, float("inf"))

_SLIPPING_M, _NEAR_MARGIN = 0.005, 0.25

_STAGES = {
    "plan_status": "planning status",
    "exec_status": "execution status",
    "success": "final outcome (success or not)",
    "three_class": "three-class outcome (planning failure, downstream failure, success)",
    "is_identical": "every stored label column bit-identical",
}


@dataclass(frozen=True, slots=True)
class RepeatTask:
    """One candidate to execute again: it stands for its fixed-target group."""

    candidate_id: str
    scene_id: str
    target_id: int
    n_repeats: int


def choose_tasks(
    candidates: pa.Table, seed: int, n: int = paper.N_REPEAT_TASKS, *, n_repeated: int = N_TASKS_REPEATED, n_repeats: int = N_REPEATS
) -> list[RepeatTask]:
    """The n fixed-target groups whose identity hashes lowest, each with its candidate that hashes lowest; the first few several times.

    Args:
        candidates: columns `candidate_id`, `scene_id` and `target_id`, such as `candidate_pairs`; no label column may be among them, so
            that the choice cannot depend on an outcome.
        seed: the recipe seed.
        n: number of groups; all of them where there are fewer.
        n_repeated: how many of them, in hash order, are executed `n_repeats` times; the others once.
        n_repeats: executions of those.

    Raises:
        ReportError: a label column is present.
    """
    seen = sorted(set(LABEL_COLUMNS) & set(candidates.column_names))
    if seen:
        raise ReportError(f"candidates: label column {seen[0]!r} is present ({len(seen)} are, must be 0): tasks are chosen blindly")
    frame = frame_of(candidates, ["candidate_id", "scene_id", "target_id"])
    groups = frame.group_by("scene_id", "target_id").agg("candidate_id")
    by_hash = sorted(groups.iter_rows(), key=lambda group: order_key(seed, "repeatability_task", group[0], group[1]))
    return [
        RepeatTask(
            min(candidate_ids, key=lambda candidate_id: order_key(seed, "repeatability_candidate", candidate_id)),
            scene_id,
            target_id,
            n_repeats if number < n_repeated else 1,
        )
        for number, (scene_id, target_id, candidate_ids) in enumerate(by_hash[:n])
    ]


def repeatability_report(attempts: pa.Table, candidates: pa.Table, *, tier: str) -> Report:
    """Report `repeatability`.

    Args:
        attempts: table `attempts`, any perturbations.
        candidates: table `candidates`, the stored labels.
        tier: printed in the title.

    Raises:
        ReportError: an attempt of an unknown candidate, or one whose own comparison with the stored label is wrong.
    """
    frame = _compared(frame_of(attempts), frame_of(candidates))
    fresh = frame.filter(pl.col("perturbation") == Perturbation.FRESH.value)
    perturbed = frame.filter(pl.col("perturbation") != Perturbation.FRESH.value)
    blocks = [f"# Label repeatability on tier {tier}"]
    metrics: dict[str, float] = {}
    figures: dict[str, bytes] = {}
    section, values = _fresh_section(fresh)
    blocks += section
    metrics |= values
    if not perturbed.is_empty():
        section, values, png = _perturbed_section(perturbed)
        blocks += [*section, "![Flip rate by distance from the tolerance](repeatability-margin.png)"]
        metrics |= values
        figures["repeatability-margin"] = png
    return Report("repeatability", "\n\n".join(blocks) + "\n", figures, metrics)


def _compared(attempts: pl.DataFrame, candidates: pl.DataFrame) -> pl.DataFrame:
    """One row an attempt with the stored label beside it and a flag for every stage that differs."""
    stored = candidates.select("candidate_id", "category", "plan_status", "exec_status", "tolerance_margin", "transport_slip_m")
    frame = attempts.join(stored, on="candidate_id", how="left", suffix="_stored")
    strange = frame.filter(pl.col("plan_status_stored").is_null())
    if not strange.is_empty():
        raise ReportError(f"attempts: {strange['candidate_id'].sort()[0]} is no candidate ({strange.height} attempts, must be 0)")
    frame = frame.with_columns(
        pl.col("plan_status").ne_missing(pl.col("plan_status_stored")).alias("plan_status_differs"),
        pl.col("exec_status").ne_missing(pl.col("exec_status_stored")).alias("exec_status_differs"),
        pl.col("is_identical").not_().alias("is_identical_differs"),
        _outcome("").alias("outcome"),
        _outcome("_stored").alias("outcome_stored"),
    ).with_columns(
        (pl.col("outcome") != pl.col("outcome_stored")).alias("three_class_differs"),
        ((pl.col("outcome") == "success") != (pl.col("outcome_stored") == "success")).alias("success_differs"),
    )
    wrong = frame.filter(
        (pl.col("exec_matches") == pl.col("exec_status_differs")) | (pl.col("plan_matches") == pl.col("plan_status_differs"))
    )
    if not wrong.is_empty():
        first = wrong.sort("candidate_id", "perturbation", "repeat").row(0, named=True)
        raise ReportError(
            f"attempts: {first['candidate_id']}, {first['perturbation']}, repeat {first['repeat']}: plan_matches {first['plan_matches']},"
            f" exec_matches {first['exec_matches']}, but {first['plan_status']} / {first['exec_status']} against the stored"
            f" {first['plan_status_stored']} / {first['exec_status_stored']}"
        )
    return frame.sort("candidate_id", "perturbation", "repeat")


def _outcome(suffix: str) -> pl.Expr:
    planned = pl.col(f"plan_status{suffix}") == PlanStatus.SOLVED.value
    succeeded = pl.col(f"exec_status{suffix}").eq_missing(pl.lit("success"))
    return (
        pl.when(~planned).then(pl.lit("planning failure")).when(succeeded).then(pl.lit("success")).otherwise(pl.lit("downstream failure"))
    )


def _fresh_section(fresh: pl.DataFrame) -> tuple[list[str], dict[str, float]]:
    if fresh.is_empty():
        return ["## Fresh executions", "None were made."], {}
    first = fresh.filter(pl.col("repeat") == pl.col("repeat").min().over("candidate_id"))
    often = fresh.filter(pl.len().over("candidate_id") > 1)
    outcomes = dict(first.group_by("outcome_stored").len().iter_rows())
    mixture = table(
        ["stored outcome of the chosen tasks", "ours", "paper"],
        [[name, outcomes.get(name, 0), n] for name, n in paper.REPEAT_OUTCOMES.items()],
    )
    rows = []
    metrics: dict[str, float] = {"fresh.n_executions": float(fresh.height), "fresh.n_tasks": float(first.height)}
    for stage, label in _STAGES.items():
        rows.append([label, _matches(first, stage), _matches(often, stage), _mismatch(first, stage)])
        metrics[f"fresh.{stage}.mismatches"] = float(fresh[f"{stage}_differs"].sum())
    n_often = often["candidate_id"].n_unique()
    theirs = (
        f"{paper.N_REPEAT_MATCHES}/{paper.N_REPEAT_TASKS} tasks and {paper.N_REPEATS}/{paper.N_REPEATS} repeats match in planning, final"
        f" and three-class outcome, {paper.N_REPEAT_EXECUTIONS} executions"
    )
    text = (
        f"{first.height} fixed-target tasks chosen by hash before any outcome was read, one candidate each, executed again from the recipe"
        f" in a fresh process; {n_often} of them repeatedly, {fresh.height} executions in all. Paper ({paper.REPEATABILITY_SOURCE}):"
        f" {theirs}. Intervals are exact binomial (Clopper and Pearson), over tasks: repeats of a task are not independent of it."
    )
    header = ["stage", "tasks that match", "repeats that match", "mismatch rate [95 %]"]
    return ["## Fresh executions", text, mixture, table(header, rows)], metrics


def _perturbed_section(perturbed: pl.DataFrame) -> tuple[list[str], dict[str, float], bytes]:
    executed = perturbed.filter(pl.col("outcome_stored") != "planning failure")
    metrics: dict[str, float] = {}
    stages = [stage for stage in _STAGES if stage != "is_identical"]
    by_stage = []
    for perturbation in Perturbation:
        own = perturbed.filter(pl.col("perturbation") == perturbation.value)
        if not own.is_empty():
            by_stage.append([f"`{perturbation.value}`", f"{own.height:,}", *(_mismatch(own, stage) for stage in stages)])
            metrics[f"{perturbation.name.lower()}.flip_rate"] = _rate(own, "success")
    categories = sorted(executed["category"].unique())
    by_category = [
        [
            f"`{perturbation.value}`",
            *(_mismatch(executed.filter(_is(perturbation) & (pl.col("category") == c)), "success") for c in categories),
        ]
        for perturbation in Perturbation
        if not executed.filter(_is(perturbation)).is_empty()
    ]
    by_status = [
        [f"`{status}`", _mismatch(own, "success"), _mismatch(own, "exec_status")]
        for (status,), own in sorted(executed.partition_by("exec_status_stored", as_dict=True).items(), key=lambda item: -item[1].height)
    ]
    bins = _binned(executed, pl.col("tolerance_margin").abs(), _MARGIN_BINS)
    slip_bins = _binned(executed, 1e3 * pl.col("transport_slip_m"), _SLIP_BINS)
    figure_rows = {label: _estimate(own, "success") for label, own in bins.items()}
    metrics["executed.flip_rate"] = _rate(executed, "success")
    blocks = [
        "## Executions under changes that mean nothing physically",
        "A label *flips* when success becomes failure or the reverse. Rates are of attempts, with exact binomial intervals; attempts of one"
        " candidate under different changes are related, so pooled intervals are somewhat too narrow. A flip rate is the floor below which"
        " no policy's error can be told from the label's.",
        table(["perturbation", "attempts", *(f"{_STAGES[stage].split(' (')[0]} differs" for stage in stages)], by_stage),
        "### Flips by category, planned candidates",
        table(["perturbation", *categories], by_category),
        "### Flips by distance from the tolerance, planned candidates",
        "Distance is |`tolerance_margin`| of the stored label; *none* are executions that ended without a final pose to judge.",
        _flips(bins, "distance"),
        "### Flips by slip in the hand, planned candidates",
        "An object that slips may fall or hold far from any tolerance, which is why distance alone does not tell. Slip is"
        f" `transport_slip_m` of the stored execution. {_share_slipping(executed)}",
        _flips(slip_bins, "slip [mm]"),
        "### Flips by stored execution status",
        table(["stored status", "flips [95 %]", "status differs [95 %]"], by_status),
    ]
    return blocks, metrics, shares_figure(figure_rows, "Labels that flip, by distance from the tolerance", "attempts that flip [%]")


def _binned(executed: pl.DataFrame, value: pl.Expr, edges: Sequence[float]) -> dict[str, pl.DataFrame]:
    bins = {}
    for low, high in pairwise(edges):
        label = f"{low:g} to {high:g}" if high < float("inf") else f"from {low:g}"
        bins[label] = executed.filter((value >= low) & (value < high))
    bins["none"] = executed.filter(value.is_null())
    return {label: own for label, own in bins.items() if not own.is_empty()}


def _share_slipping(executed: pl.DataFrame) -> str:
    """How many of the flips slip, and how rarely what neither slips nor is near the tolerance flips."""
    flips = executed.filter("success_differs")
    slipping = flips.filter(pl.col("transport_slip_m") >= _SLIPPING_M)
    steady = executed.filter((pl.col("transport_slip_m") < _SLIPPING_M) & (pl.col("tolerance_margin").abs() >= _NEAR_MARGIN))
    return (
        f"Of {flips.height} flips, {slipping.height} slip {1e3 * _SLIPPING_M:g} mm or more. Of executions that slip less and end at least"
        f" {_NEAR_MARGIN:g} from the tolerance, {_mismatch(steady, 'success') or 'none were made'} flip."
    )


def _flips(bins: Mapping[str, pl.DataFrame], title: str) -> str:
    return table([title, "attempts", "flips [95 %]"], [[label, own.height, _mismatch(own, "success")] for label, own in bins.items()])


def _is(perturbation: Perturbation) -> pl.Expr:
    return pl.col("perturbation") == perturbation.value


def _matches(frame: pl.DataFrame, stage: str) -> str | None:
    return f"{frame.height - frame[f'{stage}_differs'].sum()}/{frame.height}" if frame.height else None


def _estimate(frame: pl.DataFrame, stage: str) -> Estimate | None:
    return clopper_pearson(int(frame[f"{stage}_differs"].sum()), frame.height)


def _mismatch(frame: pl.DataFrame, stage: str) -> str | None:
    estimate = _estimate(frame, stage)
    return None if estimate is None else f"{frame[f'{stage}_differs'].sum()}/{frame.height}: {estimate} %"


def _rate(frame: pl.DataFrame, stage: str) -> float:
    values: Sequence[bool] = frame[f"{stage}_differs"].to_list()
    return sum(values) / len(values) if values else 0.0
