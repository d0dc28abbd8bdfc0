"""Numbers that the UI plots: counts and rates of every status, flags, and no rate of nothing."""

from __future__ import annotations

import polars as pl
import pytest

from assets_def.metadata import outcome_numbers, type_in_words
from pipelines.frames import frame_of
from tables.columns import TableSchema, enum, flag, integer
from tables.schemas import ALL_SCHEMAS, AUDITS, CANDIDATES, EXECUTION_LABELS, GRASPS, PICK_LIFT, PLANNING_LABELS
from tables.vocabulary import ExecStatus, LiftStatus, PlanStatus

TABLE = TableSchema(
    "made_up",
    "a lift and a flag",
    ("row",),
    (integer("row", "key"), enum("lift_status", LiftStatus, "outcome", nullable=True), flag("agrees", "or not", nullable=True)),
)


def numbers(lifts: list[str | None], agrees: list[bool | None]) -> dict[str, int | float]:
    return outcome_numbers(
        TABLE, pl.DataFrame({"lift_status": lifts, "agrees": agrees}, schema={"lift_status": pl.String, "agrees": pl.Boolean})
    )


def test_counts_and_rates_are_of_the_rows_that_have_a_status() -> None:
    found = numbers(["lifted", "lifted", "slipped", None], [True, False, None, None])
    assert {name for name in found if name.startswith("n_")} == {f"n_{status.value}" for status in LiftStatus}
    assert (found["n_lifted"], found["n_slipped"], found["n_disturbed"]) == (2, 1, 0)
    assert found["rate_lifted"] == pytest.approx(2 / 3)
    assert found["rate_disturbed"] == 0.0
    assert found["rate_agrees"] == pytest.approx(0.5)
    assert all(type(value) is (int if name.startswith("n_") else float) for name, value in found.items())


def test_there_is_no_rate_of_nothing() -> None:
    found = numbers([None], [None])
    assert found == {f"n_{status.value}": 0 for status in LiftStatus}


@pytest.mark.parametrize(
    ("schema", "names"),
    [
        (PICK_LIFT, {f"n_{status.value}" for status in LiftStatus}),
        (PLANNING_LABELS, {f"n_{status.value}" for status in PlanStatus}),
        (EXECUTION_LABELS, {f"n_{status.value}" for status in ExecStatus}),
        (CANDIDATES, {f"n_{status.value}" for status in (*PlanStatus, *ExecStatus)}),
        (GRASPS, {"n_admitted", "n_no_ik", "n_lifted"}),
        (AUDITS, {"n_stored_solved", "n_audited_solved"}),
    ],
    ids=lambda value: value.name if isinstance(value, TableSchema) else "",
)
def test_every_status_of_a_table_has_a_name_of_its_own(schema: TableSchema, names: set[str]) -> None:
    found = set(outcome_numbers(schema, frame_of(schema.arrow.empty_table())))
    assert found >= names
    assert len(found) == sum(len(column.values) for column in schema.columns if column.name.endswith("_status"))


def test_types_are_words() -> None:
    assert [type_in_words(column) for column in TABLE.columns] == ["integer", "category", "yes or no"]
    words = {type_in_words(column) for schema in ALL_SCHEMAS.values() for column in schema.columns}
    assert words == {"category", "text", "integer", "number", "yes or no", "list of numbers", "list of integers"}
