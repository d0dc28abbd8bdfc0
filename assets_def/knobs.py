"""What each knob of the recipe moves: the first scenes of `full` again, one knob turned back towards the everyday task at a time.

`python -m assets_def.knobs` prints the table that pipelines/RECIPE.md holds and writes `reports/out/knobs.md`. Every variant is built below
a folder of its own, so an interrupted run goes on where it was; tables that a knob does not touch are taken over from the recipe's.
"""

from __future__ import annotations

import argparse
import dataclasses
import operator
import os
import shutil
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import polars as pl
from rich.console import Console

from assets_def.resources import REPOSITORY
from objects.catalogue import PACKAGED_CATALOGUE, catalogue_order
from pipelines.recipe import Recipe, load_recipe
from pipelines.running.data_root import DataRoot
from pipelines.running.join import join_candidates
from pipelines.running.object_tables import make_object_tables
from pipelines.running.shard_runner import load_shard_inputs, run_stage
from pipelines.scenes.allocation import family_allocation
from pipelines.stages import STAGES
from reports.load import Task, candidate_frame, group_frame
from reports.metrics import coverage
from reports.policies import FULL_PLANNER, IK_AND_GRIPPER, IK_ONLY, RANDOM
from reports.ranking import rank_groups, timing_frame
from splits.markdown import percent, table
from splits.scene_groups import SplitParams
from splits.schemes import split_table
from tables.schemas import ALL_SCHEMAS
from tables.store import read_tables, write_text_atomically

CONSOLE = Console()
# 38 scenes: every object at least once.
SHARDS = ("full-000", "full-001")
POLICIES = (RANDOM, IK_ONLY, IK_AND_GRIPPER, FULL_PLANNER)
HEADER = ("knob", "recipe → changed", "planned", "fail in execution", "coverage", *(policy.label for policy in POLICIES))


@dataclass(frozen=True, slots=True)
class Knob:
    """One variant: what is said of it, and the values that it changes by their keys in the recipe."""

    name: str
    words: str
    change: str
    values: Mapping[str, Any]


KNOBS = (
    Knob("recipe", "–", "the recipe", {}),
    Knob("same-rest", "`share_same_rest`", "0.1 → 0.5", {"scene_sampling.share_same_rest": 0.5}),
    Knob("beside", "`share_beside_obstacle`", "0.9 → 0.3", {"scene_sampling.share_beside_obstacle": 0.3}),
    Knob("initial-grasps", "`min_initial_grasps`", "26 → 16", {"scene_sampling.min_initial_grasps": 16}),
    Knob("lines", "`preplace_m`, `retreat_m`", "0.15 → 0.10 m", {"planning.preplace_m": 0.10, "planning.retreat_m": 0.10}),
    Knob("torque", "pool `max_torque_n_m`", "0.22 → 0.10 N m", {"objects.grasp_pool.max_torque_n_m": 0.10}),
    Knob(
        "speed",
        "speed, acceleration, jerk, lines",
        "rated → half, 0.4, 0.03 of it, 0.2 m/s",
        {
            "motion.velocity_scale": 0.5,
            "motion.acceleration_scale": 0.4,
            "motion.jerk_scale": 0.03,
            "motion.line_speed_m_s": 0.2,
        },
    ),
    Knob(
        "tolerance",
        "tolerance",
        "7.5 mm, 5° → 15 mm, 10°",
        {"execution.position_tolerance_m": 0.015, "execution.rotation_tolerance_rad": 0.17453292519943295},
    ),
    Knob("friction", "*no knob:* friction of all objects", "x 1.5 (0.48 between a pad and metal)", {"hand_physics.friction_scale": 1.5}),
    Knob("force", "*no knob:* finger force", "50 → 70 N", {"hand_physics.finger_force_n": 70.0}),
)


def changed(recipe: Recipe, values: Mapping[str, Any]) -> Recipe:
    """A recipe with other values at some keys such as `objects.grasp_pool.friction`.

    Raises:
        RecipeError, BoundsError: a value that the recipe does not allow.
        AttributeError: a key that it does not have.
    """
    for key, value in values.items():
        at(recipe, key)
        recipe = _replaced(recipe, key.split("."), value)
    return recipe


def at(recipe: Recipe, key: str) -> Any:
    """The value at such a key."""
    return operator.attrgetter(key)(recipe)


def _replaced(section: Any, path: Sequence[str], value: Any) -> Any:
    inner = value if len(path) == 1 else _replaced(getattr(section, path[0]), path[1:], value)
    return dataclasses.replace(section, **{path[0]: inner})


def build(knob: Knob, folder: Path, n_workers: int) -> DataRoot:
    """All stages of the shards under a variant of the recipe; what is there already is kept."""
    recipe, root = changed(load_recipe("full"), knob.values), DataRoot(folder / knob.name)
    baseline = folder / KNOBS[0].name
    if not root.path.exists():
        # What is published already for the recipe itself: by this command, else by `make dataset`.
        _link(baseline if baseline.exists() else REPOSITORY / "data", root.path)
    make_object_tables(root, recipe, PACKAGED_CATALOGUE, n_workers, lambda _: None)
    for shard in SHARDS:
        inputs = load_shard_inputs(root, shard, recipe, PACKAGED_CATALOGUE)
        for stage in STAGES:
            run_stage(stage, shard, root, inputs, n_workers)
    return root


def _link(source: Path, target: Path) -> None:
    """Take over tables: hard links, since tables are replaced by renaming and never written into."""
    for part in (Path("objects"), *(Path("shards") / shard for shard in SHARDS)):
        if (source / part).exists():
            shutil.copytree(source / part, target / part, copy_function=os.link, ignore=shutil.ignore_patterns(".lock", ".unfinished"))


def row(knob: Knob, root: DataRoot, seed: int, shards: Sequence[str] = SHARDS) -> list[str]:
    """The cells of `HEADER` of a variant; pairs are joint / fixed target."""
    tables = {
        name: read_tables(ALL_SCHEMAS[name], [root.shard_table(shard, name) for shard in shards])
        for name in ("scenes", "targets", "candidate_pairs", "planning_labels", "execution_labels", "policy_features")
    }
    tables["candidates"] = join_candidates(tables["candidate_pairs"], tables["planning_labels"], tables["execution_labels"])
    universe = family_allocation(shards[0].partition("-")[0], catalogue_order(PACKAGED_CATALOGUE))
    scene_ids = tables["scenes"]["scene_id"].to_pylist()
    tables["splits"] = split_table(scene_ids, universe, PACKAGED_CATALOGUE, SplitParams(), seed)
    frame, untimed = candidate_frame(tables, seed), timing_frame({})
    executed = frame.filter(pl.col("y_plan"))
    ranked = {(policy, task): rank_groups(frame, policy, task, untimed) for policy in POLICIES for task in Task}
    covered = [coverage(group_frame(tables, task), ranked[RANDOM, task].ranks, task) for task in Task]
    ladder = [" / ".join(_percent(ranked[policy, task].s[1]) for task in Task) for policy in POLICIES]
    failures = 1.0 - float(executed["success"].mean())  # type: ignore[arg-type]
    planned = float(frame["y_plan"].mean())  # type: ignore[arg-type]
    return [knob.words, knob.change, percent(planned, 0), percent(failures, 0), " / ".join(map(_percent, covered)) + " %", *ladder]


def _percent(estimate: Any) -> str:
    return "–" if estimate is None else f"{100.0 * estimate.value:.0f}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line: builds what is missing, variant by variant, and prints the table."""
    parser = argparse.ArgumentParser(prog="python -m assets_def.knobs", description=__doc__)
    parser.add_argument("--folder", type=Path, default=REPOSITORY / "data" / "knobs")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    chosen = parser.parse_args(arguments)
    seed = load_recipe("full").seed
    rows = []
    for knob in KNOBS:
        root = build(knob, chosen.folder, chosen.workers)
        rows.append(row(knob, root, seed))
        CONSOLE.print(" | ".join(rows[-1]), markup=False, soft_wrap=True)
    text = table(HEADER, rows)
    path = REPOSITORY / "reports" / "out" / "knobs.md"
    write_text_atomically(
        path, f"# What each knob moves, {' and '.join(SHARDS)}: shares, and S1 on covered groups, joint / fixed target\n\n{text}\n"
    )
    CONSOLE.print(f"written to {path}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
