from __future__ import annotations

from typing import Any

import pyarrow as pa
import pytest

from splits.label_errors import find_label_errors
from tables import schemas
from tables.store import table_from_rows
from tests.model.synthetic_release import TOLERANCES
from tests.splits.changed import changed


def errors_of(tables: dict[str, pa.Table], candidates: pa.Table | None = None, **tolerances: float) -> list[str]:
    return find_label_errors(candidates or tables["candidates"], tables["grasps"], tables["targets"], **{**TOLERANCES, **tolerances})


def test_a_sound_release_has_no_error(release_tables: dict[str, pa.Table]) -> None:
    assert errors_of(release_tables) == []


# (rule that must be named, which row, what it becomes)
IMPOSSIBLE: list[tuple[str, dict[str, Any], dict[str, Any]]] = [
    ("y_pipe_null", {"y_plan": True}, {"y_pipe": None}),
    ("y_pipe_null", {"y_plan": False}, {"y_pipe": True}),
    ("exec_status_null", {"y_plan": True}, {"exec_status": None}),
    ("exec_status_null", {"y_plan": False}, {"exec_status": "success"}),
    ("plan", {"y_plan": True}, {"plan_status": "no_ik"}),
    ("plan", {"y_plan": False}, {"plan_status": "solved"}),
    ("plan_duration", {"y_plan": True}, {"plan_duration_s": None}),
    ("plan_duration", {"y_plan": False}, {"plan_duration_s": 3.0}),
    ("y_pipe", {"exec_status": "success"}, {"y_pipe": False}),
    ("y_pipe", {"exec_status": "success"}, {"exec_status": "slipped_in_hand"}),
    ("errors", {"exec_status": "success"}, {"final_position_error_m": None, "tolerance_margin": None}),
    ("margin_null", {"exec_status": "success"}, {"tolerance_margin": None}),
    ("margin", {"exec_status": "success"}, {"final_rotation_error_rad": 0.1746}),
    ("margin", {"exec_status": "success"}, {"tolerance_margin": 0.999}),
    ("success_margin", {"exec_status": "success"}, {"final_position_error_m": 0.021, "tolerance_margin": 1 - 0.021 / 0.02}),
    (
        "off_target_margin",
        {"exec_status": "off_target"},
        {"final_position_error_m": 0.019, "final_rotation_error_rad": 0.0, "tolerance_margin": 0.05},
    ),
    ("n_physics_steps_without_plan", {"y_plan": False}, {"n_physics_steps": 10}),
    ("final_x_m_without_plan", {"y_plan": False}, {"final_x_m": 0.5}),
]


@pytest.mark.parametrize(("rule", "which", "values"), IMPOSSIBLE)
def test_an_impossible_combination_is_named(
    release_tables: dict[str, pa.Table], rule: str, which: dict[str, Any], values: dict[str, Any]
) -> None:
    broken = changed(schemas.CANDIDATES, release_tables["candidates"], lambda row: which.items() <= row.items(), **values)
    errors = errors_of(release_tables, broken)
    (found,) = [error for error in errors if error.startswith(f"{rule}:")]
    assert "broken by 1 candidates, must be 0" in found
    first = next(row["candidate_id"] for row in release_tables["candidates"].to_pylist() if which.items() <= row.items())
    assert f"first {first} with" in found


def test_an_id_must_be_made_of_its_coordinates(release_tables: dict[str, pa.Table]) -> None:
    broken = changed(schemas.CANDIDATES, release_tables["candidates"], lambda row: row["grasp_id"] < 9, candidate_id="full-0000-t0-g9")
    assert [error.split(":")[0] for error in errors_of(release_tables, broken)] == ["id"]


def test_candidates_are_lifted_grasps_times_targets(release_tables: dict[str, pa.Table]) -> None:
    candidates = release_tables["candidates"]
    (missing,) = errors_of(release_tables, candidates.slice(1))
    assert "1 missing, must be 0; first scene full-0000, target 0, grasp" in missing
    lifted = {"lift_status": "lifted", "scene_id": "full-0003"}
    unlifted = changed(schemas.GRASPS, release_tables["grasps"], lambda row: lifted.items() <= row.items(), lift_status="slipped")
    (extra,) = errors_of(release_tables | {"grasps": unlifted})
    assert "8 extra, must be 0; first scene full-0003" in extra


def test_the_tolerance_is_the_caller_s(release_tables: dict[str, pa.Table]) -> None:
    errors = errors_of(release_tables, position_tolerance_m=0.010)
    assert any(error.startswith("margin:") and "0.01 m" in error for error in errors)


def test_rows_in_any_order_give_the_same_sentences(release_tables: dict[str, pa.Table]) -> None:
    rows = release_tables["candidates"].to_pylist()
    for row in rows:
        row["y_pipe"] = None
    broken = table_from_rows(schemas.CANDIDATES, rows)
    backwards = broken.take(list(range(broken.num_rows))[::-1])
    assert errors_of(release_tables, broken) == errors_of(release_tables, backwards) != []
