"""Damage by someone who makes every checksum fit: what the tables say is judged all the same, one line each."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splits.errors import ReleaseError
from splits.manifest import MANIFEST, TEXTS, read_manifest
from splits.release import REQUIRED_TABLES, verify_release
from tables import schemas
from tests.splits.changed import changed
from tests.splits.damage import answer, copy_of, republished, rerendered, without


def cast(table: pa.Table, column: str, to: pa.DataType) -> pa.Table:
    index = table.column_names.index(column)
    return table.set_column(index, pa.field(column, to, table.schema.field(column).nullable), table[column].cast(to))


def with_values(table: pa.Table, column: str, value: object, rows: int = 1) -> pa.Table:
    """The table with a value in its first rows, whatever its schema allows."""
    field = table.schema.field(column)
    plain = pa.string() if pa.types.is_dictionary(field.type) else field.type
    values = table[column].to_pylist()
    return table.set_column(table.column_names.index(column), field, pa.array([value] * rows + values[rows:], plain).cast(field.type))


def success_called_failure(table: pa.Table) -> pa.Table:
    return changed(schemas.CANDIDATES, table, lambda row: row["y_pipe"] is True, y_pipe=False)


def no_quaternion(table: pa.Table) -> pa.Table:
    for part in "xyzw":
        table = with_values(table, f"object_q{part}", 0.0)
    return table


def all_nullable(table: pa.Table) -> pa.Table:
    return table.cast(pa.schema([field.with_nullable(True) for field in table.schema]))


def split_twice(table: pa.Table) -> bytes:
    return parquet_of(table.append_column(table.schema.field("split"), table["split"]))


def not_utf8(table: pa.Table) -> bytes:
    """The first id holds a byte that is no text, as a broken writer would leave it."""
    ids = table["candidate_id"].combine_chunks()
    raw = pa.array([b"\xff", *ids.cast(pa.binary()).to_pylist()[1:]], pa.binary())
    texts = pa.StringArray.from_buffers(len(raw), raw.buffers()[1], raw.buffers()[2])
    return parquet_of(table.set_column(table.column_names.index("candidate_id"), table.schema.field("candidate_id"), texts))


def parquet_of(table: pa.Table) -> bytes:
    sink = io.BytesIO()
    pq.write_table(table, sink)
    return sink.getvalue()


# (table, what becomes of it, words of the line); every checksum fits.
TABLES: list[tuple[str, str, Callable[[pa.Table], pa.Table | bytes], list[str]]] = [
    ("a flipped label", "candidates", success_called_failure, ["laws: 1 broken", "y_pipe says the same as exec_status"]),
    ("a scene without split", "splits", lambda t: t.slice(1), ["leakage: 1 leaks", "full-0000", "in 0 splits"]),
    ("a scene of another tier", "scenes", lambda t: with_values(t, "scene_id", "full-1000"), ["scenes: full-1000 is not in tier pilot"]),
    ("a scene id that is none", "scenes", lambda t: with_values(t, "scene_id", "kitchen"), ["scenes: kitchen is not in tier pilot"]),
    ("an unknown object", "scenes", lambda t: with_values(t, "object_id", "ghost"), ["scenes: object ghost is not in objects"]),
    ("an unknown object in the pool", "grasp_pool", lambda t: with_values(t, "object_id", "ghost"), ["grasp_pool: object ghost"]),
    ("no objects", "objects", lambda t: t.slice(0, 0), ["object", "is not in objects"]),
    ("no targets", "targets", lambda t: t.slice(0, 0), ["laws:", "must be 0"]),
    ("no quaternion", "scenes", no_quaternion, ["scenes: object of scene_id full-0000", "length 0, must be 1 (1 rows are wrong)"]),
    ("half a quaternion", "obstacles", lambda t: with_values(t, "obstacle_qw", 0.5), ["obstacles: obstacle of", "must be 1"]),
    ("an endless quaternion", "grasps", lambda t: with_values(t, "grasp_qx", -1e300), ["grasps: grasp of", "length inf, must be 1"]),
    ("no Parquet", "targets", lambda t: b"PK" * 500, ["targets.parquet: "]),
    ("an empty file", "targets", lambda t: b"", ["targets.parquet: "]),
    ("a Parquet head alone", "targets", lambda t: b"PAR1" + b"\0" * 100 + b"PAR1", ["targets.parquet: "]),
    ("single precision", "targets", lambda t: cast(t, "target_x_m", pa.float32()), ["column target_x_m is float", "must be double"]),
    ("a column that may be null", "targets", all_nullable, ["column ", "must be", "not null"]),
    ("a column missing", "candidates", lambda t: t.drop_columns(["exec_status"]), ["part-0.parquet: column exec_status is missing"]),
    ("a column more", "targets", lambda t: t.append_column("mood", [[1] * len(t)]), ["targets.parquet: column 'mood' is unknown"]),
    ("a column twice", "splits", split_twice, ["column split is there 2 times"]),
    (
        "columns in another order",
        "splits",
        lambda t: t.select(t.column_names[::-1]),
        ["another order, must be scene_id, split,"],
    ),
    ("a status that is none", "candidates", lambda t: with_values(t, "plan_status", "perhaps"), ["plan_status: 'perhaps'", "one of"]),
    ("a number that is none", "targets", lambda t: with_values(t, "target_x_m", float("nan")), ["target_x_m: 1 values", "not finite"]),
    ("a repeated key", "splits", lambda t: with_values(t, "scene_id", "full-0001"), ["splits: 1 repeated keys"]),
    ("a name that is none", "splits", lambda t: parquet_of(t).replace(b"scene_id", b"\xffcene_id"), ["splits.parquet: ", "utf-8"]),
    ("a text that is none", "candidates", not_utf8, ["part-0.parquet: ", "UTF8"]),
]


@pytest.mark.parametrize(("name", "change", "words"), [pytest.param(n, c, w, id=title) for title, n, c, w in TABLES])
def test_a_table_that_fits_its_checksums_is_still_judged(
    release: Path,
    release_tables: dict[str, pa.Table],
    tmp_path: Path,
    name: str,
    change: Callable[[pa.Table], pa.Table | bytes],
    words: list[str],
) -> None:
    directory = copy_of(release, tmp_path)
    republished(directory, name, change(release_tables[name]))
    line = answer(directory)
    assert [word for word in words if word not in line] == [], line


def test_a_table_that_nobody_knows_is_refused(release: Path, release_tables: dict[str, pa.Table], tmp_path: Path) -> None:
    directory = copy_of(release, tmp_path)
    republished(directory, "moods", release_tables["splits"])
    assert "table 'moods' is unknown to this code" in answer(directory)


def test_every_required_table_is_asked_for(release: Path, tmp_path: Path) -> None:
    for name in REQUIRED_TABLES:
        directory = copy_of(release, tmp_path)
        without(name)(directory)
        assert f"table {name!r} is not listed" in answer(directory)


def test_a_release_made_to_fit_without_damage_is_sound(release: Path, release_tables: dict[str, pa.Table], tmp_path: Path) -> None:
    """Otherwise the tests above would find the tools that damage, not the damage."""
    directory = copy_of(release, tmp_path)
    for name, table in release_tables.items():
        republished(directory, name, table)
    rerendered(directory)
    assert verify_release(directory).release_hash == read_manifest(release).release_hash


# The same bytes in every run: what a Parquet library does with any footer at all is not tested here.
@given(data=st.data())
@settings(max_examples=60, derandomize=True)
def test_any_other_byte_of_a_table_that_fits_its_checksums_is_no_traceback(release: Path, own_copy: Path, data: st.DataObject) -> None:
    """Bytes that hold no value may differ; whatever else differs is one error. Most of the damage is in the footer."""
    name = data.draw(st.sampled_from(["objects", "splits", "targets"]))
    files = {file: (release / file).read_bytes() for file in (MANIFEST, *TEXTS, f"{name}.parquet")}
    content = bytearray(files[f"{name}.parquet"])
    for position in data.draw(st.lists(st.integers(0, min(3000, len(content) - 1)), min_size=1, max_size=4)):
        content[-1 - position] = data.draw(st.integers(0, 255))
    republished(own_copy, name, bytes(content))
    rerendered(own_copy)
    try:
        verify_release(own_copy)
    except ReleaseError as error:
        assert f"{name}.parquet: " in str(error)  # noqa: PT017 (most examples raise, not all)
    finally:
        for file, before in files.items():
            (own_copy / file).write_bytes(before)
