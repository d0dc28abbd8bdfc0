"""What is written is what is read; what the schema forbids never reaches the disk; half a table is no table."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tables.columns import SchemaError, TableSchema, enum, flag, integer, integers, plain, real, reals, single
from tables.schemas import ALL_SCHEMAS, EXECUTION_LABELS, SPLITS
from tables.store import (
    StoreError,
    content_hash,
    read_parquet,
    read_sidecar,
    read_table,
    read_tables,
    sidecar_path,
    table_from_rows,
    write_parquet,
    write_table,
)
from tables.vocabulary import Split
from tests.split_rows import split_row

SAMPLE = TableSchema(
    "sample",
    "rows for tests",
    ("id",),
    (plain("id", "key"), enum("split", Split, "kind", nullable=True), real("x_m", "x", "m", nullable=True), reals("path", "list")),
)

_rows = st.lists(
    st.fixed_dictionaries(
        {
            "id": st.text("abcdef-0123", min_size=1, max_size=6),
            "split": st.sampled_from(["train", "test", None]),
            "x_m": st.none() | st.floats(-1e6, 1e6),
            "path": st.lists(st.floats(-1, 1), max_size=3),
        }
    ),
    max_size=12,
    unique_by=lambda row: row["id"],
)


@given(_rows, st.randoms(use_true_random=False))
def test_row_order_does_not_change_the_table(rows: list[dict], random) -> None:
    shuffled = random.sample(rows, len(rows))
    a, b = table_from_rows(SAMPLE, rows), table_from_rows(SAMPLE, shuffled)
    assert a.equals(b)
    assert content_hash(a) == content_hash(b)
    assert a.to_pylist() == sorted(rows, key=lambda row: row["id"])


@given(_rows.filter(len), st.data())
def test_any_changed_value_changes_the_hash(rows: list[dict], data) -> None:
    changed = [dict(row) for row in rows]
    row = changed[data.draw(st.integers(0, len(rows) - 1))]
    row["path"] = [*row["path"], 0.0]
    assert content_hash(table_from_rows(SAMPLE, rows)) != content_hash(table_from_rows(SAMPLE, changed))


def test_round_trip_on_disk(tmp_path: Path) -> None:
    rows = [
        {"id": f"{k:03d}", "split": None if k % 3 else "test", "x_m": None if k % 2 else k / 7, "path": [k / 3] * (k % 4)}
        for k in range(50)
    ]
    table = table_from_rows(SAMPLE, rows)
    sidecar = write_table(SAMPLE, table, tmp_path / "t.parquet", {"recipe": "abc"})
    back = read_table(SAMPLE, tmp_path / "t.parquet", verify=True)
    assert back.to_pylist() == rows
    assert content_hash(back) == sidecar.content_hash == content_hash(table)
    assert read_sidecar(tmp_path / "t.parquet").made_from == {"recipe": "abc"}


def test_encodings_follow_types_and_values_and_lose_nothing(tmp_path: Path) -> None:
    columns = (
        *(
            plain("id", "key"),
            enum("split", Split, "kind"),
            flag("is_even", "flag"),
            integer("k", "counter"),
            integer("digit", "few values"),
        ),
        *(real("noise_m", "no two alike", "m", nullable=True), real("step_m", "few values", "m"), single("bulk_m", "32 bits", "m")),
        *(reals("path", "no two alike"), integers("faces", "numbers")),
    )
    schema = TableSchema("mixed", "rows for tests", ("id",), columns)
    noise, n = np.random.default_rng(1).normal(size=3000), 1000
    rows = [
        {
            **{
                "id": f"full-0001-t{k // 100}-g{k % 100:02d}",
                "split": ["train", "test"][k % 2],
                "is_even": k % 2 == 0,
                "k": k,
                "digit": k % 7,
            },
            **{"noise_m": None if k % 5 == 0 else noise[k], "step_m": 0.5 * (k % 3), "bulk_m": float(np.float32(noise[k]))},
            **{"path": noise[n + k : n + k + k % 3].tolist(), "faces": list(range(k % 4))},
        }
        for k in range(n)
    ]
    table = table_from_rows(schema, rows)
    write_table(schema, table, tmp_path / "t.parquet")
    assert read_table(schema, tmp_path / "t.parquet", verify=True).to_pylist() == rows
    group = pq.ParquetFile(tmp_path / "t.parquet").metadata.row_group(0)
    encodings = {column.path_in_schema: set(column.encodings) for column in map(group.column, range(group.num_columns))}
    for path in ("split", "step_m", "digit"):
        assert "RLE_DICTIONARY" in encodings[path]
    for path in ("noise_m", "bulk_m", "path.list.element"):
        assert "BYTE_STREAM_SPLIT" in encodings[path]
    assert "DELTA_BYTE_ARRAY" in encodings["id"]
    assert "DELTA_BINARY_PACKED" in encodings["k"]
    assert pl.read_parquet(tmp_path / "t.parquet")["noise_m"].to_list() == [row["noise_m"] for row in rows]
    pq.write_table(table, tmp_path / "default.parquet", compression="zstd")
    assert (tmp_path / "t.parquet").stat().st_size < 0.8 * (tmp_path / "default.parquet").stat().st_size


def test_equal_tables_are_equal_files(tmp_path: Path) -> None:
    table = table_from_rows(SPLITS, [split_row(f"full-{k:04d}", "train") for k in range(9)])
    assert write_table(SPLITS, table, tmp_path / "a.parquet").sha256 == write_table(SPLITS, table, tmp_path / "b.parquet").sha256


def test_what_a_file_states_of_itself_is_no_part_of_its_content(tmp_path: Path) -> None:
    table = table_from_rows(SPLITS, [split_row("full-0000", "train")])
    silent, stating = tmp_path / "silent.parquet", tmp_path / "stating.parquet"
    without, stated = write_table(SPLITS, table, silent), write_table(SPLITS, table, stating, stated={"about": "mini"})
    assert pq.read_schema(silent).metadata is None
    assert pq.read_schema(stating).metadata == {b"about": b"mini"}
    assert stated.content_hash == without.content_hash
    for path in (silent, stating):
        read = read_table(SPLITS, path, verify=True)
        assert read.equals(table)
        assert read.schema.metadata is None


def test_joining_parts_equals_the_whole(tmp_path: Path) -> None:
    rows = [split_row(f"full-{k:04d}", ["train", "test"][k % 2]) for k in range(10)]
    for part in range(2):
        write_table(SPLITS, table_from_rows(SPLITS, rows[part::2]), tmp_path / f"{part}.parquet")
    assert read_tables(SPLITS, [tmp_path / "1.parquet", tmp_path / "0.parquet"]).equals(table_from_rows(SPLITS, rows))


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ({"id": "a", "split": "tain", "x_m": 1.0, "path": []}, "'tain', must be one of"),
        ({"id": "a", "split": "train", "x_m": float("nan"), "path": []}, "1 values that are not finite"),
        ({"id": "a", "split": "train", "x_m": float("inf"), "path": []}, "1 values that are not finite"),
        ({"id": None, "split": "train", "x_m": 1.0, "path": []}, "1 nulls, must be 0"),
        ({"id": "a", "split": "train", "x_m": "far", "path": []}, "sample.x_m"),
        ({"id": "a", "split": "train", "path": []}, r"missing columns \['x_m'\]"),
        ({"id": "a", "split": "train", "x_m": 1.0, "path": [], "y": 1}, r"unknown columns \['y'\]"),
    ],
)
def test_what_the_schema_forbids_raises(row: dict, message: str) -> None:
    with pytest.raises(SchemaError, match=message):
        table_from_rows(SAMPLE, [row])


def test_repeated_key_raises() -> None:
    with pytest.raises(SchemaError, match="1 repeated keys"):
        table_from_rows(SPLITS, [split_row("full-0001", "train"), split_row("full-0001", "test")])


def test_a_changed_byte_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    write_table(SPLITS, table_from_rows(SPLITS, [split_row("full-0001", "train")]), path)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(bytes(content))
    with pytest.raises(StoreError, match="SHA-256"):
        read_table(SPLITS, path, verify=True)


def test_a_table_without_sidecar_is_not_published(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    write_table(SPLITS, table_from_rows(SPLITS, []), path)
    sidecar_path(path).unlink()
    with pytest.raises(StoreError, match="not published"):
        read_table(SPLITS, path)


def test_a_table_of_another_kind_is_refused(tmp_path: Path) -> None:
    write_table(SPLITS, table_from_rows(SPLITS, []), tmp_path / "t.parquet")
    with pytest.raises(StoreError, match="holds table 'splits'"):
        read_table(EXECUTION_LABELS, tmp_path / "t.parquet")


def test_without_a_sidecar_it_is_the_same_file(tmp_path: Path) -> None:
    table = table_from_rows(SAMPLE, [{"id": "a", "split": "train", "x_m": 0.5, "path": [1.0, 2.0]}])
    write_table(SAMPLE, table, tmp_path / "with.parquet")
    write_parquet(SAMPLE, table, tmp_path / "split=test" / "without.parquet", described=False)
    assert (tmp_path / "split=test" / "without.parquet").read_bytes() == (tmp_path / "with.parquet").read_bytes()
    assert [path.name for path in (tmp_path / "split=test").iterdir()] == ["without.parquet"]
    assert read_parquet(SAMPLE, tmp_path / "split=test" / "without.parquet").equals(table), "no column is read from the folder's name"
    with pytest.raises(SchemaError, match="sample: schema differs"):
        write_parquet(SAMPLE, table.drop_columns(["path"]), tmp_path / "split=test" / "without.parquet", described=False)
    assert read_parquet(SAMPLE, tmp_path / "split=test" / "without.parquet").equals(table)
    with pytest.raises(StoreError, match="holds columns"):
        read_parquet(SPLITS, tmp_path / "with.parquet")


def test_a_described_file_says_what_its_columns_mean_and_holds_the_same_values(tmp_path: Path) -> None:
    table = table_from_rows(SAMPLE, [{"id": "a", "split": "train", "x_m": 0.5, "path": [1.0, 2.0]}])
    write_parquet(SAMPLE, table, tmp_path / "t.parquet", described=True)
    found = pq.read_schema(tmp_path / "t.parquet")
    for column in SAMPLE.columns:
        words = found.field(column.name).metadata
        assert words[b"description"].decode() == column.meaning
        assert words.get(b"unit", b"").decode() == column.unit
    read = read_parquet(SAMPLE, tmp_path / "t.parquet")
    assert read.equals(table)
    assert content_hash(read) == content_hash(table)


def test_a_failed_write_leaves_the_old_table(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    write_table(SPLITS, table_from_rows(SPLITS, [split_row("full-0001", "train")]), path)
    wrong = pa.table({"scene_id": ["x"], "split": ["y"]})
    with pytest.raises(SchemaError):
        write_table(SPLITS, wrong, path)
    assert read_table(SPLITS, path, verify=True).num_rows == 1
    assert not [p for p in tmp_path.iterdir() if p.name.startswith(".")]


def test_what_lies_under_a_null_does_not_matter() -> None:
    masks = [pa.array(np.array([1.0, value]), mask=np.array([False, True])) for value in (2.0, 3.0)]
    tables = [pa.table({"x_m": mask}) for mask in masks]
    assert content_hash(tables[0]) == content_hash(tables[1])


def test_sidecar_is_readable_by_people(tmp_path: Path) -> None:
    write_table(SPLITS, table_from_rows(SPLITS, []), tmp_path / "t.parquet")
    assert json.loads(sidecar_path(tmp_path / "t.parquet").read_text())["table"] == "splits"


@pytest.mark.parametrize("schema", ALL_SCHEMAS.values(), ids=list(ALL_SCHEMAS))
def test_every_table_can_be_empty_and_every_column_explains_itself(schema: TableSchema) -> None:
    assert table_from_rows(schema, []).num_rows == 0
    for column in schema.columns:
        assert column.meaning, column.name
        if column.name.endswith("_m"):
            assert column.unit == "m", column.name
        if column.name.endswith("_rad"):
            assert column.unit == "rad", column.name
