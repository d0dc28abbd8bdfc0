"""Each law of the chain, over a release, is broken by a planted fault and says so; a sound release breaks none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pyarrow as pa
import pytest

from pipelines.stages import STAGES
from splits.release_laws import broken_laws
from tables import schemas
from tables.columns import joint_columns
from tables.store import table_from_rows
from tests.model.synthetic_release import TOLERANCES
from tests.splits.changed import changed

Row = dict[str, Any]


def errors_of(tables: dict[str, pa.Table], **tolerances: float) -> list[str]:
    return broken_laws(tables, replace(TOLERANCES, **tolerances))


def test_a_sound_release_breaks_no_law(release_tables: dict[str, pa.Table]) -> None:
    assert errors_of(release_tables) == []


def test_a_release_without_plans_is_held_to_every_other_law(release_tables: dict[str, pa.Table]) -> None:
    assert "plans" not in release_tables
    broken = changed(schemas.CANDIDATES, release_tables["candidates"], lambda row: row["y_plan"], n_waypoints=None)
    assert errors_of(release_tables | {"candidates": broken}) != []


PLANNED, UNPLANNED, SUCCESS = {"y_plan": True}, {"y_plan": False}, {"exec_status": "success"}
SLIPPED, OFF_TARGET = {"exec_status": "slipped_in_hand"}, {"exec_status": "off_target"}

# (the stage whose law is broken, words that must be said, which candidate, what it becomes)
IMPOSSIBLE: list[tuple[str, str, Row, Row]] = [
    ("execution_labels", "y_pipe is there for every execution", PLANNED, {"y_pipe": None}),
    ("execution_labels", "y_pipe is null where exec_status is", UNPLANNED, {"y_pipe": True}),
    ("execution_labels", "planned candidates are missing in execution_labels", PLANNED, {"exec_status": None}),
    ("execution_labels", "execution_labels are missing in planned candidates", UNPLANNED, {"exec_status": "success"}),
    ("planning_labels", "y_plan says the same as plan_status", PLANNED, {"plan_status": "no_ik"}),
    ("planning_labels", "y_plan says the same as plan_status", UNPLANNED, {"plan_status": "solved"}),
    ("planning_labels", "plan_duration_s is null exactly where y_plan is false", PLANNED, {"plan_duration_s": None}),
    ("planning_labels", "plan_duration_s is null exactly where y_plan is false", UNPLANNED, {"plan_duration_s": 3.0}),
    ("planning_labels", "n_waypoints is null exactly where y_plan is false", UNPLANNED, {"n_waypoints": 2}),
    ("execution_labels", "y_pipe says the same as exec_status", SUCCESS, {"y_pipe": False}),
    ("execution_labels", "y_pipe says the same as exec_status", SUCCESS, {"exec_status": "slipped_in_hand"}),
    ("execution_labels", "final_position_error_m is there", SUCCESS, {"final_position_error_m": None}),
    ("execution_labels", "tolerance_margin is there for every execution", SUCCESS, {"tolerance_margin": None}),
    ("execution_labels", "tolerance_margin is 1 minus", SUCCESS, {"final_rotation_error_rad": 0.1746}),
    ("execution_labels", "tolerance_margin is 1 minus", SUCCESS, {"tolerance_margin": 0.999}),
    (
        "execution_labels",
        "a success has tolerance_margin of at least 0",
        SUCCESS,
        {"final_position_error_m": 0.021, "tolerance_margin": 1 - 0.021 / 0.02},
    ),
    (
        "execution_labels",
        "off_target has tolerance_margin below 0",
        OFF_TARGET,
        {"final_position_error_m": 0.019, "final_rotation_error_rad": 0.0, "tolerance_margin": 0.05},
    ),
    ("execution_labels", "a success has transport_slip_m of at most 0.002 m", SUCCESS, {"transport_slip_m": 0.0021}),
    ("execution_labels", "transport_slip_rad of at most 0.0349066 rad", SUCCESS, {"transport_slip_rad": 0.035}),
    ("execution_labels", "a success has transport_slip_m of at most 0.002 m", SLIPPED, {"exec_status": "success", "y_pipe": True}),
    ("execution_labels", "slipped_in_hand has tolerance_margin of at least 0", OFF_TARGET, SLIPPED | {"transport_slip_m": 0.003}),
    ("execution_labels", "slipped_in_hand has transport_slip_m above 0.002 m or", SLIPPED, {"transport_slip_m": 0.002}),
    ("execution_labels", "slipped_in_hand has transport_slip_m above 0.002 m or", SUCCESS, SLIPPED | {"y_pipe": False}),
    ("execution_labels", "off_target has tolerance_margin below 0", SLIPPED, OFF_TARGET),
    ("execution_labels", "transport_slip_m is there for every execution", SLIPPED, {"transport_slip_m": None}),
    ("execution_labels", "retreat_drag_m is there exactly where the hand let go", SUCCESS, {"retreat_drag_m": None}),
    ("execution_labels", "n_physics_steps is null where exec_status is", UNPLANNED, {"n_physics_steps": 10}),
    ("execution_labels", "final_x_m is null where exec_status is", UNPLANNED, {"final_x_m": 0.5}),
    ("candidate_pairs", "object, category and obstacle count are the scene's", PLANNED, {"category": "mesh"}),
]


@pytest.mark.parametrize(("stage", "words", "which", "values"), IMPOSSIBLE)
def test_an_impossible_combination_is_named(release_tables: dict[str, pa.Table], stage: str, words: str, which: Row, values: Row) -> None:
    broken = changed(schemas.CANDIDATES, release_tables["candidates"], lambda row: which.items() <= row.items(), **values)
    found = [error for error in errors_of(release_tables | {"candidates": broken}) if words in error]
    assert len(found) == 1
    assert found[0].startswith(f"{stage}: ")
    first = next(row["candidate_id"] for row in release_tables["candidates"].to_pylist() if which.items() <= row.items())
    assert f"first {first}" in found[0]


def _without_first(name: str, schema: Any, which: Callable[[Row], bool] = lambda row: True) -> Callable[[dict[str, pa.Table]], pa.Table]:
    def drop(tables: dict[str, pa.Table]) -> pa.Table:
        rows = tables[name].to_pylist()
        rows.remove(next(row for row in rows if which(row)))
        return table_from_rows(schema, rows)

    return drop


# (the stage whose law is broken, the table that is changed, how, words that must be said)
FAULTS: list[tuple[str, str, Callable[[dict[str, pa.Table]], pa.Table], str]] = [
    ("scenes", "targets", _without_first("targets", schemas.TARGETS), "must be"),
    ("scenes", "obstacles", _without_first("obstacles", schemas.OBSTACLES), "must be"),
    (
        "scenes",
        "targets",
        lambda tables: changed(schemas.TARGETS, tables["targets"], lambda row: True, scene_id="full-0999"),
        "rows of full-0999, which is no scene",
    ),
    (
        "scene_points",
        "scene_points",
        lambda tables: table_from_rows(
            schemas.SCENE_POINTS,
            [r for r in tables["scene_points"].to_pylist() if (r["scene_id"], r["point_type"]) != ("full-0000", "object")],
        ),
        "full-0000 has no object point",
    ),
    (
        "grasp_admission",
        "grasps",
        lambda tables: changed(schemas.GRASPS, tables["grasps"], lambda row: row["lift_status"] == "lifted", grasp_q_1_rad=None),
        "exactly where a grasp was admitted",
    ),
    (
        "pick_lift",
        "grasps",
        lambda tables: changed(schemas.GRASPS, tables["grasps"], lambda row: row["lift_status"] == "lifted", inhand_x_m=None),
        "a lifted grasp has a measured state",
    ),
    (
        "pick_lift",
        "grasps",
        lambda tables: changed(schemas.GRASPS, tables["grasps"], lambda row: row["lift_status"] == "lifted", admission_status="no_ik"),
        "pick_lift are missing in admitted grasps",
    ),
    (
        "candidate_pairs",
        "grasps",
        lambda tables: changed(schemas.GRASPS, tables["grasps"], lambda row: row["lift_status"] == "lifted", lift_status="slipped"),
        "8 of candidate_pairs are missing in lifted grasps x targets, must be 0",
    ),
    ("candidate_pairs", "candidates", _without_first("candidates", schemas.CANDIDATES), "1 of lifted grasps x targets are missing"),
    (
        "candidate_pairs",
        "candidates",
        lambda tables: changed(schemas.CANDIDATES, tables["candidates"], lambda row: True, candidate_id="full-0000-t0-g99"),
        "candidate_id is made of its coordinates",
    ),
    (
        "policy_features",
        "policy_features",
        _without_first("policy_features", schemas.POLICY_FEATURES),
        "candidate_pairs are missing in policy_features",
    ),
]


@pytest.mark.parametrize(("stage", "table", "change", "words"), FAULTS)
def test_a_planted_fault_is_named(
    release_tables: dict[str, pa.Table], stage: str, table: str, change: Callable[[dict[str, pa.Table]], pa.Table], words: str
) -> None:
    errors = errors_of(release_tables | {table: change(release_tables)})
    assert any(error.startswith(f"{stage}: ") and words in error for error in errors), errors


def test_every_stage_s_law_is_broken_by_some_fault() -> None:
    assert {stage.name for stage in STAGES} == {row[0] for row in IMPOSSIBLE} | {row[0] for row in FAULTS}


def test_a_plan_without_its_motion_is_named(release_tables: dict[str, pa.Table]) -> None:
    planned = [row["candidate_id"] for row in release_tables["candidates"].to_pylist() if row["y_plan"]]
    motion = {**dict.fromkeys(joint_columns("place_q"), 0.0), "via_q_rad": []}
    plans = table_from_rows(schemas.PLANS, [{"candidate_id": name, **motion} for name in planned])
    assert errors_of(release_tables | {"plans": plans}) == []
    (error,) = errors_of(release_tables | {"plans": plans.slice(1)})
    assert error.startswith("planning_labels: 1 of planned candidates are missing in plans, must be 0; first full-0000")


def test_the_tolerance_is_the_caller_s(release_tables: dict[str, pa.Table]) -> None:
    errors = errors_of(release_tables, position_m=0.010)
    assert any("tolerance_margin is 1 minus" in error and "0.01 m" in error for error in errors)


@pytest.mark.parametrize(
    ("bound", "words"),
    [
        ({"slip_m": 0.0009}, "a success has transport_slip_m of at most 0.0009 m"),
        ({"slip_rad": 0.009}, "transport_slip_rad of at most 0.009 rad"),
        ({"slip_m": 0.003}, "slipped_in_hand has transport_slip_m above 0.003 m"),
    ],
)
def test_the_bound_on_slip_is_the_caller_s(release_tables: dict[str, pa.Table], bound: dict[str, float], words: str) -> None:
    (error,) = errors_of(release_tables, **bound)
    assert error.startswith("execution_labels: ")
    assert words in error


@pytest.mark.parametrize("slip", [{"transport_slip_m": 0.0021}, {"transport_slip_rad": 0.035}])
def test_a_valid_end_with_either_slip_is_a_lawful_slip(release_tables: dict[str, pa.Table], slip: Row) -> None:
    values = SLIPPED | {"y_pipe": False} | slip
    slipped = changed(schemas.CANDIDATES, release_tables["candidates"], lambda row: SUCCESS.items() <= row.items(), **values)
    assert errors_of(release_tables | {"candidates": slipped}) == []


def test_what_slips_exactly_as_far_as_it_may_is_a_success(release_tables: dict[str, pa.Table]) -> None:
    at_bounds = {"transport_slip_m": TOLERANCES.slip_m, "transport_slip_rad": TOLERANCES.slip_rad}
    held = changed(schemas.CANDIDATES, release_tables["candidates"], lambda row: SUCCESS.items() <= row.items(), **at_bounds)
    assert errors_of(release_tables | {"candidates": held}) == []


@pytest.mark.parametrize("status", ["toppled_at_release", "off_target"])
def test_what_does_not_end_valid_may_slip_or_not(release_tables: dict[str, pa.Table], status: str) -> None:
    slipped = changed(schemas.CANDIDATES, release_tables["candidates"], lambda row: row["exec_status"] == status, transport_slip_m=0.04)
    assert errors_of(release_tables | {"candidates": slipped}) == []


def test_rows_in_any_order_give_the_same_sentences(release_tables: dict[str, pa.Table]) -> None:
    rows = release_tables["candidates"].to_pylist()
    for row in rows:
        row["y_pipe"] = None
    broken = table_from_rows(schemas.CANDIDATES, rows)
    backwards = broken.take(list(range(broken.num_rows))[::-1])
    assert errors_of(release_tables | {"candidates": broken}) == errors_of(release_tables | {"candidates": backwards}) != []
