"""What the labels cost in core time, stage by stage, beside the planner of the paper; the times are measured in pipelines/running/."""

from __future__ import annotations

import numpy as np
import polars as pl

from reports import paper
from reports.load import Task
from splits.markdown import count, table

# What a label costs: every stage up to execution. The endpoint policies and the ranker judge labels, they do not make them.
_NOT_LABELLING = ("policy_ik", "policy_gripper", "policy_features", "ranker")


def core_time_section(timings: pl.DataFrame, n_candidates: int) -> tuple[list[str], dict[str, float]]:
    """Markdown blocks and metrics: core-milliseconds of every timed stage, and candidates a core-hour.

    Args:
        timings: frame of `timings`; empty where nothing was measured.
        n_candidates: candidates that the timed stages made.
    """
    if timings.is_empty():
        return ["## Core time", "Not measured."], {}
    rows: list[list[object]] = []
    metrics: dict[str, float] = {}
    labelling_ms = 0.0
    for (stage,), own in sorted(timings.partition_by("stage", as_dict=True).items()):
        core_ms = own["core_ms"].to_numpy()
        total_ms = float(core_ms.sum())
        labelling_ms += total_ms if stage not in _NOT_LABELLING else 0.0
        median, p95 = np.median(core_ms), np.quantile(core_ms, 0.95)
        hours = f"{total_ms / 3.6e6:.3g}"
        rows.append([f"`{stage}`", count(len(core_ms)), f"{core_ms.mean():.2f}", f"{median:.2f}", f"{p95:.2f}", hours])
        metrics[f"core_ms.{stage}"] = float(core_ms.mean())
    theirs = paper.RANKING[Task.JOINT, "full_planner"].seconds
    assert theirs is not None
    text = (
        f"{labelling_ms / max(1, n_candidates):.1f} core-ms a candidate for all stages that make labels, or"
        f" {n_candidates / labelling_ms * 3.6e6:,.0f} candidates a core-hour. The paper's planner took"
        f" {theirs / paper.CANDIDATES_PER_JOINT_GROUP_TEST * 1e3:,.0f} ms a candidate (derived from {paper.RANKING_SOURCE}) on a GPU."
    )
    metrics["candidates_per_core_hour"] = n_candidates / labelling_ms * 3.6e6
    header = ["stage", "items", "mean core-ms", "median", "p95", "core-hours in all"]
    return ["## Core time", table(header, rows), text], metrics
