"""What planning candidates takes: table `planner_costs`, small enough to ship beside a light release.

`python -m reports.planner_costs data/release/full --out data/predictions/full/planner_costs.parquet [--workers 2]`

Of a whole release it is what its own timings say of every candidate. Of a light one, which has none, the candidates of the test split are
planned once more on this machine, and have to come out as they are stored.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

import polars as pl
import pyarrow as pa

from model.decision_times import machine_name
from pipelines.frames import frame_of
from reports.costs import PLANNING_STAGE
from reports.ranking import MACHINE
from reports.report import ReportError
from splits.release_reader import Release
from splits.replan import candidates_of, planned_again
from tables.errors import PlaceBenchError
from tables.schemas import PLANNER_COSTS
from tables.store import table_from_columns, write_table
from tables.vocabulary import Split


def planner_costs(timings: pa.Table, candidates: pa.Table) -> pa.Table:
    """Table `planner_costs`, a row a candidate.

    Raises:
        ReportError: a candidate whose planning was not timed.
    """
    timed = frame_of(timings).filter(pl.col("stage") == PLANNING_STAGE).select(pl.col("item_id").alias("candidate_id"), "core_ms")
    joined = frame_of(candidates, ["candidate_id"]).join(timed, on="candidate_id", how="left").sort("candidate_id")
    lost = joined.filter(pl.col("core_ms").is_null())
    if not lost.is_empty():
        raise ReportError(
            f"timings: {lost['candidate_id'][0]} has no row of stage {PLANNING_STAGE} ({lost.height} candidates have none, must be 0)"
        )
    return table_from_columns(PLANNER_COSTS, {name: joined[name].to_list() for name in PLANNER_COSTS.names})


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line: 0, or 1 with one line on standard error where the release has no timings."""
    parser = argparse.ArgumentParser(prog="python -m reports.planner_costs", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("release", type=Path, help="folder of a release")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="worker processes, where candidates are planned once more")
    parser.add_argument("--out", type=Path, required=True, help="Parquet file to write")
    chosen = parser.parse_args(arguments)
    try:
        release = Release.open(chosen.release)
        made_from = {"release": release.manifest.release_hash}
        if "timings" not in release.left_out:
            made = planner_costs(release.table("timings"), release.table("candidates"))
        else:
            made = planner_costs(planned_again(release, Split.TEST, chosen.workers), candidates_of(release, Split.TEST))
            made_from[MACHINE] = machine_name()
        write_table(PLANNER_COSTS, made, chosen.out, made_from, of=release.manifest.tier)
    except PlaceBenchError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(f"{chosen.out}: {made.num_rows:,} candidates, {chosen.out.stat().st_size / 1e6:.1f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
