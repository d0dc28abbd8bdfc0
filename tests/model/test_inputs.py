"""Laws of the five-input contract: what may be read, and that nothing else changes the inputs."""

from __future__ import annotations

import shutil
from dataclasses import fields
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from model.errors import ForbiddenColumnError, InputError
from model.inputs import (
    FIVE_INPUTS,
    FORBIDDEN_COLUMNS,
    KEY_COLUMNS,
    InputReader,
    ReleaseInputs,
    check_columns,
    read_inputs,
    restricted,
    scenes_of_split,
)
from tables.columns import joint_columns
from tables.poses import pose_columns
from tables.schemas import ALL_SCHEMAS, LABEL_COLUMNS, PICK_LIFT, PLANS

_KEYS = {"scene_id", "target_id", "grasp_id", "candidate_id"}


@pytest.mark.parametrize("column", LABEL_COLUMNS)
def test_every_label_column_is_forbidden(small_release: Path, column: str) -> None:
    with pytest.raises(ForbiddenColumnError, match=rf"candidates\.{column}: known only after"):
        InputReader(small_release).columns("candidates", ["candidate_id", column])


@pytest.mark.parametrize("column", [name for name in PICK_LIFT.names if name not in _KEYS])
def test_every_pick_lift_column_is_forbidden(small_release: Path, column: str) -> None:
    with pytest.raises(ForbiddenColumnError, match=rf"grasps\.{column}: known only after"):
        InputReader(small_release).columns("grasps", [column])


@pytest.mark.parametrize(
    ("table", "column"), [*(("plans", n) for n in PLANS.names if n not in _KEYS), ("timings", "core_ms"), ("predictions", "log_p_exec")]
)
def test_plans_times_and_predictions_are_forbidden(table: str, column: str) -> None:
    with pytest.raises(ForbiddenColumnError, match=column):
        check_columns(table, [column])


@pytest.mark.parametrize(
    ("table", "column"),
    [
        ("policy_features", "ik_feasible"),
        ("scenes", "n_obstacles"),
        ("objects", "mass_kg"),
        ("grasps", joint_columns("grasp_q")[0]),
        ("targets", "resting"),
    ],
)
def test_a_column_known_before_planning_but_outside_the_five_inputs_is_refused(table: str, column: str) -> None:
    with pytest.raises(ForbiddenColumnError, match="not one of the five inputs"):
        check_columns(table, [column])


def test_contract_names_columns_that_exist_and_none_that_is_forbidden() -> None:
    assert len(FIVE_INPUTS) == 5
    sources = [(table, names) for tables in FIVE_INPUTS.values() for table, names in tables.items()] + list(KEY_COLUMNS.items())
    for table, names in sources:
        assert set(names) <= set(ALL_SCHEMAS[table].names)
        assert not FORBIDDEN_COLUMNS & set(names)


def test_inputs_do_not_change_when_everything_outside_the_contract_does(small_release: Path, tmp_path: Path) -> None:
    """Scramble every column that the contract does not name, in every table: the inputs stay the same to the bit."""
    copy = Path(shutil.copytree(small_release, tmp_path / "scrambled"))
    allowed = {table: set(names) for table, names in KEY_COLUMNS.items()}
    for sources in FIVE_INPUTS.values():
        for table, names in sources.items():
            allowed[table] |= set(names)
    rng = np.random.default_rng(0)
    n_scrambled = 0
    for path in copy.glob("*.parquet"):
        table = pq.read_table(path)
        for name in table.column_names:
            if name not in allowed.get(path.stem, set()):
                table = table.set_column(table.column_names.index(name), name, table[name].take(pa.array(rng.permutation(table.num_rows))))
                n_scrambled += 1
        pq.write_table(table, path)
    assert n_scrambled > 100
    _assert_same(read_inputs(InputReader(small_release)), read_inputs(InputReader(copy)))


def test_inputs_do_not_depend_on_the_order_of_rows(small_release: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(small_release, tmp_path / "shuffled"))
    rng = np.random.default_rng(1)
    for path in copy.glob("*.parquet"):
        table = pq.read_table(path)
        if path.stem != "scene_points":  # their order is settled in clouds.py, by geometry
            pq.write_table(table.take(pa.array(rng.permutation(table.num_rows))), path)
    _assert_same(read_inputs(InputReader(small_release)), read_inputs(InputReader(copy)))


def test_object_relative_pose_closes_the_triangle_with_the_initial_object(small_release: Path) -> None:
    inputs = read_inputs(InputReader(small_release))
    scene = inputs.group_scene[inputs.candidate_group]
    T_base_object = np.stack([cloud.T_base_object for cloud in inputs.clouds])[scene]
    np.testing.assert_allclose(inputs.T_base_grasp @ inputs.T_grasp_object, T_base_object, atol=1e-12)


def test_candidates_are_joined_to_their_own_grasp_and_target(small_release: Path) -> None:
    inputs = read_inputs(InputReader(small_release))
    candidates = {row["candidate_id"]: row for row in pq.read_table(small_release / "candidates.parquet").to_pylist()}
    targets = {(r["scene_id"], r["target_id"]): r for r in pq.read_table(small_release / "targets.parquet").to_pylist()}
    grasps = {(r["scene_id"], r["grasp_id"]): r for r in pq.read_table(small_release / "grasps.parquet").to_pylist()}
    assert sorted(candidates) == sorted(inputs.candidate_ids)
    for k, candidate_id in enumerate(inputs.candidate_ids):
        row, group = candidates[candidate_id], inputs.candidate_group[k]
        target, grasp = targets[row["scene_id"], row["target_id"]], grasps[row["scene_id"], row["grasp_id"]]
        assert inputs.clouds[inputs.group_scene[group]].scene_id == row["scene_id"]
        assert inputs.T_base_target[group, :3, 3].tolist() == [target[n] for n in pose_columns("target")[:3]]
        assert inputs.T_base_grasp[k, :3, 3].tolist() == [grasp[n] for n in pose_columns("grasp")[:3]]


def test_restricting_equals_reading_less(small_release: Path) -> None:
    train = scenes_of_split(InputReader(small_release), "train")
    inputs = read_inputs(InputReader(small_release))
    groups = np.array([g for g, scene in enumerate(inputs.group_scene) if inputs.clouds[scene].scene_id in train])
    _assert_same(restricted(inputs, groups), read_inputs(InputReader(small_release), train))


def test_a_missing_table_is_named(small_release: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(small_release, tmp_path / "release"))
    (copy / "targets.parquet").unlink()
    with pytest.raises(InputError, match=r"targets\.parquet: missing"):
        read_inputs(InputReader(copy))


def test_a_candidate_without_its_grasp_is_named(small_release: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(small_release, tmp_path / "release"))
    grasps = pq.read_table(copy / "grasps.parquet")
    pq.write_table(grasps.filter(pc.not_equal(grasps["scene_id"].cast(pa.string()), "full-0001")), copy / "grasps.parquet")
    with pytest.raises(InputError, match=r"grasps: no row \('full-0001', \d+\)"):
        read_inputs(InputReader(copy))


def test_an_object_that_no_camera_saw_is_named(small_release: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(small_release, tmp_path / "release"))
    points = pq.read_table(copy / "scene_points.parquet")
    hidden = pc.and_(
        pc.equal(points["scene_id"].cast(pa.string()), "full-0002"), pc.equal(points["point_type"].cast(pa.string()), "object")
    )
    pq.write_table(points.filter(pc.invert(hidden)), copy / "scene_points.parquet")
    with pytest.raises(InputError, match="full-0002 has no object point"):
        read_inputs(InputReader(copy))


def _assert_same(a: ReleaseInputs, b: ReleaseInputs) -> None:
    for field in fields(a):
        mine, theirs = getattr(a, field.name), getattr(b, field.name)
        if field.name == "clouds":
            assert [cloud.scene_id for cloud in mine] == [cloud.scene_id for cloud in theirs]
            for x, y in zip(mine, theirs, strict=True):
                np.testing.assert_array_equal(x.points_m, y.points_m)
                np.testing.assert_array_equal(x.point_types, y.point_types)
                np.testing.assert_array_equal(x.T_base_object, y.T_base_object)
        else:
            np.testing.assert_array_equal(np.asarray(mine), np.asarray(theirs))
