"""A policy put to the test on some groups: its ranks, S_K and decision time; the reports print them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import polars as pl
import pyarrow as pa

from model.decision_times import DecisionTime
from pipelines.frames import frame_of
from reports.load import Task
from reports.metrics import Estimate, group_ranks, success_at_k
from reports.policies import LEARNED, DecisionCost, Policy, decision_cost, ranked

KS = (1, 3, 5)
MACHINE = "machine"  # what a table of decision times calls the machine that it was measured on, in its sidecar
TASK_TITLE = {Task.JOINT: "Joint grasp and target", Task.FIXED: "Fixed target"}


@dataclass(frozen=True, slots=True, eq=False)
class Ranking:
    """One policy on one task: a row a group in `ranks`, S_K by K, what ordering a group costs."""

    policy: Policy
    task: Task
    ranks: pl.DataFrame
    s: dict[int, Estimate | None]
    cost: DecisionCost | None

    @property
    def covered(self) -> pl.DataFrame:
        """The groups that hold a success."""
        return self.ranks.filter(pl.col("first_success").is_not_null())


def rank_groups(frame: pl.DataFrame, policy: Policy, task: Task, timings: pl.DataFrame) -> Ranking:
    """Order every group of a candidate frame by a policy and judge the order.

    Args:
        frame: candidates, with predictions where the policy is learned.
        timings: frame of `timings`; empty where nothing was measured.
    """
    ranks = group_ranks(ranked(frame, policy, task), task)
    return Ranking(policy, task, ranks, {k: success_at_k(ranks, k) for k in KS}, decision_cost(policy, frame, timings, task))


def timing_frame(tables: Mapping[str, pa.Table], ranker_timings: pa.Table | None = None) -> pl.DataFrame:
    """Frame of `timings`, empty without the table; what was measured on rankers themselves replaces the rows of their stages."""
    parts: Sequence[pl.DataFrame] = [frame_of(tables["timings"])] if "timings" in tables else []
    if ranker_timings is not None:
        measured = frame_of(ranker_timings)
        parts = [part.filter(~pl.col("stage").is_in(measured["stage"].unique().to_list())) for part in parts] + [measured]
    return pl.concat(parts) if parts else pl.DataFrame(schema={"stage": pl.String, "item_id": pl.String, "core_ms": pl.Float64})


def stage_of_variant(variant: str) -> str:
    """Stage of `timings` in which the decision times of a variant are; raises KeyError where its policy is not timed."""
    return {policy.variant: policy.group_stage for policy in LEARNED if policy.group_stage}[variant]


def ranker_timing_rows(times: Iterable[DecisionTime], variant: str) -> list[dict[str, Any]]:
    """Rows of `timings`, one a timed group of a variant: from the points of the scene in memory to scores."""
    return [
        {
            "stage": stage_of_variant(variant),
            "item_id": time.scene_id if time.target_id is None else f"{time.scene_id}-t{time.target_id}",
            "core_ms": 1e3 * (time.prepare_s + time.forward_s),
        }
        for time in times
    ]
