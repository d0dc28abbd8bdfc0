"""Combinations of labels that cannot be: the gate between a table that has the right types and one that makes sense."""

from __future__ import annotations

import polars as pl
import pyarrow as pa

from splits.frames import frame_of
from tables.vocabulary import ExecStatus, LiftStatus, PlanStatus

# A margin recomputed from two stored doubles differs from the stored one by rounding only.
_MARGIN_ROUNDING = 1e-9

_EXECUTION_VALUES = (
    "final_position_error_m",
    "final_rotation_error_rad",
    "tolerance_margin",
    "transport_slip_m",
    "transport_slip_rad",
    "release_position_error_m",
    "release_rotation_error_rad",
    "retreat_drag_m",
    "n_physics_steps",
    "final_x_m",
)


def find_label_errors(
    candidates: pa.Table,
    grasps: pa.Table,
    targets: pa.Table,
    *,
    position_tolerance_m: float,
    rotation_tolerance_rad: float,
) -> list[str]:
    """One sentence for every rule that is broken: how often, and the first candidate that breaks it with its values.

    Args:
        candidates: table `candidates`.
        grasps: table `grasps`, whose lifted rows say which candidates there must be.
        targets: table `targets`.
        position_tolerance_m: position error at which a placement stops being valid.
        rotation_tolerance_rad: rotation error at which a placement stops being valid.
    """
    frame = frame_of(candidates)
    errors = [
        _sentence(name, rule, frame.filter(broken), columns)
        for name, rule, broken, columns in _rules(position_tolerance_m, rotation_tolerance_rad)
    ]
    return [error for error in errors if error] + _pairing_errors(frame, frame_of(grasps), frame_of(targets))


def _rules(position_tolerance_m: float, rotation_tolerance_rad: float) -> list[tuple[str, str, pl.Expr, list[str]]]:
    """(name, what must hold, rows that break it, columns that show it); an expression that is null does not break its rule."""
    planned = pl.col("y_plan")
    success = pl.col("y_pipe").fill_null(False)
    position, rotation, margin = pl.col("final_position_error_m"), pl.col("final_rotation_error_rad"), pl.col("tolerance_margin")
    own_id = pl.format("{}-t{}-g{}", "scene_id", "target_id", pl.col("grasp_id").cast(pl.String).str.zfill(2))
    expected = 1.0 - pl.max_horizontal(position / position_tolerance_m, rotation / rotation_tolerance_rad)
    executed_only = [
        (f"{name}_without_plan", f"{name} is null where y_plan is false", pl.col(name).is_not_null() & ~planned, ["y_plan", name])
        for name in _EXECUTION_VALUES
    ]
    return [
        ("id", "candidate_id is made of its coordinates", pl.col("candidate_id") != own_id, ["scene_id", "target_id", "grasp_id"]),
        (
            "plan",
            "y_plan says the same as plan_status",
            planned != (pl.col("plan_status") == PlanStatus.SOLVED.value),
            ["y_plan", "plan_status"],
        ),
        (
            "plan_duration",
            "plan_duration_s is null exactly where y_plan is false",
            pl.col("plan_duration_s").is_null() == planned,
            ["y_plan", "plan_duration_s"],
        ),
        ("y_pipe_null", "y_pipe is null exactly where y_plan is false", pl.col("y_pipe").is_null() == planned, ["y_plan", "y_pipe"]),
        (
            "exec_status_null",
            "exec_status is null exactly where y_plan is false",
            pl.col("exec_status").is_null() == planned,
            ["y_plan", "exec_status"],
        ),
        (
            "y_pipe",
            "y_pipe says the same as exec_status",
            pl.col("y_pipe") != (pl.col("exec_status") == ExecStatus.SUCCESS.value),
            ["y_pipe", "exec_status"],
        ),
        (
            "errors",
            "a success has both final errors",
            success & (position.is_null() | rotation.is_null()),
            ["final_position_error_m", "final_rotation_error_rad"],
        ),
        (
            "margin_null",
            "tolerance_margin is null exactly where a final error is",
            margin.is_null() != (position.is_null() | rotation.is_null()),
            ["tolerance_margin", "final_position_error_m", "final_rotation_error_rad"],
        ),
        (
            "margin",
            f"tolerance_margin is 1 minus the larger of position error / {position_tolerance_m:g} m"
            f" and rotation error / {rotation_tolerance_rad:.6g} rad",
            (margin - expected).abs() > _MARGIN_ROUNDING * (1.0 + expected.abs()),
            ["tolerance_margin", "final_position_error_m", "final_rotation_error_rad"],
        ),
        ("success_margin", "a success has tolerance_margin of at least 0", success & (margin < 0.0), ["y_pipe", "tolerance_margin"]),
        (
            "off_target_margin",
            f"{ExecStatus.OFF_TARGET.value} has tolerance_margin below 0",
            (pl.col("exec_status") == ExecStatus.OFF_TARGET.value) & (margin >= 0.0),
            ["exec_status", "tolerance_margin"],
        ),
        *executed_only,
    ]


def _sentence(name: str, rule: str, broken: pl.DataFrame, columns: list[str]) -> str | None:
    if broken.is_empty():
        return None
    first = broken.sort("candidate_id").row(0, named=True)
    values = ", ".join(f"{column} = {first[column]!r}" for column in columns)
    return f"{name}: {rule}; broken by {broken.height} candidates, must be 0; first {first['candidate_id']} with {values}"


def _pairing_errors(candidates: pl.DataFrame, grasps: pl.DataFrame, targets: pl.DataFrame) -> list[str]:
    """Candidates must be the lifted grasps of each scene times its targets, no more and no less."""
    keys = ["scene_id", "target_id", "grasp_id"]
    lifted = grasps.filter(pl.col("lift_status") == LiftStatus.LIFTED.value).select("scene_id", "grasp_id")
    wanted = lifted.join(targets.select("scene_id", "target_id"), on="scene_id").select(keys)
    errors = []
    for what, left, right in (("missing", wanted, candidates), ("extra", candidates, wanted)):
        rows = left.select(keys).join(right.select(keys), on=keys, how="anti").sort(keys)
        if not rows.is_empty():
            scene_id, target_id, grasp_id = rows.row(0)
            errors.append(
                f"pairing: candidates are lifted grasps x targets; {rows.height} {what}, must be 0;"
                f" first scene {scene_id}, target {target_id}, grasp {grasp_id}"
            )
    repeated = candidates.filter(pl.struct(keys).is_duplicated())
    if not repeated.is_empty():
        errors.append(
            f"pairing: {repeated.height} candidates share their coordinates, must be 0; first {repeated['candidate_id'].sort()[0]}"
        )
    return errors
