"""A policy put to the test on some groups: its ranks, S_K and decision time; the reports print them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import polars as pl
import pyarrow as pa

from pipelines.frames import frame_of
from reports.load import Task
from reports.metrics import Estimate, group_ranks, success_at_k
from reports.policies import DecisionCost, Policy, decision_cost, ranked

if TYPE_CHECKING:  # torch is not needed to read a report's tables
    from model.scoring import DecisionTime

KS = (1, 3, 5)
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
    """Frame of `timings`, empty without the table; what was measured on the ranker itself replaces the rows of its stage."""
    parts: Sequence[pl.DataFrame] = [frame_of(tables["timings"])] if "timings" in tables else []
    if ranker_timings is not None:
        parts = [part.filter(pl.col("stage") != "ranker") for part in parts] + [frame_of(ranker_timings)]
    return pl.concat(parts) if parts else pl.DataFrame(schema={"stage": pl.String, "item_id": pl.String, "core_ms": pl.Float64})


def ranker_timing_rows(times: Iterable[DecisionTime]) -> list[dict[str, Any]]:
    """Rows of `timings` of stage `ranker`, one a timed group: from the points of the scene in memory to scores."""
    return [
        {
            "stage": "ranker",
            "item_id": time.scene_id if time.target_id is None else f"{time.scene_id}-t{time.target_id}",
            "core_ms": 1e3 * (time.prepare_s + time.forward_s),
        }
        for time in times
    ]
