"""What is inside a list is checked like any other value: no null, no number that is not finite."""

from __future__ import annotations

import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tables.columns import Column, SchemaError, TableSchema, integers, joint_columns, plain, reals
from tables.schemas import OBJECT_PARTS, PLANS
from tables.store import check_table, table_from_columns, table_from_rows

NAN, INF = float("nan"), float("inf")
LISTS = TableSchema("lists", "rows for tests", ("id",), (plain("id", "key"), reals("path", "list"), reals("maybe", "list", nullable=True)))
NESTED = TableSchema(
    "nested", "rows for tests", ("id",), (plain("id", "key"), Column("paths", pa.list_(pa.list_(pa.float64())), "lists of lists"))
)


def _table(schema: TableSchema, *lists: list) -> pa.Table:
    """A table that no check has seen: one column after the key for each of `lists`."""
    ids = [f"{k:03d}" for k in range(len(lists[0]))]
    return pa.Table.from_arrays([pa.array(values, dtype) for values, dtype in zip((ids, *lists), schema.arrow.types)], schema=schema.arrow)


@pytest.mark.parametrize(
    ("path", "maybe", "message"),
    [
        ([[1.0, NAN], [NAN]], [None, None], r"lists\.path: 2 values inside lists that are not finite, must be 0"),
        ([[1.0], [-INF]], [None, None], r"lists\.path: 1 values inside lists that are not finite, must be 0"),
        ([[], [1.0]], [None, [INF, 0.0]], r"lists\.maybe: 1 values inside lists that are not finite, must be 0"),
        ([[1.0, None], [None]], [None, None], r"lists\.path: 2 nulls inside lists, must be 0"),
        ([[], []], [[None], None], r"lists\.maybe: 1 nulls inside lists, must be 0"),
        ([[1.0], None], [None, None], r"lists\.path: 1 nulls, must be 0"),
    ],
)
def test_what_a_list_may_not_hold_raises(path: list, maybe: list, message: str) -> None:
    table = _table(LISTS, path, maybe)
    with pytest.raises(SchemaError, match=message):
        check_table(LISTS, table)
    with pytest.raises(SchemaError, match=message):
        table_from_columns(LISTS, {name: table[name] for name in LISTS.names})


@pytest.mark.parametrize(
    ("paths", "message"),
    [
        ([[[1.0], [NAN, INF]], []], r"nested\.paths: 2 values inside lists that are not finite"),
        ([[[1.0], None], []], r"nested\.paths: 1 nulls inside lists"),
        ([[[1.0], []], [[None]]], r"nested\.paths: 1 nulls inside lists"),
    ],
)
def test_lists_inside_lists_are_checked(paths: list, message: str) -> None:
    with pytest.raises(SchemaError, match=message):
        check_table(NESTED, _table(NESTED, paths))


def test_empty_lists_at_every_depth_are_values() -> None:
    check_table(NESTED, _table(NESTED, [[], [[]], [[], [1.0], []]]))
    check_table(NESTED, _table(NESTED, []))
    check_table(LISTS, _table(LISTS, [[], [], []], [None, [], [0.0]]))
    check_table(LISTS, _table(LISTS, [[]], [None]))


def test_only_what_a_slice_shows_is_checked() -> None:
    table = _table(LISTS, [[NAN], [1.0], [2.0], [None]], [[INF], None, [3.0], None])
    check_table(LISTS, table.slice(1, 2))
    for shown, what in ((table.slice(0, 2), "values"), (table.slice(2), "nulls")):
        with pytest.raises(SchemaError, match=rf"lists\.path: 1 {what} inside lists"):
            check_table(LISTS, shown)


def test_what_lies_under_a_null_list_is_not_a_value() -> None:
    path = pa.array([[1.0], [2.0]], pa.list_(pa.float64()))
    hidden = pa.ListArray.from_arrays(pa.array([0, 2, 3], pa.int32()), pa.array([NAN, INF, 0.0]), mask=pa.array([True, False]))
    check_table(LISTS, pa.Table.from_arrays([pa.array(["a", "b"]), path, hidden], schema=LISTS.arrow))


def test_every_chunk_is_checked() -> None:
    chunks = [_table(LISTS, [[1.0]], [None]), _table(LISTS, [[1.0], [NAN]], [None, None]).slice(1)]
    with pytest.raises(SchemaError, match=r"lists\.path: 1 values inside lists"):
        check_table(LISTS, pa.concat_tables(chunks))


@given(st.lists(st.none() | st.lists(st.none() | st.floats()), min_size=1, max_size=6), st.data())
def test_a_list_column_passes_exactly_when_every_number_in_it_is_finite(maybe: list, data: st.DataObject) -> None:
    start = data.draw(st.integers(0, len(maybe) - 1))
    table = _table(LISTS, [[] for _ in maybe], maybe).slice(start)
    numbers = [number for some in maybe[start:] if some is not None for number in some]
    if all(number is not None and abs(number) < INF for number in numbers):
        check_table(LISTS, table)
    else:
        with pytest.raises(SchemaError, match=r"lists\.maybe: \d+ (values|nulls) inside lists"):
            check_table(LISTS, table)


def test_plans_and_parts_of_the_benchmark_refuse_them() -> None:
    with pytest.raises(SchemaError, match=r"plans\.via_q_rad: 1 values inside lists that are not finite"):
        table_from_rows(PLANS, [{"candidate_id": "full-0001-t0-g00", **dict.fromkeys(joint_columns("place_q"), 0.0), "via_q_rad": [NAN]}])
    with pytest.raises(SchemaError, match=r"object_parts\.faces: 1 nulls inside lists"):
        table_from_rows(OBJECT_PARTS, [{"object_id": "can_01", "part_id": 0, "vertices_m": [0.0], "faces": [0, None, 2]}])


def test_whole_numbers_in_lists_pass() -> None:
    schema = TableSchema("faces", "rows for tests", ("id",), (plain("id", "key"), integers("faces", "list")))
    check_table(schema, _table(schema, [[], [1, -2]]))
