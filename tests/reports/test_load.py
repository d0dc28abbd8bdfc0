from __future__ import annotations

from pathlib import Path

import polars as pl
import pyarrow as pa
import pytest

from reports.load import Task, candidate_frame, group_frame, load_release
from reports.report import ReportError
from splits.errors import ReleaseError
from splits.release import write_release
from tables.identity import order_key
from tests.model.synthetic_release import TOLERANCES
from tests.splits.damage import PROVENANCE


def test_a_release_is_read_back(release_tables: dict[str, pa.Table], tmp_path: Path) -> None:
    write_release(release_tables, tmp_path, "pilot", "0.1.0", PROVENANCE, TOLERANCES)
    loaded = load_release(tmp_path)
    assert loaded.keys() == release_tables.keys()
    assert all(loaded[name].equals(release_tables[name]) for name in loaded)
    assert load_release(tmp_path, ["scenes"]).keys() == {"scenes"}
    (tmp_path / "grasps.parquet").unlink()
    with pytest.raises(ReleaseError, match=r"grasps\.parquet"):
        load_release(tmp_path)


def test_a_candidate_knows_its_split_target_and_order(release_tables: dict[str, pa.Table]) -> None:
    frame = candidate_frame(release_tables, 5)
    assert frame.height == release_tables["candidates"].num_rows
    split_of = {row["scene_id"]: row["split"] for row in release_tables["splits"].to_pylist()}
    resting_of = {(row["scene_id"], row["target_id"]): row["resting"] for row in release_tables["targets"].to_pylist()}
    for row in frame.sample(50, seed=1).iter_rows(named=True):
        assert row["split"] == split_of[row["scene_id"]]
        assert row["resting"] == resting_of[row["scene_id"], row["target_id"]]
        assert row["success"] == (row["exec_status"] == "success")
        assert row["hash_order"] == order_key(5, "policy_order", row["candidate_id"])


@pytest.mark.parametrize("table", ["splits", "targets", "policy_features"])
def test_a_candidate_without_a_row_elsewhere_is_an_error(release_tables: dict[str, pa.Table], table: str) -> None:
    with pytest.raises(ReportError, match=rf"{table}: full-0000-t0-g.. has no row"):
        candidate_frame(release_tables | {table: release_tables[table].slice(1)}, 42)


def test_groups_are_there_without_candidates(release_tables: dict[str, pa.Table]) -> None:
    empty = release_tables | {"candidates": release_tables["candidates"].slice(0, 0)}
    assert group_frame(empty, Task.JOINT).height == 60
    fixed = group_frame(empty, Task.FIXED)
    assert fixed.height == 480
    assert fixed.filter(pl.col("split") == "test").height == 96
