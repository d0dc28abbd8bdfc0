"""What deciding and planning took, as reports are given it; decision_times.py and planner_costs.py measure it."""

from __future__ import annotations

from dataclasses import dataclass

import polars as pl
import pyarrow as pa

from pipelines.frames import frame_of

PLANNING_STAGE = "planning_labels"  # of `timings`


@dataclass(frozen=True, slots=True, eq=False)
class Costs:
    """What deciding and planning took.

    Attributes:
        timings: frame of `timings`: of the release as far as it has them, and decision times of the learned policies.
        planning: table `planner_costs`; None where there is none.
        machine: on which the decision times were measured, "" where nothing says so.
        planning_machine: on which candidates were planned again to measure it; "" where planning was timed as the labels were made.
        why_no_planning: said where there are no planning costs.
    """

    timings: pl.DataFrame
    planning: pa.Table | None
    machine: str = ""
    planning_machine: str = ""
    why_no_planning: str = ""

    @property
    def all_timings(self) -> pl.DataFrame:
        """`timings` with planning as a stage; what `planning` says of a candidate takes the place of what was there."""
        if self.planning is None:
            return self.timings
        measured = frame_of(self.planning).select(
            pl.lit(PLANNING_STAGE).alias("stage"), pl.col("candidate_id").cast(pl.String).alias("item_id"), "core_ms"
        )
        rest = self.timings.with_columns(pl.col("stage").cast(pl.String), pl.col("item_id").cast(pl.String))
        return pl.concat([rest.join(measured, on=["stage", "item_id"], how="anti"), measured], how="vertical_relaxed")

    @property
    def planning_measured(self) -> str:
        """When, and on what, planning was timed; ends a sentence."""
        return (
            f"measured on {self.planning_machine} by planning the test candidates again"
            if self.planning_machine
            else "measured when the labels were made"
        )
