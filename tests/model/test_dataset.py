"""Laws of the torch Dataset: it holds what the tables hold, group by group, of whole and of light releases."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest
import torch
from torch.utils.data import DataLoader

from model.dataset import PlacementDataset
from model.errors import InputError, SettingsError
from model.inputs import TYPE_NAMES
from splits.release import make_light, write_release
from tables.poses import matrix_of, pose_columns
from tables.store import read_table
from tests.model.damage import set_values
from tests.model.synthetic_release import RELEASE_SCHEMAS, TOLERANCES
from tests.splits.damage import PROVENANCE


@pytest.fixture(scope="module")
def whole(small_release: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dataset") / "whole"
    tables = {schema.name: read_table(schema, small_release / f"{schema.name}.parquet") for schema in RELEASE_SCHEMAS}
    write_release(tables, folder, "pilot", "0.1.0", PROVENANCE, TOLERANCES)
    return folder


def test_an_item_holds_what_the_tables_hold(small_release: Path) -> None:
    dataset = PlacementDataset(small_release)
    candidates = pl.read_parquet(small_release / "candidates.parquet").sort("scene_id", "target_id", "grasp_id")
    assert list(dataset.candidate_ids) == candidates["candidate_id"].to_list()
    tables = {name: pl.read_parquet(small_release / f"{name}.parquet") for name in ("scenes", "targets", "grasps", "scene_points")}
    for k in (0, 40, len(dataset) - 1):
        row, item = candidates.row(k, named=True), dataset[k]
        by_grasp, by_target = ("scene_id", "grasp_id"), ("scene_id", "target_id")
        named = {"object": ("scenes", ("scene_id",)), "target": ("targets", by_target), "grasp": ("grasps", by_grasp)}
        T = {}
        for prefix, (table, key) in named.items():
            (found,) = tables[table].filter(*(pl.col(name) == row[name] for name in key)).select(pose_columns(prefix)).rows()
            T[prefix] = matrix_of(np.array(found))
            np.testing.assert_allclose(item[f"T_base_{prefix}"], T[prefix], atol=1e-6)
        np.testing.assert_allclose(item["T_grasp_object"], np.linalg.inv(T["grasp"]) @ T["object"], atol=1e-6)
        np.testing.assert_allclose(item["T_base_place"], T["target"] @ np.linalg.inv(T["object"]) @ T["grasp"], atol=1e-6)
        assert bool(item["y_plan"]) is row["y_plan"]
        assert bool(item["success"]) is (row["y_plan"] and row["y_pipe"])
        points = tables["scene_points"].filter(pl.col("scene_id") == row["scene_id"])
        np.testing.assert_array_equal(item["points_m"], points.select("x_m", "y_m", "z_m").to_numpy())
        assert [TYPE_NAMES[number] for number in item["point_types"]] == points["point_type"].to_list()
        assert (dataset.scene_ids[int(item["scene"])], int(item["candidate"])) == (row["scene_id"], k)


@pytest.mark.parametrize(("task", "key"), [("joint", ["scene_id"]), ("fixed", ["scene_id", "target_id"])])
def test_a_batch_of_a_group_is_the_group(small_release: Path, task: str, key: list[str]) -> None:
    dataset = PlacementDataset(small_release, "train")
    rows = pl.read_parquet(small_release / "candidates.parquet").with_columns(pl.col("scene_id").cast(pl.String))
    expected = {frozenset(ids) for ids in rows.filter(pl.col("scene_id") < "full-0003").group_by(key).agg("candidate_id")["candidate_id"]}
    batches = list(DataLoader(dataset, batch_sampler=dataset.groups(task)))
    assert {frozenset(dataset.candidate_ids[k] for k in batch["candidate"]) for batch in batches} == expected
    for batch in batches:
        assert len(batch["scene" if task == "joint" else "group"].unique()) == 1
        assert batch["points_m"].shape[0] == len(batch["candidate"])


def test_a_light_release_has_everything_but_points(whole: Path, tmp_path: Path) -> None:
    make_light(whole, tmp_path / "light")
    light = tmp_path / "light"
    of_whole, of_light = PlacementDataset(whole, "train"), PlacementDataset(light, "train", has_points=False)
    assert (of_whole.has_points, of_light.has_points) == (True, False)
    with pytest.raises(InputError, match=rf"scene_points\.parquet: missing, .* `make points RELEASE={light}` makes it again") as refused:
        PlacementDataset(light, "train")
    assert "\n" not in str(refused.value)
    assert of_whole.candidate_ids == of_light.candidate_ids
    for ours, theirs in zip(of_light, of_whole, strict=True):
        assert set(theirs) - set(ours) == {"points_m", "point_types"}
        assert all(torch.equal(values, theirs[name]) for name, values in ours.items())


def test_what_cannot_be_is_refused(small_release: Path, release: Path) -> None:
    with pytest.raises(InputError, match="split 'exam', must be one of"):
        PlacementDataset(small_release, "exam")
    with pytest.raises(SettingsError, match="split 'shape', must be one of"):
        PlacementDataset(small_release, "train", scheme="shape")
    with pytest.raises(InputError, match="task 'both', must be joint or fixed"):
        PlacementDataset(small_release).groups("both")
    with pytest.raises(IndexError, match=r"candidate 100000, must be in \[0, "):
        PlacementDataset(small_release)[100000]
    with pytest.raises(InputError, match="the folder of a release"):
        PlacementDataset(release / "elsewhere")
    set_values(release, "targets", 0, {"target_x_m": float("nan")})
    with pytest.raises(InputError, match="target_x_m is nan, must be finite"):
        PlacementDataset(release)
