"""Decision time of the learned policies by size of the group, and the command that measures it on this machine.

`python -m reports.decision_times RELEASE --checkpoints DIR ... [--trees] --out DIR`

Writes `decision_times.parquet` (and with --trees, which trains them, `tree_decision_times.parquet`) as reports read them beside a release.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import polars as pl

from model.decision_times import N_TIMED_SCENES, machine_name
from reports.load import Task
from reports.policies import LEARNED
from reports.ranking import MACHINE, TASK_TITLE, ranker_timing_rows
from splits.markdown import table
from splits.release_reader import Release
from tables.errors import PlaceBenchError
from tables.schemas import TIMINGS
from tables.store import table_from_rows, write_table

# Largest number of candidates of each size of group but the last.
SIZES = (16, 32, 64, 128, 256)


def decision_time_rows(candidates: pl.DataFrame, timings: pl.DataFrame) -> list[dict[str, object]]:
    """Decision time by task, learned policy and size of the group.

    Args:
        candidates: those of the split in question.
        timings: frame of `timings`, with the stages of the policies that were timed.

    Returns:
        Rows with `task`, `policy`, `label`, `size`, `n_groups`, `mean_candidates`, `mean_ms`, `median_ms` and `largest_ms`.
    """
    rows: list[dict[str, object]] = []
    for task in Task:
        name = pl.col("scene_id") if task is Task.JOINT else pl.format("{}-t{}", "scene_id", "target_id")
        groups = candidates.group_by(name.alias("item_id")).agg(pl.len().alias("n_candidates"))
        for policy in LEARNED:
            # A policy that is not timed by the group has no stage, and no stage is called "".
            timed = groups.join(timings.filter((pl.col("stage") == policy.group_stage) & (pl.col("stage") != "")), on="item_id")
            if timed.is_empty():
                continue
            bins = np.searchsorted(SIZES, timed["n_candidates"].to_numpy())
            for k in np.unique(bins):
                own, ms = timed["n_candidates"].to_numpy()[bins == k], timed["core_ms"].to_numpy()[bins == k]
                rows.append(
                    {"task": task.value, "policy": policy.name, "label": policy.label, "size": _size(int(k)), "n_groups": len(ms),
                     "mean_candidates": float(own.mean()), "mean_ms": float(ms.mean()), "median_ms": float(np.median(ms)),
                     "largest_ms": float(ms.max())}
                )  # fmt: skip
    return rows


def decision_time_section(rows: Sequence[dict[str, object]], machine: str) -> list[str]:
    """Markdown blocks: a table by task, policy and size of the group, and on what it was measured."""
    if not rows:
        return ["## Decision times", "Not measured: `decision_times.parquet` and `tree_decision_times.parquet` are not beside the release."]
    shown = [
        [TASK_TITLE[Task(str(row["task"]))], row["label"], row["size"], f"{row['n_groups']:,}", f"{row['mean_candidates']:.1f}",
         *(f"{row[name]:.1f}" for name in ("mean_ms", "median_ms", "largest_ms"))]
        for row in rows
    ]  # fmt: skip
    text = (
        "Wall-clock milliseconds from a scene's points and poses in memory to scores, one group at a time, groups of the first scenes of"
        f" the test split, measured on **{machine or 'a machine that the tables do not name'}**."
    )
    header = ["", "policy", "candidates", "groups", "mean candidates", "mean ms", "median", "largest"]
    return ["## Decision times", text, table(header, shown, align="lllrrrrr")]


def _size(k: int) -> str:
    first = 1 if k == 0 else SIZES[k - 1] + 1
    return f"{first} to {SIZES[k]}" if k < len(SIZES) else f"{first} or more"


def measure(release_dir: Path, checkpoints: Sequence[Path], *, with_trees: bool, n_scenes: int, out: Path) -> list[Path]:
    """Measure and write the tables; returns their paths. Raises RankerError as scoring and trees do."""
    # Neither is needed to read a table of times, and both take seconds to import.
    from model.checkpoint import load_checkpoint
    from model.scoring import decision_times, timing_machine
    from model.tree_times import tree_decision_times
    from model.trees import TreeVariant, read_tree_data, split_trees

    manifest, paths = Release.open(release_dir).manifest, []
    origin = {"release": manifest.release_hash}
    rows = [
        row
        for checkpoint in checkpoints
        for row in ranker_timing_rows(
            decision_times(release_dir, checkpoint, n_scenes=n_scenes), load_checkpoint(checkpoint)[1].variant.value
        )
    ]
    if rows:
        paths.append(out / "decision_times.parquet")
        write_table(TIMINGS, table_from_rows(TIMINGS, rows), paths[-1], {**origin, MACHINE: timing_machine()}, of=manifest.tier)
    if with_trees:
        trees = split_trees(release_dir, read_tree_data(release_dir), TreeVariant.GEOMETRY, 42)
        times = ranker_timing_rows(tree_decision_times(release_dir, trees, n_scenes=n_scenes), trees.variant.value)
        paths.append(out / "tree_decision_times.parquet")
        write_table(TIMINGS, table_from_rows(TIMINGS, times), paths[-1], {**origin, MACHINE: machine_name()}, of=manifest.tier)
    return paths


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line: 0, or 1 with one line on standard error."""
    parser = argparse.ArgumentParser(prog="python -m reports.decision_times", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("release", type=Path, help="folder of a release with its points")
    parser.add_argument("--checkpoints", type=Path, nargs="*", default=[], help="a trained ranker of each variant to be timed")
    parser.add_argument("--trees", action="store_true", help="train and time the trees on derived geometry too")
    parser.add_argument("--scenes", type=int, default=N_TIMED_SCENES, help=f"scenes of the test split ({N_TIMED_SCENES})")
    parser.add_argument("--out", type=Path, required=True, help="folder for the tables")
    chosen = parser.parse_args(arguments)
    try:
        paths = measure(chosen.release, chosen.checkpoints, with_trees=chosen.trees, n_scenes=chosen.scenes, out=chosen.out)
    except PlaceBenchError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print("\n".join(map(str, paths)) or "nothing was asked for: name --checkpoints or --trees")
    return 0


if __name__ == "__main__":
    sys.exit(main())
