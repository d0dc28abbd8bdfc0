"""What a label costs: core-milliseconds by stage and category over whole shards, beside floors measured in the same run.

`python -m assets_def.bench` builds shards of the full recipe below a folder of its own, through Dagster, and writes bench.json.
"""

from __future__ import annotations

import argparse
import json
import platform
import shutil
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl
import psutil
from dagster import DagsterInstance, materialize
from rich.console import Console
from rich.table import Column, Table

from assets_def.resources import REPOSITORY, Benchmark
from assets_def.stages import stage_assets
from objects.catalogue import PACKAGED_CATALOGUE
from pipelines import stages
from pipelines.codecs import scenes_from_tables
from pipelines.frames import frame_of, scene_id_of_item
from pipelines.proofs.cpu_profile import largest_costs
from pipelines.proofs.engine_baselines import bare_tick_us, collision_check_us
from pipelines.recipe import DEFAULT_RECIPE, load_recipe
from pipelines.running.data_root import DataRoot
from pipelines.running.object_tables import make_object_tables
from pipelines.running.shard_runner import load_shard_inputs, read_timings
from pipelines.running.workers import run_units
from pipelines.stages import STAGE, STAGES
from tables.schemas import ALL_SCHEMAS
from tables.store import read_tables, write_text_atomically

CONSOLE = Console()
# 38 scenes of the full recipe: every object at least once. The first is built with one worker and again with two.
TIMED_SHARD, OTHER_SHARD = "full-000", "full-033"
PAPER_PLANNING_MS = 1254.0
N_CANDIDATES = 250_000
N_PROFILED = 60  # units, a grasp each


@dataclass(frozen=True, slots=True)
class ShardRun:
    """One shard built through Dagster."""

    wall_s: float
    core_s: float
    peak_gib: float
    hashes: dict[str, str]


def bench(folder: Path) -> dict[str, object]:
    """Build the shards and return everything that is reported."""
    shutil.rmtree(folder, ignore_errors=True)
    one, two = folder / "one_worker", folder / "two_workers"
    for path in (one, two):
        make_object_tables(DataRoot(path), load_recipe("full"), PACKAGED_CATALOGUE, 2, lambda _: None)
    runs = {
        "one": _build(one, TIMED_SHARD, 1),
        "two": _build(two, TIMED_SHARD, 2),
        "other": _build(two, OTHER_SHARD, 2),
    }
    shards = (TIMED_SHARD, OTHER_SHARD)
    frame = _frame(DataRoot(two), shards)
    floors = _floors(DataRoot(two))
    floor_ms = _floor_ms(DataRoot(two), shards, floors)
    result = _figures(frame, runs) | floors | {"floor_ms": {" ".join(key): value for key, value in floor_ms.items()}}
    inputs = load_shard_inputs(DataRoot(two), TIMED_SHARD, load_recipe("full"), PACKAGED_CATALOGUE)
    for name in ("planning_labels", "execution_labels"):
        costs = largest_costs(STAGE[name], TIMED_SHARD, DataRoot(two), inputs, N_PROFILED)
        result[f"largest_costs_{name}"] = {function: round(share, 3) for function, share in costs}
    _print(frame, floor_ms, result)
    return result


def _build(path: Path, shard: str, n_workers: int) -> ShardRun:
    # The server of the workers starts once a process, however many shards it builds.
    list(run_units(int, [(0,)] * 4 * n_workers, n_workers, preload=(stages,)))
    shipped = {"catalogue_path": str(PACKAGED_CATALOGUE), "recipe_path": str(DEFAULT_RECIPE)}
    benchmark = Benchmark(data_dir=str(path), n_workers=n_workers, **shipped)
    start = time.perf_counter()
    result = materialize(
        stage_assets,
        partition_key=shard,
        resources={"benchmark": benchmark},
        instance=DagsterInstance.ephemeral(),
        run_config={"loggers": {"console": {"config": {"log_level": "WARNING"}}}},
    )
    wall_s = time.perf_counter() - start
    events = [m for m in result.get_asset_materialization_events() if m.asset_key is not None]
    first = {e.step_key: e.materialization.metadata for e in events}
    values = {name: [float(str(metadata[name].value)) for metadata in first.values()] for name in ("core_s", "peak_worker_gib")}
    hashes = {e.asset_key.to_user_string(): str(e.materialization.metadata["content_hash"].value) for e in events if e.asset_key}
    CONSOLE.print(f"{shard} with {n_workers} workers: {wall_s:.1f} s, {sum(values['core_s']):.1f} core-s in units")
    return ShardRun(wall_s, sum(values["core_s"]), max(values["peak_worker_gib"]), hashes)


def _frame(root: DataRoot, shards: Sequence[str]) -> pl.DataFrame:
    """One row a timed item: stage, category, core_ms."""
    timings = frame_of(read_timings(root, shards, STAGES))
    scenes = _tables(root, shards, "scenes")
    return timings.with_columns(scene_id_of_item("item_id")).join(scenes.select("scene_id", "category"), on="scene_id")


def _figures(frame: pl.DataFrame, runs: dict[str, ShardRun]) -> dict[str, object]:
    def mean(stage: str, category: str | None = None) -> float:
        some = frame.filter(pl.col("stage") == stage)
        chosen = some if category is None else some.filter(pl.col("category") == category)
        return float(chosen["core_ms"].mean() or 0.0)  # type: ignore[arg-type]

    n_candidates = frame.filter(pl.col("stage") == "planning_labels").height
    by_category = {category: mean("execution_labels", category) for category in ("can", "mug", "cuboid")}
    core_ms = float(frame.filter(~pl.col("stage").str.starts_with("policy_"))["core_ms"].sum())
    return {
        "planning_ms_mean": mean("planning_labels"),
        "execution_ms_mean": float(np.mean(list(by_category.values()))),
        "execution_ms_mean_mug": by_category["mug"],
        "pick_lift_ms_mean": mean("pick_lift"),
        "admission_ms_per_scene": mean("grasp_admission"),
        "speedup_2_workers": runs["one"].wall_s / runs["two"].wall_s,
        "orchestration_share": 1.0 - runs["one"].core_s / runs["one"].wall_s,
        "peak_worker_gib": max(run.peak_gib for run in runs.values()),
        "core_hours_250k": core_ms / n_candidates * N_CANDIDATES / 3.6e6,
        "candidates": n_candidates,
        "executed": frame.filter(pl.col("stage") == "execution_labels").height,
        "hashes_equal_1_and_2_workers": runs["one"].hashes == runs["two"].hashes,
        "paper_planning_ms": PAPER_PLANNING_MS,
        "machine": f"{platform.machine()}, {psutil.cpu_count()} cores, {psutil.virtual_memory().total / 2**30:.0f} GiB",
    }


def _floors(root: DataRoot) -> dict[str, dict[str, float]]:
    """Floors of a can, a mug and a cuboid in their first scenes."""
    inputs = load_shard_inputs(root, TIMED_SHARD, load_recipe("full"), PACKAGED_CATALOGUE)
    scenes = scenes_from_tables(*root.read_shard(TIMED_SHARD, [ALL_SCHEMAS[name] for name in ("scenes", "obstacles", "targets")]).values())
    first = [(inputs.object_models[allocation.object_id], scenes[allocation.scene_id]) for allocation in inputs.allocations[:3]]
    return {
        "floor_bare_tick_us": {
            object_model.category: bare_tick_us(object_model, scene, inputs.recipe.hand_physics) for object_model, scene in first
        },
        "floor_collision_check_us": {object_model.category: collision_check_us(object_model, scene) for object_model, scene in first},
    }


def _floor_ms(root: DataRoot, shards: Sequence[str], floors: dict[str, dict[str, float]]) -> dict[tuple[str, str], float]:
    """Floors of planning and execution by category: the steps or checks that an item took, each at its bare cost."""
    scenes = _tables(root, shards, "scenes").select("scene_id", "category")
    out = {}
    for name, counted, floor in (
        ("planning_labels", "n_checks", "floor_collision_check_us"),
        ("execution_labels", "n_physics_steps", "floor_bare_tick_us"),
    ):
        items = _tables(root, shards, name).with_columns(scene_id_of_item("candidate_id")).join(scenes, on="scene_id")
        for category, n in items.group_by("category").agg(pl.col(counted).mean()).iter_rows():
            out[name, category] = n * floors[floor][category] / 1e3
    return out


def _tables(root: DataRoot, shards: Sequence[str], name: str) -> pl.DataFrame:
    return frame_of(read_tables(ALL_SCHEMAS[name], [root.shard_table(shard, name) for shard in shards]))


def _print(frame: pl.DataFrame, floor_ms: dict[tuple[str, str], float], result: dict[str, object]) -> None:
    table = Table(
        Column("stage", no_wrap=True), "category", "items", "mean", "median", "p95", "floor", "paper", title="core-milliseconds an item"
    )
    groups = frame.group_by("stage", "category").agg(
        pl.len(),
        pl.col("core_ms").mean().alias("mean"),
        pl.col("core_ms").median().alias("median"),
        pl.col("core_ms").quantile(0.95).alias("p95"),
    )
    for stage, category, n, mean, median, p95 in groups.sort("stage", "category").iter_rows():
        floor = f"{floor_ms[stage, category]:.2f}" if (stage, category) in floor_ms else "–"
        paper = f"{PAPER_PLANNING_MS:.0f}" if stage == "planning_labels" else "–"
        table.add_row(stage, category, str(n), f"{mean:.2f}", f"{median:.2f}", f"{p95:.2f}", floor, paper)
    CONSOLE.print(table)
    for name, value in result.items():
        CONSOLE.print(f"{name:32s} {value:.3f}" if isinstance(value, float) else f"{name:32s} {value}", markup=False)


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line: writes `reports/out/bench.json`."""
    parser = argparse.ArgumentParser(prog="python -m assets_def.bench", description=__doc__)
    parser.add_argument("--folder", type=Path, default=REPOSITORY / "data" / "bench")
    chosen = parser.parse_args(arguments)
    result = bench(chosen.folder)
    path = REPOSITORY / "reports" / "out" / "bench.json"
    write_text_atomically(path, json.dumps(result, indent=2, sort_keys=True) + "\n")
    CONSOLE.print(f"written to {path}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
