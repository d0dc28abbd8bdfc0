"""What `splits.release diff` says of two releases that differ in known rows, and the version step that it asks for."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pytest

from splits.diff import State, Step, TableDiff, diff_releases
from splits.diff_tables import compare_tables
from splits.diff_text import rendered
from splits.errors import ReleaseError
from splits.manifest import MANIFEST, files_of_table
from splits.release import main, make_light, write_release
from tables import schemas
from tables.columns import TableSchema
from tables.store import table_from_rows
from tests.model.synthetic_release import TOLERANCES
from tests.splits.changed import changed
from tests.splits.damage import PROVENANCE, copy_of, edited, read_json, republished, signed, write_signed


def write(tables: Mapping[str, pa.Table], directory: Path, version: str = "0.1.0", **provenance: str) -> Path:
    write_release(tables, directory, "pilot", version, {**PROVENANCE, **provenance}, TOLERANCES)
    return directory


def of(diffs: tuple[TableDiff, ...], name: str) -> TableDiff:
    (own,) = (own for own in diffs if own.name == name)
    return own


def without_rows(schema: TableSchema, table: pa.Table, column: str, value: str) -> pa.Table:
    return table_from_rows(schema, [row for row in table.to_pylist() if row[column] != value])


def test_a_release_is_equal_to_itself(release: Path, capsys: pytest.CaptureFixture[str]) -> None:
    diff = diff_releases(release, release)
    assert (diff.facts, diff.reasons(), diff.asked) == ((), [], Step.NONE)
    assert {own.state for own in diff.tables} == {State.SAME}
    assert main(["diff", str(release), str(release)]) == 0
    assert "Nothing differs." in capsys.readouterr().out


def test_rows_added_removed_and_changed_are_counted_by_key(release: Path, release_tables: dict[str, pa.Table], tmp_path: Path) -> None:
    """Features of two candidates move by hand: one is gone, one is the other way round."""
    rows = release_tables["policy_features"].to_pylist()
    turned = [row | {"gripper_free": not row["gripper_free"]} if k == 5 else row for k, row in enumerate(rows)]
    a = table_from_rows(schemas.POLICY_FEATURES, rows[:-2])
    b = table_from_rows(schemas.POLICY_FEATURES, turned[1:])
    found = compare_tables("policy_features", a, b)
    assert (found.added, found.removed, found.changed) == (2, 1, 1)
    assert (found.first_added, found.first_removed, found.first_changed) == tuple(rows[k]["candidate_id"] for k in (-2, 0, 5))
    (column,) = found.columns
    was, is_now = (str(value).lower() for value in (rows[5]["gripper_free"], not rows[5]["gripper_free"]))
    assert (column.name, column.rows, column.flips) == ("gripper_free", 1, ((was, is_now, 1),))
    assert compare_tables("policy_features", b, b.take(pc.sort_indices(b["gripper_free"]))).changed == 0, "the order of rows is nothing"


def test_changed_labels_are_named_from_and_to(release: Path, release_tables: dict[str, pa.Table], tmp_path: Path) -> None:
    """One slip becomes a success, which also moves 1 mm: what a relabelled release looks like."""
    candidates = release_tables["candidates"]
    slipped = next(row for row in candidates.to_pylist() if row["exec_status"] == "slipped_in_hand")
    values = {"exec_status": "success", "y_pipe": True, "transport_slip_m": 0.001, "final_x_m": slipped["final_x_m"] + 0.001}
    other = changed(schemas.CANDIDATES, candidates, lambda row: row["candidate_id"] == slipped["candidate_id"], **values)
    b = write(release_tables | {"candidates": other}, tmp_path / "b", "0.1.1")
    diff = diff_releases(release, b)
    own = of(diff.tables, "candidates")
    assert own.content is not None
    assert (own.content.added, own.content.removed, own.content.changed) == (0, 0, 1)
    by_name = {column.name: column for column in own.content.columns}
    assert by_name.keys() == values.keys()
    assert by_name["exec_status"].flips == (("slipped_in_hand", "success", 1),)
    assert by_name["y_pipe"].flips == (("false", "true", 1),)
    assert by_name["transport_slip_m"].largest == pytest.approx(0.002)
    assert by_name["final_x_m"].largest == pytest.approx(0.001)
    assert by_name["final_x_m"].unit == "m"
    assert (diff.asked, diff.least_version, diff.version_fits) == (Step.MAJOR, "0.2.0", False)
    text = rendered(diff)
    assert "asks for a **MAJOR** step; B is 0.1.1 after 0.1.0, **which does not fit: must be at least 0.2.0**" in text
    assert "- MAJOR: candidates: 1 row changed" in text
    assert "| `exec_status` | slipped_in_hand | success | 1 |" in text
    assert "| `transport_slip_m` | 1 | 0.002 m |" in text


def test_a_scene_moved_across_splits_is_major(release: Path, release_tables: dict[str, pa.Table], tmp_path: Path) -> None:
    moved = changed(schemas.SPLITS, release_tables["splits"], lambda row: row["split"] == "train", split="test")
    diff = diff_releases(release, write(release_tables | {"splits": moved}, tmp_path, "0.2.0"))
    assert [reason for step, reason in diff.reasons() if step is Step.MAJOR] == ["splits: 1 row moved across splits"]
    assert (diff.asked, diff.version_fits) == (Step.MAJOR, True), "before 1.0 the second number stands for MAJOR"
    assert "| moved | from | to | rows |\n| --- | --- | --- | ---: |\n| `split` | train | test | 1 |" in rendered(diff)


def test_added_rows_and_tables_are_minor_and_removed_ones_major(release: Path, release_tables: dict[str, pa.Table], tmp_path: Path) -> None:
    first = release_tables["candidates"]["candidate_id"][0].as_py()
    rows = {"candidate_id": first, "perturbation": "fresh_process", "repeat": 0, "plan_status": "no_ik", "exec_status": None}
    rows |= {"final_position_error_m": None, "final_rotation_error_rad": None}
    rows |= {"plan_matches": True, "exec_matches": True, "is_identical": True}
    attempts = table_from_rows(schemas.ATTEMPTS, [rows])
    features = without_rows(schemas.POLICY_FEATURES, release_tables["policy_features"], "candidate_id", first)
    fewer = copy_of(release, tmp_path / "fewer")
    republished(fewer, "policy_features", features)
    more = write(release_tables | {"attempts": attempts}, tmp_path / "more", "0.2.0")
    diff = diff_releases(fewer, more)
    found = [reason for step, reason in diff.reasons() if step is Step.MINOR]
    assert found == ["attempts: new table", "policy_features: 1 row added"]
    assert (diff.asked, diff.least_version, diff.version_fits) == (Step.MINOR, "0.2.0", True)
    back = diff_releases(more, fewer)
    assert [reason for step, reason in back.reasons() if step is Step.MAJOR] == [
        "attempts: table removed",
        "policy_features: 1 row removed",
    ]
    assert not back.version_fits


def test_the_same_values_in_other_bytes_are_a_patch(release: Path, release_tables: dict[str, pa.Table], tmp_path: Path) -> None:
    slower = changed(schemas.TIMINGS, release_tables["timings"], lambda row: True, core_ms=1e6)
    b = write(release_tables | {"timings": slower}, tmp_path, "0.1.1", git_commit="b2" * 20)
    diff = diff_releases(release, b)
    assert [name for name, _, _ in diff.facts] == ["version", "provenance.git_commit"]
    assert diff.reasons() == [(Step.PATCH, "timings: measured anew"), (Step.PATCH, "files beside the tables: written anew")]
    assert diff.version_fits
    assert main(["diff", str(release), str(b)]) == 0, "equal in content"


def test_a_light_release_is_compared_by_its_hashes(release: Path, release_tables: dict[str, pa.Table], tmp_path: Path) -> None:
    light = tmp_path / "light"
    make_light(release, light)
    same = diff_releases(release, light)
    assert same.asked is Step.NONE
    assert of(same.tables, "scene_points").lacking == ("B",)
    assert "| `scene_points` | equal, not in the folder of B |" in rendered(same)
    moved = changed(schemas.SCENE_POINTS, release_tables["scene_points"], lambda row: True, x_m=0.5)
    whole = write(release_tables | {"scene_points": moved}, tmp_path / "whole")
    diff = diff_releases(light, whole)
    own = of(diff.tables, "scene_points")
    assert (own.state, own.lacking, own.content) == (State.UNREAD, ("A",), None)
    assert diff.asked is Step.MINOR
    assert "different by hash, not in the folder of A" in rendered(diff)
    assert main(["diff", str(light), str(whole)]) == 1


def test_columns_of_another_schema_are_named(release: Path, release_tables: dict[str, pa.Table]) -> None:
    splits = release_tables["splits"]
    wider = splits.append_column("split_weather", splits["split"])
    other = splits.set_column(0, "scene_id", splits["scene_id"].cast(pa.string()))
    assert compare_tables("splits", splits, wider).new_columns == ("split_weather",)
    assert compare_tables("splits", wider, splits).lost_columns == ("split_weather",)
    retyped = compare_tables("splits", splits, other)
    assert [text.partition(":")[0] for text in retyped.retyped_columns] == ["scene_id"]
    assert (retyped.added, retyped.removed, retyped.changed) == (0, 0, 0)


def test_lists_are_compared_value_by_value() -> None:
    meshes = [{"object_id": f"can_0{k}", "vertices_m": [0.0, 0.1 * k], "faces": [0, 1, 2]} for k in range(3)]
    other = [meshes[0], meshes[1] | {"vertices_m": [0.0, 0.35]}, meshes[2] | {"vertices_m": [0.0]}]
    a, b = (table_from_rows(schemas.OBJECT_MESHES, rows) for rows in (meshes, other))
    (column,) = compare_tables("object_meshes", a, b).columns
    assert (column.name, column.rows, column.largest) == ("vertices_m", 2, pytest.approx(0.25))


@pytest.mark.parametrize(
    ("before", "after", "fits"),
    [("1.2.3", "2.0.0", True), ("1.2.3", "1.3.0", False), ("0.4.0", "0.5.0", True), ("0.4.0", "1.0.0", True), ("0.4.0", "0.4.1", False)],
)
def test_a_major_step_needs_its_number(release: Path, release_tables: dict[str, pa.Table], before: str, after: str, fits: bool) -> None:
    major = TableDiff("scenes", State.REMOVED, 12, None)
    diff = diff_releases(release, release)
    asked = type(diff)(diff.a, diff.b, before, after, (), (major,), texts_differ=False)
    assert (asked.asked, asked.version_fits) == (Step.MAJOR, fits)


def test_what_cannot_be_compared_is_one_line_and_status_2(release: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for k, (damage, words) in enumerate(
        (
            (shutil.rmtree, "no such folder"),
            (signed("version", to="7.0.0"), "version 7.0.0 is of a newer major version than this code knows"),
            (edited("licence", to="MIT"), "its fields have SHA-256"),
            (signed("tables", to=[]), "lacks what a comparison needs"),
        )
    ):
        directory = copy_of(release, tmp_path / str(k))
        damage(directory)
        assert main(["diff", str(release), str(directory)]) == 2
        out, err = capsys.readouterr()
        assert (out, len(err.splitlines())) == ("", 1)
        assert words in err


def test_a_damaged_table_is_not_compared(release: Path, release_tables: dict[str, pa.Table], tmp_path: Path) -> None:
    moved = changed(schemas.SPLITS, release_tables["splits"], lambda row: row["split"] == "train", split="test")
    directory = write(release_tables | {"splits": moved}, tmp_path)
    path = directory / files_of_table("splits")[0]
    path.write_bytes(path.read_bytes() + b"?")
    with pytest.raises(ReleaseError, match=r"splits\.parquet: SHA-256"):
        diff_releases(release, directory)


def test_a_release_of_an_older_schema_can_be_compared(release: Path, tmp_path: Path) -> None:
    """Manifests before data 0.4.0 state two tolerances as fields of their own; `read_manifest` refuses them."""
    directory = copy_of(release, tmp_path)
    content = read_json(directory / MANIFEST)
    tolerances = content.pop("tolerances")
    write_signed(directory, content | {"schema_version": "1.0.0", "position_tolerance_m": tolerances["position_m"]})
    diff = diff_releases(directory, release)
    assert {name for name, _, _ in diff.facts} == {"schema_version", *(f"tolerances.{name}" for name in tolerances)}
    assert diff.reasons() == [(Step.MAJOR, "tolerances: labels are judged by others")]
