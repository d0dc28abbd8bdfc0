"""Every gate of the graph turns red on a planted fault, shuts the way, and opens again; none is left out."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from dagster import AssetCheckResult, AssetKey, AssetsDefinition

from assets_def.checks import schema_check, stage_checks
from assets_def.curve_assets import curve_step
from assets_def.definitions import definitions
from assets_def.proof_assets import proof_steps
from assets_def.ranker_assets import predictions_step
from assets_def.release_assets import joined_tables, release_steps, splits_table
from assets_def.resources import Benchmark
from assets_def.stages import stage_assets
from assets_def.trees_assets import TREE_PREDICTIONS, TREE_TIMES, trees_step
from model.features import CANDIDATE_GEOMETRY
from pipelines.laws import planning_labels_law
from pipelines.stages import STAGES
from splits.manifest import files_of_table
from tables.columns import TableSchema
from tables.schemas import ALL_SCHEMAS, OBJECT_TABLES
from tables.store import file_sha256, read_parquet, read_sidecar, read_table, sidecar_path, table_from_rows, write_parquet, write_table
from tests.assets_def.conftest import Built, run
from tests.assets_def.small import SHARD, TIER, SmallBenchmark

Row = dict[str, Any]
Rows = list[Row]

# The gate of a trained ranker is tested with the ranker.
EXCLUDED = {"ranker.consistent"}
CHECKS = {f"{key.asset_key.to_user_string()}.{key.name}" for key in definitions.resolve_asset_graph().asset_check_keys} - EXCLUDED
SCHEMA_CHECKS = sorted(name.removesuffix(".schema") for name in CHECKS if name.endswith(".schema"))
STEPS = (*release_steps, predictions_step, trees_step, curve_step, *proof_steps)
# An asset that is not named as its table.
TABLE_OF = {"decision_times": "timings", TREE_PREDICTIONS: "predictions", TREE_TIMES: "timings"}


def check(name: str, benchmark: Benchmark) -> AssetCheckResult:
    """A gate by its name `asset.check`, run on what is on disk."""
    asset = name.partition(".")[0]
    if asset in OBJECT_TABLES:
        return schema_check(ALL_SCHEMAS[asset], benchmark.root.object_table(asset))
    stages = [stage for stage in STAGES if asset in {schema.name for schema in stage.outputs}]
    steps = [step for step in STEPS if AssetKey(asset) in step.asset.keys]
    results = [
        *(r for stage in stages for r in stage_checks(stage, benchmark.root, SHARD, benchmark.shard_inputs(SHARD).promise)),
        *(r for step in steps for r in step.checks(benchmark, TIER)),
    ]
    (result,) = [r for r in results if f"{r.asset_key.to_user_string() if r.asset_key else ''}.{r.check_name}" == name]
    return result


def said(result: AssetCheckResult) -> str:
    return " ".join(str(value.value) for value in result.metadata.values())


def table_of(asset: str) -> TableSchema:
    return CANDIDATE_GEOMETRY if asset == CANDIDATE_GEOMETRY.name else ALL_SCHEMAS[TABLE_OF.get(asset, asset)]


def path_of(asset: str, benchmark: Benchmark) -> Path:
    """Where an asset's table lies."""
    if asset in OBJECT_TABLES:
        return benchmark.root.object_table(asset)
    if asset in {schema.name for stage in STAGES for schema in stage.outputs}:
        return benchmark.root.shard_table(SHARD, asset)
    return benchmark.root.tier_table(TIER, asset)


def flip_a_byte(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    path.write_bytes(content)


def repeat_a_row(path: Path) -> None:
    """A fault that only the values show: the sidecar knows the new file."""
    table = pq.read_table(path)
    pq.write_table(table.take([0, *range(table.num_rows)]), path)
    sidecar = json.loads(sidecar_path(path).read_text()) | {"sha256": file_sha256(path), "rows": table.num_rows + 1}
    sidecar_path(path).write_text(json.dumps(sidecar))


def edit(asset: str, change: Callable[[Rows], None], benchmark: Benchmark, path: Path | None = None) -> None:
    """Change rows of a table through the store, so that file, sidecar and schema agree and nothing looks outdated."""
    path = path or path_of(asset, benchmark)
    rows = read_table(table_of(asset), path).to_pylist()
    change(rows)
    before = read_sidecar(path)
    write_table(table_of(asset), table_from_rows(table_of(asset), rows), path, before.made_from, of=before.of)


def edit_released(asset: str, change: Callable[[Rows], None], benchmark: Benchmark) -> None:
    """Change the rows in the first file with rows of a released table."""
    paths = [benchmark.root.release(TIER) / file for file in files_of_table(asset)]
    path, rows = next((path, rows) for path in paths if (rows := read_parquet(table_of(asset), path).to_pylist()))
    change(rows)
    write_parquet(table_of(asset), table_from_rows(table_of(asset), rows), path, described=True)


@pytest.fixture
def benchmark(built: Built, tmp_path: Path) -> SmallBenchmark:
    return built.copy(tmp_path)


def test_the_graph_s_own_runs_evaluated_the_gates_and_found_them_open(built: Built) -> None:
    made_up = {"predictions", "decision_times", "attempts", "audits", "learning_curve", "test_replicates", *OBJECT_TABLES}
    made_up |= {CANDIDATE_GEOMETRY.name, TREE_PREDICTIONS, TREE_TIMES}
    assert set(built.checks) == {name for name in CHECKS if name.partition(".")[0] not in made_up}
    assert all(built.checks.values())


def test_every_gate_is_open_on_sound_data(benchmark: SmallBenchmark) -> None:
    for name in sorted(CHECKS):
        result = check(name, benchmark)
        assert result.passed, (name, said(result))


def test_a_check_shows_what_it_compared(benchmark: SmallBenchmark) -> None:
    schema = check("planning_labels.schema", benchmark).metadata
    path = path_of("planning_labels", benchmark)
    assert schema["sha256_on_disk"].value == schema["sha256_recorded"].value == file_sha256(path)
    assert schema["rows"].value == read_sidecar(path).rows
    law = check("planning_labels.consistent", benchmark).metadata
    assert law["law"].value == planning_labels_law.__doc__
    assert f"planning_labels {read_sidecar(path).rows:,}" in str(law["rows_compared"].value)

    flip_a_byte(path)
    schema = check("planning_labels.schema", benchmark).metadata
    assert schema["sha256_on_disk"].value != schema["sha256_recorded"].value


@pytest.mark.parametrize("asset", SCHEMA_CHECKS)
@pytest.mark.parametrize(
    ("plant", "words"),
    [(flip_a_byte, "SHA-256"), (repeat_a_row, "1 repeated keys"), (Path.unlink, "not published")],
    ids=["flipped byte", "repeated row", "no file"],
)
def test_a_schema_check_sees_a_broken_table(benchmark: SmallBenchmark, asset: str, plant: Callable[[Path], None], words: str) -> None:
    plant(path_of(asset, benchmark))
    result = check(f"{asset}.schema", benchmark)
    assert not result.passed
    assert words in said(result)


def first(rows: Rows, **where: Any) -> Row:
    return next(row for row in rows if all(row[name] == value for name, value in where.items()))


def dropped(**where: Any) -> Callable[[Rows], None]:
    return lambda rows: rows.remove(first(rows, **where))


def changed(where: Row, **values: Any) -> Callable[[Rows], None]:
    return lambda rows: first(rows, **where).update(values)


def without_object_points(rows: Rows) -> None:
    rows[:] = [row for row in rows if (row["scene_id"], row["point_type"]) != ("mini-0000", "object")]


PLANNED, ADMITTED = {"y_plan": True}, {"admission_status": "admitted"}
# (gate, table that is edited, how, words that must be said); the edited table still is what its schema says.
LAW_FAULTS: list[tuple[str, str, Callable[[Rows], None], str]] = [
    ("scenes", "scenes", dropped(scene_id="mini-0008"), "1 of promised are missing in scenes"),
    ("scenes", "targets", dropped(), "object, obstacles, obstacle rows, targets are"),
    ("scenes", "obstacles", dropped(), "object, obstacles, obstacle rows, targets are"),
    ("scene_points", "scene_points", without_object_points, "mini-0000 has no object point"),
    (
        "grasp_admission",
        "grasp_admission",
        changed(ADMITTED, grasp_q_1_rad=None),
        "exactly where a grasp was admitted",
    ),
    ("pick_lift", "pick_lift", dropped(), "1 of admitted grasps are missing in pick_lift"),
    ("pick_lift", "pick_lift", changed({"lift_status": "lifted"}, inhand_x_m=None), "a lifted grasp has a measured state"),
    ("candidate_pairs", "candidate_pairs", dropped(), "1 of lifted grasps x targets are missing in candidate_pairs"),
    ("candidate_pairs", "candidate_pairs", changed({}, category="mug"), "object, category and obstacle count are the scene's"),
    ("policy_features", "policy_features", dropped(), "1 of candidate_pairs are missing in policy_features"),
    ("planning_labels", "planning_labels", changed(PLANNED, plan_status="no_ik"), "y_plan says the same as plan_status"),
    ("planning_labels", "plans", dropped(), "1 of planned candidates are missing in plans"),
    ("execution_labels", "execution_labels", changed({}, tolerance_margin=0.123), "tolerance_margin is 1 minus"),
    (
        "execution_labels",
        "execution_labels",
        changed({"exec_status": "success"}, transport_slip_m=0.0038),
        "a success has transport_slip_m of at most 0.00375 m",
    ),
    ("execution_labels", "execution_labels", changed({"exec_status": "success"}, y_pipe=False), "y_pipe says the same as exec_status"),
    ("candidates", "candidates", changed(PLANNED, plan_status="no_ik"), "planning_labels: y_plan says the same as plan_status"),
    ("candidates", "candidates", dropped(), "candidate_pairs: 1 of lifted grasps x targets are missing"),
    ("candidates", "grasps", changed({"lift_status": "lifted"}, lift_status="slipped"), "are missing in lifted grasps x targets"),
    ("splits", "splits", dropped(scene_id="mini-0000"), "scene_without_split: mini-0000"),
    ("splits", "splits", changed({"scene_id": "mini-0000"}, split_category_can="train"), "not_held_out: mini-0000: category can in train"),
    ("splits", "splits", changed({"scene_id": "mini-0000"}, split_layout="test"), "not_held_out: mini-0000: obstacles 0 in test"),
    ("splits", "candidates", changed({"scene_id": "mini-0000"}, candidate_id="mini-0008-t0-g63"), "candidate_of_another_scene"),
]


@pytest.mark.parametrize(("asset", "edited", "change", "words"), LAW_FAULTS, ids=[f"{row[0]}-{row[3][:30]}" for row in LAW_FAULTS])
def test_a_law_is_broken_by_rows_that_no_schema_forbids(
    benchmark: SmallBenchmark, asset: str, edited: str, change: Callable[[Rows], None], words: str
) -> None:
    edit(edited, change, benchmark)
    assert check(f"{edited}.schema", benchmark).passed
    result = check(f"{asset}.consistent", benchmark)
    assert not result.passed
    assert words in said(result)


RELEASE_FAULTS: list[tuple[Callable[[SmallBenchmark], None], str]] = [
    (lambda b: flip_a_byte(b.root.release(TIER) / "scenes.parquet"), "scenes.parquet: SHA-256"),
    (lambda b: flip_a_byte(b.root.release(TIER) / "README.md"), "README.md: SHA-256"),
    (lambda b: (b.root.release(TIER) / "manifest.json").unlink(), "manifest.json"),
    (lambda b: edit_released("candidates", changed(PLANNED, plan_status="no_ik"), b), "part-0.parquet: SHA-256"),
]


@pytest.mark.parametrize(("plant", "words"), RELEASE_FAULTS, ids=["table", "card", "manifest", "row"])
def test_a_release_verifies_against_its_manifest(benchmark: SmallBenchmark, plant: Callable[[SmallBenchmark], None], words: str) -> None:
    plant(benchmark)
    result = check("release.consistent", benchmark)
    assert not result.passed
    assert words in said(result)


def test_every_gate_of_the_graph_has_a_planted_fault() -> None:
    planted = {f"{asset}.schema" for asset in SCHEMA_CHECKS} | {f"{row[0]}.consistent" for row in LAW_FAULTS} | {"release.consistent"}
    assert planted == CHECKS
    assert {row[0] for row in LAW_FAULTS} >= {stage.outputs[0].name for stage in STAGES}


def test_a_table_that_cannot_be_read_is_a_red_gate_and_not_a_crash(benchmark: SmallBenchmark) -> None:
    sidecar_path(benchmark.root.shard_table(SHARD, "plans")).write_text("{")
    for name in ("plans.schema", "planning_labels.consistent", "execution_labels.consistent"):
        assert not check(name, benchmark).passed, name


@pytest.mark.parametrize(
    ("assets", "partition", "edited", "red", "downstream"),
    [
        (stage_assets, SHARD, "planning_labels", "planning_labels.consistent", "execution_labels"),
        ([joined_tables, splits_table], TIER, "candidates", "candidates.consistent", "splits"),
    ],
    ids=["stage", "tier"],
)
def test_a_red_gate_shuts_the_way(
    benchmark: SmallBenchmark, assets: list[AssetsDefinition], partition: str, edited: str, red: str, downstream: str
) -> None:
    # The sidecar says that nothing changed, so that the table is kept; the gate is what notices.
    edit(edited, changed(PLANNED, plan_status="no_ik"), benchmark)
    result = run(assets, partition, benchmark)
    assert not result.success
    passed = {f"{e.asset_key.to_user_string()}.{e.check_name}": e.passed for e in result.get_asset_check_evaluations()}
    assert [name for name, is_open in passed.items() if not is_open] == [red]
    made = {event.asset_key for event in result.get_asset_materialization_events()}
    assert AssetKey(edited) in made
    assert AssetKey(downstream) not in made


def test_a_step_with_a_red_gate_is_never_done(benchmark: SmallBenchmark) -> None:
    joined = release_steps[0]
    assert joined.is_done(benchmark, TIER)
    edit("candidates", changed(PLANNED, plan_status="no_ik"), benchmark)
    assert all(product.is_current() for product in joined.products(benchmark, TIER))
    assert not joined.is_done(benchmark, TIER)
