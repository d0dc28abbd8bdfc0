"""Damaged releases that training and scoring refuse: one line that names the place, exit code 1, nothing left behind."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from model.errors import InputError
from model.inputs import FIVE_INPUTS, KEY_COLUMNS, InputReader, read_inputs
from tables.poses import pose_columns
from tables.schemas import ALL_SCHEMAS
from tests.model.commands import Commands
from tests.model.damage import cut, edit_json, rewrite, set_values, write_manifest

NAN, INF = float("nan"), float("inf")
_POSES = {"scenes": "object", "targets": "target", "grasps": "grasp"}
_REAL_COLUMNS = [
    *((table, column) for table, prefix in _POSES.items() for column in pose_columns(prefix)),
    *(("scene_points", column) for column in ("x_m", "y_m", "z_m")),
]


@pytest.mark.parametrize(("table", "column"), _REAL_COLUMNS)
def test_a_number_that_is_not_finite_is_named_by_row_and_column(release: Path, table: str, column: str) -> None:
    for value in (NAN, INF, -INF):
        set_values(release, table, 3, {column: value})
        row = pq.read_table(release / f"{table}.parquet").slice(3, 1).to_pylist()[0]
        named = ", ".join(f"{key} {row[key]}" for key in ALL_SCHEMAS[table].key)
        with pytest.raises(InputError, match=rf"{table}\.parquet: {named}: {column} is {value}, must be finite$"):
            read_inputs(InputReader(release))


@pytest.mark.parametrize(
    ("table", "values", "problem"),
    [
        ("targets", {"target_qx": NAN}, "scene_id full-0000, target_id 3: target_qx is nan, must be finite"),
        ("grasps", {"grasp_z_m": -INF}, "scene_id full-0000, grasp_id 3: grasp_z_m is -inf, must be finite"),
        ("scenes", {"object_x_m": INF}, "scene_id full-0003: object_x_m is inf, must be finite"),
        ("scene_points", {"y_m": NAN}, "scene_id full-0000, point 3: y_m is nan, must be finite"),
        ("targets", {"target_x_m": 1e300}, "target_id 3: target_x_m is 1e+300 m, must be within 1000 m of 0"),
        ("scene_points", {"z_m": -1000.5}, "point 3: z_m is -1000.5 m, must be within 1000 m of 0"),
        ("grasps", {"grasp_x_m": None}, "grasp_id 3: grasp_x_m is null, must have a value"),
        ("scene_points", {"scene_id": None}, "scene_id None, point 3: scene_id is null, must have a value"),
        ("scene_points", {"point_type": "ghost"}, "point 3: point_type is 'ghost', must be one of"),
        ("targets", {"target_id": 0}, "scene_id full-0000, target_id 0 has 2 rows or more, must have 1"),
        ("candidates", {"target_id": 7}, "candidates: "),
    ],
)
def test_an_impossible_value_is_named_by_both(commands: Commands, table: str, values: dict[str, Any], problem: str) -> None:
    if table == "candidates":  # a second row of one candidate
        rows = pq.read_table(commands.release / "candidates.parquet")
        rewrite(commands.release / "candidates.parquet", pa.concat_tables([rows, rows.slice(3, 1)]))
        problem = "has 2 rows or more, must have 1"
    else:
        set_values(commands.release, table, 3, values)
    said = commands.both()
    assert f"{table}.parquet: " in said
    assert said.endswith(problem) or f"{problem} [" in said


@pytest.mark.parametrize(("table", "prefix"), _POSES.items())
@pytest.mark.parametrize(("length", "shown"), [(0.0, "0"), (1e-7, "1e-07"), (1e200, "inf")])
def test_a_quaternion_without_direction_is_named(commands: Commands, table: str, prefix: str, length: float, shown: str) -> None:
    columns = pose_columns(prefix)[3:]
    set_values(commands.release, table, 2, {column: length if column == columns[0] else 0.0 for column in columns})
    said = commands.both()
    assert f"{table}.parquet: scene_id full-000" in said
    assert said.endswith(f"quaternion {prefix}_qx ... {prefix}_qw has length {shown}, must be finite and at least 1e-06")


@pytest.mark.parametrize(
    ("column", "value", "problem"),
    [
        ("y_plan", None, "y_plan is null, must have a value"),
        ("y_pipe", None, "y_plan is true and y_pipe null, must have both labels"),
    ],
)
def test_an_impossible_label_is_named_by_training(commands: Commands, column: str, value: None, problem: str) -> None:
    rows = pq.read_table(commands.release / "candidates.parquet")
    planned = rows["y_plan"].to_pylist().index(True)
    set_values(commands.release, "candidates", planned, {column: value})
    assert f"candidates.parquet: candidate_id {rows['candidate_id'][planned]}: {problem}" in commands.training()


def test_a_split_that_is_none_is_named_by_training(commands: Commands) -> None:
    set_values(commands.release, "splits", 1, {"split": "holdout"})
    assert "splits.parquet: scene_id full-0001: split is 'holdout', must be one of ['train', 'validation', 'test']" in commands.training()


def test_a_column_of_another_type_is_named(commands: Commands) -> None:
    path = commands.release / "grasps.parquet"
    rows = pq.read_table(path)
    rewrite(path, rows.set_column(rows.column_names.index("grasp_qw"), "grasp_qw", rows["grasp_qw"].cast(pa.string())))
    assert "grasps.parquet: column grasp_qw has type string, must be double" in commands.both()


def test_columns_of_another_width_are_read_as_they_are(small_release: Path, release: Path) -> None:
    """Other writers choose 64-bit numbers, large strings and no dictionaries; the inputs are the same to the bit."""
    for table in KEY_COLUMNS:
        rows = pq.read_table(release / f"{table}.parquet")
        wider = {pa.int32(): pa.int64(), pa.float32(): pa.float64(), pa.dictionary(pa.int16(), pa.string()): pa.large_string()}
        fields = [field.with_type(wider.get(field.type, field.type)) for field in rows.schema]
        plain = [rows[field.name].cast(pa.string()) if pa.types.is_dictionary(field.type) else rows[field.name] for field in rows.schema]
        rewrite(release / f"{table}.parquet", pa.table([c.cast(f.type) for c, f in zip(plain, fields)], schema=pa.schema(fields)))
    mine, theirs = read_inputs(InputReader(release)), read_inputs(InputReader(small_release))
    assert mine.candidate_ids == theirs.candidate_ids
    assert mine.T_grasp_object.tobytes() == theirs.T_grasp_object.tobytes()
    assert all(a.points_m.tobytes() == b.points_m.tobytes() for a, b in zip(mine.clouds, theirs.clouds, strict=True))


@pytest.mark.parametrize("table", ["candidates", "scene_points"])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.999])
def test_a_truncated_table_is_named(commands: Commands, table: str, share: float) -> None:
    cut(commands.release / f"{table}.parquet", share)
    assert re.search(rf"{table}\.parquet: cannot be read as a table \(.+\)$", commands.both())


def test_a_table_with_bad_bytes_inside_is_named(commands: Commands) -> None:
    """The footer is whole, a page is not."""
    path = commands.release / "scene_points.parquet"
    content = bytearray(path.read_bytes())
    content[200:264] = bytes(64)
    path.write_bytes(content)
    assert re.search(r"scene_points\.parquet: cannot be read as a table \(.+\)$", commands.both())


def test_an_id_that_is_no_text_is_named(commands: Commands) -> None:
    """Bytes that are not UTF-8 pass through Parquet."""
    path = commands.release / "candidates.parquet"
    rows = pq.read_table(path)
    ids = [candidate_id.encode() for candidate_id in rows["candidate_id"].to_pylist()]
    broken = pa.array([b"\xff\xfe", *ids[1:]]).cast(pa.string(), safe=False)
    rewrite(path, rows.set_column(rows.column_names.index("candidate_id"), "candidate_id", broken))
    assert re.search(r"candidates\.parquet: cannot be read as a table \(.*UTF8.*\)$", commands.both())


@pytest.mark.parametrize("table", sorted(KEY_COLUMNS))
def test_a_missing_table_is_named(commands: Commands, table: str) -> None:
    (commands.release / f"{table}.parquet").unlink()
    said = commands.training() if table == "splits" else commands.both()
    assert said.endswith(f"{table}.parquet: missing, must be a Parquet table of the release")


def test_a_table_that_is_a_folder_is_named(commands: Commands) -> None:
    (commands.release / "targets.parquet").unlink()
    (commands.release / "targets.parquet").mkdir()
    assert commands.both().endswith("targets.parquet: not a file, must be a Parquet table of the release")


def test_a_missing_release_is_named(commands: Commands, tmp_path: Path) -> None:
    commands.release = tmp_path / "nowhere"
    assert commands.both() == f"error: {tmp_path}/nowhere: missing, must be the folder of a release"
    (tmp_path / "nowhere").write_text("a file")
    assert commands.both() == f"error: {tmp_path}/nowhere: not a folder, must be the folder of a release"


@pytest.mark.parametrize("table", sorted({table for sources in FIVE_INPUTS.values() for table in sources} | {"candidates"}))
def test_a_table_that_its_sidecar_contradicts_is_named(commands: Commands, table: str) -> None:
    edit_json(commands.release / f"{table}.parquet.json", lambda sidecar: sidecar.update(sha256="0" * 64))
    assert re.search(rf"{table}\.parquet: SHA-256 \w+, {table}\.parquet\.json says 000000000000; the table was changed", commands.both())


def test_a_table_that_the_manifest_contradicts_is_named(commands: Commands) -> None:
    write_manifest(commands.release)
    path = commands.release / "targets.parquet"
    rows = pq.read_table(path)
    rewrite(path, rows.take(list(range(len(rows)))[::-1]))
    assert re.search(r"targets\.parquet: SHA-256 \w+, manifest\.json says \w+; the table was changed", commands.both())


def test_a_manifest_that_does_not_list_a_table_is_named(commands: Commands) -> None:
    write_manifest(commands.release)
    edit_json(commands.release / "manifest.json", lambda manifest: manifest["files"].pop("grasps.parquet"))
    assert commands.both().endswith("manifest.json: does not list table grasps, which the ranker reads")


@pytest.mark.parametrize("name", ["manifest.json", "targets.parquet.json"])
def test_a_broken_manifest_or_sidecar_is_named(commands: Commands, name: str) -> None:
    write_manifest(commands.release)
    cut(commands.release / name, 0.5)
    assert f"{name}: cannot be read as JSON" in commands.both()
    (commands.release / name).write_text("[]")
    assert f"{name}: holds a JSON list, must be an object" in commands.both()


@pytest.mark.parametrize("split", ["train", "validation"])
def test_a_split_without_candidates_is_named_by_training(commands: Commands, split: str) -> None:
    """Its scenes are there, but no grasp of theirs was lifted."""
    splits = dict(zip(*(pq.read_table(commands.release / "splits.parquet")[name].to_pylist() for name in ("scene_id", "split"))))
    rows = pq.read_table(commands.release / "candidates.parquet")
    rewrite(
        commands.release / "candidates.parquet", rows.filter(pa.array([splits[scene] != split for scene in rows["scene_id"].to_pylist()]))
    )
    assert commands.training().endswith(f"release: the {split} split has 0 candidates, must have at least 1")


def test_a_release_without_candidates_is_named(commands: Commands) -> None:
    rewrite(commands.release / "candidates.parquet", pq.read_table(commands.release / "candidates.parquet").slice(0, 0))
    assert commands.training().endswith("release: the train split has 0 candidates, must have at least 1")
    assert commands.scoring().endswith("candidates.parquet: no candidates to score, must have at least 1")


@pytest.mark.parametrize("command", ["training", "scoring"])
def test_the_process_itself_ends_with_one_line_and_code_1(release: Path, checkpoint: Path, tmp_path: Path, command: str) -> None:
    set_values(release, "targets", 3, {"target_qx": NAN})
    more = ["--setting", "light"] if command == "training" else ["--checkpoint", str(checkpoint)]
    arguments = ["-m", f"model.{command}", "--release", str(release), "--out", str(tmp_path / "out"), *more]
    ended = subprocess.run([sys.executable, *arguments], capture_output=True, text=True, check=False, cwd=Path(__file__).parents[2])
    assert ended.returncode == 1
    assert re.fullmatch(r"error: \S+targets\.parquet: scene_id full-0000, target_id 3: target_qx is nan, must be finite\n", ended.stderr)
    assert not (tmp_path / "out").exists()
