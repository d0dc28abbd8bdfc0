"""Blocking gates on what was published: schema and hash re-read from disk, row counts, and labels that contradict each other."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import polars as pl
from dagster import AssetCheckResult, AssetCheckSpec

from pipelines.running.data_root import DataRoot
from pipelines.scenes.allocation import SceneAllocation
from pipelines.stages import Stage
from tables.columns import SchemaError, TableSchema
from tables.schemas import ALL_SCHEMAS
from tables.store import StoreError, read_table

N_TARGETS = 8


def schema_check_spec(schema: TableSchema) -> AssetCheckSpec:
    """A table on disk is what its sidecar and its schema say."""
    return AssetCheckSpec(
        "schema",
        asset=schema.name,
        blocking=True,
        description="Re-reads the file: SHA-256, types, nulls, closed enums, finite numbers, keys.",
    )


def schema_check(schema: TableSchema, path: Path) -> AssetCheckResult:
    """Result of `schema_check_spec`."""
    try:
        table = read_table(schema, path, verify=True)
    except (SchemaError, StoreError) as error:
        return AssetCheckResult(passed=False, check_name="schema", asset_key=schema.name, metadata={"error": str(error)})
    return AssetCheckResult(passed=True, check_name="schema", asset_key=schema.name, metadata={"rows": table.num_rows})


def stage_check_specs(stage: Stage) -> list[AssetCheckSpec]:
    """The gate a stage's rows must pass beyond their schema, one a stage."""
    table, _ = _GATES[stage.name]
    return [AssetCheckSpec("consistent", asset=table, blocking=True, description=_GATES[stage.name][1].__doc__)]


def stage_checks(stage: Stage, root: DataRoot, shard: str, allocations: Sequence[SceneAllocation]) -> Iterator[AssetCheckResult]:
    """Result of `stage_check_specs`, read from disk."""
    table, gate = _GATES[stage.name]
    errors = gate(lambda name: _frame(root, shard, name), allocations)
    yield consistency_result(table, errors)


def consistency_result(table: str, errors: Sequence[str]) -> AssetCheckResult:
    """A failed gate shows its first errors."""
    metadata: dict[str, Any] = {"n_errors": len(errors), "first_errors": "\n".join(errors[:10])}
    return AssetCheckResult(passed=not errors, check_name="consistent", asset_key=table, metadata=metadata)


Frames = Callable[[str], pl.DataFrame]


def _scenes(frames: Frames, allocations: Sequence[SceneAllocation]) -> list[str]:
    """Every scene of the shard is there, with its object, its obstacle count and eight targets."""
    scenes = {row["scene_id"]: row for row in frames("scenes").iter_rows(named=True)}
    n_obstacles = dict(frames("obstacles").group_by("scene_id").len().iter_rows())
    n_targets = dict(frames("targets").group_by("scene_id").len().iter_rows())
    errors = [f"{scene_id}: not of this shard" for scene_id in scenes.keys() - {allocation.scene_id for allocation in allocations}]
    for allocation in allocations:
        row = scenes.get(allocation.scene_id)
        if row is None:
            errors.append(f"{allocation.scene_id}: missing")
            continue
        found = (row["object_id"], row["n_obstacles"], n_obstacles.get(allocation.scene_id, 0), n_targets.get(allocation.scene_id, 0))
        wanted = (allocation.object_id, allocation.n_obstacles, allocation.n_obstacles, N_TARGETS)
        if found != wanted:
            errors.append(f"{allocation.scene_id}: object, obstacles, obstacle rows, targets are {found}, must be {wanted}")
    return errors


def _scene_points(frames: Frames, allocations: Sequence[SceneAllocation]) -> list[str]:
    """Every scene has points on its object and on the table."""
    seen = set(frames("scene_points").select("scene_id", "point_type").unique().iter_rows())
    wanted = {(allocation.scene_id, kind) for allocation in allocations for kind in ("object", "environment")}
    return [f"{scene_id}: no {kind} point" for scene_id, kind in sorted(wanted - seen)]


def _grasp_admission(frames: Frames, allocations: Sequence[SceneAllocation]) -> list[str]:
    """Arm configurations are there exactly where a grasp was admitted, and every scene has rows."""
    rows = frames("grasp_admission")
    errors = _missing(rows["scene_id"], [allocation.scene_id for allocation in allocations])
    wrong = rows.filter((pl.col("admission_status") == "admitted") & pl.col("grasp_q_1_rad").is_null())
    return errors + [f"{s}-g{g:02d}: admitted without a configuration" for s, g in wrong.select("scene_id", "grasp_id").iter_rows()]


def _pick_lift(frames: Frames, allocations: Sequence[SceneAllocation]) -> list[str]:
    """Exactly the admitted grasps were tried, and every lifted one has a measured state."""
    admitted = set(frames("grasp_admission").filter(pl.col("admission_status") == "admitted").select("scene_id", "grasp_id").iter_rows())
    rows = frames("pick_lift")
    tried = set(rows.select("scene_id", "grasp_id").iter_rows())
    errors = [f"{s}-g{g:02d}: admitted and tried differ" for s, g in sorted(admitted ^ tried)]
    wrong = rows.filter((pl.col("lift_status") == "lifted") & pl.col("lifted_q_1_rad").is_null())
    return errors + [f"{s}-g{g:02d}: lifted without a state" for s, g in wrong.select("scene_id", "grasp_id").iter_rows()]


def _candidate_pairs(frames: Frames, allocations: Sequence[SceneAllocation]) -> list[str]:
    """Candidates are the product of lifted grasps and targets."""
    lifted = frames("pick_lift").filter(pl.col("lift_status") == "lifted").select("scene_id", "grasp_id")
    product = lifted.join(frames("targets").select("scene_id", "target_id"), on="scene_id").select("scene_id", "target_id", "grasp_id")
    found = frames("candidate_pairs").select("scene_id", "target_id", "grasp_id")
    wrong = set(product.iter_rows()) ^ set(found.iter_rows())
    return [f"{s}-t{t}-g{g:02d}: not in both candidates and product" for s, t, g in sorted(wrong)]


def _policy_features(frames: Frames, allocations: Sequence[SceneAllocation]) -> list[str]:
    """Every candidate has the features of the endpoint baselines."""
    return _same_ids(frames("candidate_pairs"), frames("policy_features"))


def _planning_labels(frames: Frames, allocations: Sequence[SceneAllocation]) -> list[str]:
    """Every candidate has a status; y_plan, the status `solved` and a stored plan go together."""
    labels = frames("planning_labels")
    wrong = labels.filter(pl.col("y_plan") != (pl.col("plan_status") == "solved"))["candidate_id"].to_list()
    errors = [f"{c}: y_plan contradicts plan_status" for c in wrong]
    return errors + _same_ids(frames("candidate_pairs"), labels) + _same_ids(labels.filter("y_plan"), frames("plans"))


def _execution_labels(frames: Frames, allocations: Sequence[SceneAllocation]) -> list[str]:
    """Exactly the planned candidates were executed; y_pipe and the status `success` go together."""
    labels = frames("execution_labels")
    contradicts = (pl.col("y_pipe") != (pl.col("exec_status") == "success")).fill_null(True)
    errors = [f"{c}: y_pipe contradicts exec_status" for c in labels.filter(contradicts)["candidate_id"].to_list()]
    return errors + _same_ids(frames("planning_labels").filter("y_plan"), labels)


_GATES: dict[str, tuple[str, Callable[[Frames, Sequence[SceneAllocation]], list[str]]]] = {
    "scenes": ("scenes", _scenes),
    "scene_points": ("scene_points", _scene_points),
    "grasp_admission": ("grasp_admission", _grasp_admission),
    "pick_lift": ("pick_lift", _pick_lift),
    "candidate_pairs": ("candidate_pairs", _candidate_pairs),
    "policy_features": ("policy_features", _policy_features),
    "planning_labels": ("planning_labels", _planning_labels),
    "execution_labels": ("execution_labels", _execution_labels),
}


def _frame(root: DataRoot, shard: str, name: str) -> pl.DataFrame:
    frame = pl.from_arrow(read_table(ALL_SCHEMAS[name], root.shard_table(shard, name)))
    assert isinstance(frame, pl.DataFrame)
    return frame.with_columns(pl.col(pl.Categorical).cast(pl.String))


def _missing(found: pl.Series, wanted: Sequence[str]) -> list[str]:
    return [f"{scene_id}: missing" for scene_id in sorted(set(wanted) - set(found.to_list()))]


def _same_ids(left: pl.DataFrame, right: pl.DataFrame) -> list[str]:
    wrong = set(left["candidate_id"].to_list()) ^ set(right["candidate_id"].to_list())
    return [f"{candidate_id}: in one of two tables that must agree" for candidate_id in sorted(wrong)]
