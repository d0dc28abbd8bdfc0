"""A release folder loads in one line in each library that people load datasets with, whole or light, without a network."""

from __future__ import annotations

import contextlib
import io
import re
from pathlib import Path
from typing import Any

import duckdb
import pandas as pd
import polars as pl
import pyarrow as pa
import pyarrow.dataset as ds
import pyarrow.parquet as pq
import pytest
import yaml

from splits.hub_card import UNDIVIDED, configs, front_matter
from splits.release import make_light, write_release
from tables.schemas import ALL_SCHEMAS, HEAVY_TABLES
from tables.store import table_from_rows
from tests.model.synthetic_release import TOLERANCES
from tests.splits.damage import PROVENANCE

ONE_LINERS = 5


@pytest.fixture(scope="module")
def light(release: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("hub") / "light"
    make_light(release, directory)
    return directory


def front_of(directory: Path) -> dict[str, Any]:
    card = (directory / "README.md").read_text(encoding="utf-8")
    front = yaml.safe_load(card.removeprefix("---\n").split("\n---\n")[0])
    assert isinstance(front, dict)
    return front


def splits_of(tables: dict[str, pa.Table]) -> dict[str, list[str]]:
    """Ids of the candidates of each split, in the order of their key."""
    split_of = {row["scene_id"]: row["split"] for row in tables["splits"].to_pylist()}
    ids: dict[str, list[str]] = {"train": [], "validation": [], "test": []}
    for row in tables["candidates"].to_pylist():
        ids[split_of[row["scene_id"]]].append(row["candidate_id"])
    return ids


@pytest.mark.parametrize("kind", ["whole", "light"])
def test_candidates_load_by_split(hub_datasets: Any, release: Path, light: Path, release_tables: dict[str, pa.Table], kind: str) -> None:
    loaded = hub_datasets.load_dataset(str(release if kind == "whole" else light))
    assert list(loaded) == ["train", "validation", "test"]
    assert {split: rows["candidate_id"][:] for split, rows in loaded.items()} == splits_of(release_tables)
    rows = {row["candidate_id"]: row for row in release_tables["candidates"].to_pylist()}
    assert all(row == rows[row["candidate_id"]] for row in loaded["test"])


@pytest.mark.parametrize("kind", ["whole", "light"])
def test_every_config_loads_with_its_rows_and_strings(
    hub_datasets: Any, release: Path, light: Path, release_tables: dict[str, pa.Table], kind: str
) -> None:
    directory = str(release if kind == "whole" else light)
    names = hub_datasets.get_dataset_config_names(directory)
    assert names[0] == "candidates"
    assert set(names) == release_tables.keys() - HEAVY_TABLES.keys()
    assert "grasps" in names
    for name in names[1:]:
        (rows,) = hub_datasets.load_dataset(directory, name).values()
        assert str(rows.split) == UNDIVIDED
        assert rows.to_list() == release_tables[name].to_pylist(), name
        for column in ALL_SCHEMAS[name].columns:
            if pa.types.is_dictionary(column.dtype):
                assert rows.features[column.name].dtype == "string"


def test_the_front_matter_is_what_the_hub_reads(release: Path, release_tables: dict[str, pa.Table]) -> None:
    front = front_of(release)
    assert (front["license"], front["pretty_name"]) == ("cc-by-4.0", "PlaceBench pilot 0.1.0")
    assert front["size_categories"] == ["n<1K"]
    assert [config["config_name"] for config in front["configs"] if config.get("default")] == ["candidates"]
    paths = [part["path"] for config in front["configs"] for part in config["data_files"]]
    assert all((release / path).is_file() for path in paths)
    assert not any(re.search(r"[*?\[]", path) for path in paths), "a glob could take what is no data"


@pytest.mark.parametrize(
    ("n_rows", "expected"),
    [(1, "n<1K"), (999, "n<1K"), (1_000, "1K<n<10K"), (99_999, "10K<n<100K"), (250_000, "100K<n<1M"), (10**7, "n>10M")],
)
def test_the_size_category_is_that_of_the_candidates(n_rows: int, expected: str) -> None:
    front = front_matter({"candidates": n_rows, "grasps": 5}, {"train": n_rows}, {"tier": "full", "version": "1.0.0"})
    assert yaml.safe_load(front.strip("-"))["size_categories"] == [expected]


def test_heavy_and_empty_tables_are_no_config() -> None:
    assert configs({"candidates": 1, "plans": 2, "timings": 3, "scenes": 4, "obstacles": 0}) == ("candidates", "scenes")


def test_a_release_with_an_empty_split_loads(hub_datasets: Any, release_tables: dict[str, pa.Table], tmp_path: Path) -> None:
    test = [row["scene_id"] for row in release_tables["splits"].to_pylist() if row["split"] == "test"]
    rows = [row | {"split": "train"} if row["scene_id"] in test else row for row in release_tables["splits"].to_pylist()]
    tables = release_tables | {"splits": table_from_rows(ALL_SCHEMAS["splits"], rows)}
    write_release(tables, tmp_path / "release", "pilot", "0.1.0", PROVENANCE, TOLERANCES)
    assert list(hub_datasets.load_dataset(str(tmp_path / "release"))) == ["train", "validation"]
    assert pl.read_parquet(tmp_path / "release" / "candidates").height == release_tables["candidates"].num_rows


def test_every_library_sees_the_same_rows_and_splits(release: Path, light: Path, release_tables: dict[str, pa.Table]) -> None:
    expected = {split: len(ids) for split, ids in splits_of(release_tables).items()}
    folder = light / "candidates"
    by_polars = pl.read_parquet(folder).group_by("split").len()
    by_pandas = pd.read_parquet(folder).groupby("split", observed=True).size()
    by_pyarrow = pq.read_table(folder)["split"].cast(pa.string()).value_counts().to_pylist()
    by_dataset = ds.dataset(folder, partitioning="hive").to_table(columns=["split"])["split"].value_counts().to_pylist()
    by_duckdb = duckdb.sql(f"SELECT split, count(*) FROM '{folder}/*/*.parquet' GROUP BY split").fetchall()
    assert dict(by_polars.iter_rows()) == expected
    assert by_pandas.to_dict() == expected
    assert {str(row["values"]): row["counts"] for row in by_pyarrow} == expected
    assert {str(row["values"]): row["counts"] for row in by_dataset} == expected
    assert dict(by_duckdb) == expected


def test_the_card_s_queries_run_as_printed(light: Path, hub_datasets: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    card = (light / "README.md").read_text(encoding="utf-8")
    queries = re.findall(r"```python\n(.*?)```", card, re.DOTALL)
    monkeypatch.chdir(light)
    scope: dict[str, object] = {}
    for k, query in enumerate(queries):
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(compile(query, f"README.md, query {k}", "exec"), scope)
        assert k >= ONE_LINERS or len(printed.getvalue().splitlines()) >= 3, query
    assert {"pl", "pd", "duckdb", "ds", "load_dataset"} <= scope.keys()
    assert len(queries) == ONE_LINERS + 2
    assert "shape:" in printed.getvalue() or "confident" in queries[-1]
