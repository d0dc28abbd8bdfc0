"""Candidates of a release planned once more, and timed: light releases have no timings, and those of another machine say little of this.

Every planning label must come out as it is stored; what planning took is all that is new. Command: reports/planner_costs.py.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import polars as pl
import pyarrow as pa

from pipelines.recipe import DEFAULT_RECIPE
from pipelines.running.data_root import DataRoot
from pipelines.running.shard_runner import read_timings
from pipelines.stages import STAGE
from splits.errors import ReleaseError
from splits.origin import recipe_of
from splits.rebuild import first_difference, make_shards, rows_of_scenes
from splits.release_laws import stage_tables
from splits.release_reader import Release
from tables.schemas import PLANNING_LABELS
from tables.store import content_hash, read_tables
from tables.vocabulary import Split

_STAGE = STAGE["planning_labels"]


def planned_again(
    release: Release, split: Split, n_workers: int, recipe_path: Path = DEFAULT_RECIPE, log: Callable[[str], Any] = print
) -> pa.Table:
    """Table `timings` of planning every candidate of a split of the paper's scheme, planned or not.

    Args:
        n_workers: worker processes; 0 stays in this process.
        recipe_path: the recipe that the release was made with.
        log: told how far it is, one line a shard.

    Raises:
        ReleaseError: a release of another recipe or of other code, or a label that came out otherwise than it is stored.
        StageError: scenes that could not be planned; the others are kept for the next run.
    """
    recipe = recipe_of(release.manifest, recipe_path, [_STAGE])
    scene_ids = _scenes_of(release, split)
    parts = {name: rows_of_scenes(release.table(name), scene_ids) for name in ("scenes", "obstacles", "targets", "grasps", "candidates")}
    parts |= stage_tables({name: parts[name] for name in ("grasps", "candidates")})
    upstream = {schema.name: parts[schema.name] for schema in _STAGE.inputs}
    root = DataRoot(release.directory.resolve().with_name(f".{release.directory.resolve().name}.replan"))
    shards = make_shards(release, _STAGE, upstream, recipe, root, n_workers, log, scene_ids)
    labels = read_tables(PLANNING_LABELS, [root.shard_table(shard, PLANNING_LABELS.name) for shard in shards], of=shards)
    timings = read_timings(root, shards, [_STAGE])
    shutil.rmtree(root.path)
    if content_hash(labels) != content_hash(parts[PLANNING_LABELS.name]):
        raise ReleaseError(f"planning_labels made again: {first_difference(labels, parts[PLANNING_LABELS.name])}")
    return timings


def candidates_of(release: Release, split: Split) -> pa.Table:
    """Table `candidates` of the scenes of a split of the paper's scheme."""
    return rows_of_scenes(release.table("candidates"), _scenes_of(release, split))


def _scenes_of(release: Release, split: Split) -> set[str]:
    return set(release.candidates.filter(pl.col("split") == split.value)["scene_id"])
