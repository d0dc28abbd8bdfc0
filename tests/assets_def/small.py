"""Two real scenes of mini, few grasps: the graph on a dataset that is built in seconds."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from assets_def.resources import Benchmark
from assets_def.trees_assets import TREE_PREDICTIONS, TREE_TIMES
from model.features import CANDIDATE_GEOMETRY
from objects.build import build_object
from objects.catalogue import PACKAGED_CATALOGUE, catalogue_order, load_catalogue
from pipelines.proofs.replicates import uncertainty_of
from pipelines.running.data_root import DataRoot
from pipelines.running.shard_runner import ShardInputs
from pipelines.scenes.allocation import scene_allocation
from tables.identity import rng_for
from tables.schemas import ALL_SCHEMAS, ATTEMPTS, AUDITS, CANDIDATES, LEARNING_CURVE, OBJECT_TABLES, PREDICTIONS, TEST_REPLICATES, TIMINGS
from tables.store import read_table, table_from_rows, write_table

SHARD, TIER = "mini-000", "mini"
# A can, and a cuboid beside an obstacle.
SCENES = ("mini-0000", "mini-0008")
RECIPE = "[grasp_admission]\nquota = 2\n"


class SmallBenchmark(Benchmark):
    """The benchmark with two of the scenes of mini; everything else is as it is."""

    def shard_inputs(self, shard: str) -> ShardInputs:
        inputs = super().shard_inputs(shard)
        return dataclasses.replace(inputs, allocations=[a for a in inputs.allocations if a.scene_id in SCENES])


def small_benchmark(folder: Path) -> SmallBenchmark:
    """Data, reports and recipe below one folder; units run in this process."""
    recipe = folder / "recipe.toml"
    if not recipe.exists():
        recipe.write_text(RECIPE)
    return SmallBenchmark(data_dir=str(folder / "data"), reports_dir=str(folder / "reports"), recipe_path=str(recipe), n_workers=0)


def write_objects(benchmark: Benchmark) -> None:
    """Object tables of the two objects, built anew."""
    wanted = {scene_allocation(scene_id, catalogue_order(PACKAGED_CATALOGUE)).object_id for scene_id in SCENES}
    recipe = benchmark.recipe(TIER)
    built = [build_object(spec, recipe.objects, recipe.seed) for spec in load_catalogue() if spec.object_id in wanted]
    for name in OBJECT_TABLES:
        rows = [row for tables in built for row in getattr(tables, name)]
        write_table(ALL_SCHEMAS[name], table_from_rows(ALL_SCHEMAS[name], rows), benchmark.root.object_table(name))


def write_made_up_tables(root: DataRoot) -> None:
    """Tables that cost minutes to make, with made-up values about real candidates: what rankers say, repeats, audits, replicates."""
    candidates = read_table(CANDIDATES, root.tier_table(TIER, "candidates")).to_pylist()
    noise = rng_for(0, "made-up-predictions").normal(size=len(candidates))
    score = {row["candidate_id"]: float(x) for row, x in zip(candidates, noise, strict=True)}
    labels = ("candidate_id", "plan_status", "exec_status", "final_position_error_m", "final_rotation_error_rad")
    rows = {
        "predictions": [
            {"variant": "full", "seed": 42, "candidate_id": name, "log_p_plan": x, "log_p_exec": x} for name, x in score.items()
        ],
        "attempts": [
            {name: row[name] for name in labels}
            | {"perturbation": "fresh_process", "repeat": 0, "plan_matches": True, "exec_matches": True, "is_identical": True}
            for row in candidates
        ],
        "audits": [
            {"candidate_id": row["candidate_id"], "audit": "rejection", "stored_status": row["plan_status"], "agrees": True}
            | {"audited_status": row["plan_status"], "depth_m": None, "deepest_pair": None, "clearance_m": None, "n_configurations": 1}
            for row in candidates
        ],
        "learning_curve": [
            {"variant": "local", "n_train_scenes": 1, "seed": 42, "candidate_id": name, "log_p_plan": x, "log_p_exec": x}
            for name, x in score.items()
        ],
        "test_replicates": [
            {"candidate_id": name, "replicate": 0, **uncertainty_of(0, name, 0).row()}
            | {"exec_status": "success", "is_success": True, "tolerance_margin": 0.5}
            for name in score
        ],
    }
    geometry = [
        {c.name: row["candidate_id"] if c.name == "candidate_id" else 0.5 for c in CANDIDATE_GEOMETRY.columns} for row in candidates
    ]
    write_table(CANDIDATE_GEOMETRY, table_from_rows(CANDIDATE_GEOMETRY, geometry), root.tier_table(TIER, CANDIDATE_GEOMETRY.name))
    scores = [row | {"variant": "trees"} for row in rows["predictions"]]
    write_table(PREDICTIONS, table_from_rows(PREDICTIONS, scores), root.tier_table(TIER, TREE_PREDICTIONS))
    for schema in (PREDICTIONS, ATTEMPTS, AUDITS, LEARNING_CURVE, TEST_REPLICATES):
        write_table(schema, table_from_rows(schema, rows[schema.name]), root.tier_table(TIER, schema.name))
    times = [{"stage": "ranker", "item_id": scene_id, "core_ms": 1.0} for scene_id in SCENES]
    for name in ("decision_times", TREE_TIMES):
        write_table(TIMINGS, table_from_rows(TIMINGS, times), root.tier_table(TIER, name))
