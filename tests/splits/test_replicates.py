"""The command that makes `test_replicates`: published once, kept while nothing changed, refused for a release of another recipe."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pytest

from pipelines.recipe import load_recipe
from pipelines.stages import STAGE
from splits import replicates
from splits.errors import ReleaseError
from splits.release import write_release
from splits.release_reader import Release
from splits.replicates import default_path, main, make_replicates
from tables.identity import parse_candidate_id
from tables.schemas import TEST_REPLICATES
from tables.sidecar import Sidecar
from tables.store import read_sidecar, read_table, table_from_rows
from tests.model.synthetic_release import RELEASE_SCHEMAS, TOLERANCES, write_synthetic_release
from tests.reports.replicates import replicates_of
from tests.splits.damage import PROVENANCE


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> dict[str, pa.Table]:
    loose = write_synthetic_release(tmp_path_factory.mktemp("loose"), n_scenes=10, seed=1, n_points=4)
    return {schema.name: read_table(schema, loose / f"{schema.name}.parquet") for schema in RELEASE_SCHEMAS}


def release_of(tables: dict[str, pa.Table], folder: Path, recipe_hash: str) -> Release:
    write_release(
        tables,
        folder,
        "full",
        "0.1.0",
        {**PROVENANCE, "recipe_hash": recipe_hash, "code.execution_labels": STAGE["execution_labels"].code_version},
        TOLERANCES,
    )
    return Release.open(folder)


@pytest.fixture
def asked(tables: dict[str, pa.Table], monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """Candidates that were executed, a list a run; their rows are made up instead."""
    asked: list[list[str]] = []

    def works(values: object, candidate_ids: list[str], recipe: object, n: int) -> list[str]:
        asked.append(candidate_ids)
        return candidate_ids

    def made(candidate_ids: list[str], kept: Path, *rest: object) -> pa.Table:
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_text("")
        every = replicates_of(tables).to_pylist()
        return table_from_rows(TEST_REPLICATES, [row for row in every if row["candidate_id"] in set(candidate_ids)])

    monkeypatch.setattr(replicates, "works_of", works)
    monkeypatch.setattr(replicates, "replicate_table", made)
    return asked


def make(release: Release, path: Path, **chosen: int) -> Sidecar:
    return make_replicates(release, path, log=lambda text: None, **chosen)


def test_the_table_is_made_once_of_planned_test_candidates(tables: dict[str, pa.Table], asked: list[list[str]], tmp_path: Path) -> None:
    release = release_of(tables, tmp_path / "data" / "release" / "full", load_recipe("full").hash_of())
    path = default_path(release.directory, "full")
    assert path == (tmp_path / "data" / "tiers" / "full" / "test_replicates.parquet").resolve()
    sidecar = make(release, path)
    assert read_sidecar(path) == sidecar
    assert sidecar.made_from["release"] == release.manifest.release_hash
    assert read_table(TEST_REPLICATES, path, of="full", verify=True).equals(replicates_of(tables))
    in_test = {row["scene_id"] for row in tables["splits"].to_pylist() if row["split"] == "test"}
    planned = [row["candidate_id"] for row in tables["candidates"].to_pylist() if row["scene_id"] in in_test and row["y_plan"]]
    assert asked == [planned]
    assert make(release, path) == sidecar
    assert len(asked) == 1, "nothing changed, so nothing is made"
    make(release, path, n_replicates=3)
    assert asked[1:] == [planned]
    assert not list(path.parent.glob(".*.jsonl"))


def test_scenes_are_added_to_those_that_are_there(tables: dict[str, pa.Table], asked: list[list[str]], tmp_path: Path) -> None:
    release = release_of(tables, tmp_path / "release" / "full", load_recipe("full").hash_of())
    some = make(release, tmp_path / "some.parquet", n_scenes=1)
    scenes = {parse_candidate_id(name).scene_id for name in asked[0]}
    assert len(scenes) == 1
    assert some.made_from["parameter.scenes"] == "1"
    assert make(release, tmp_path / "some.parquet", n_scenes=1) == some
    whole = make(release, tmp_path / "some.parquet")
    assert len(asked) == 2, "the one scene is not executed again"
    assert not scenes & {parse_candidate_id(name).scene_id for name in asked[1]}
    assert make(release, tmp_path / "some.parquet", n_scenes=1) == whole, "more than was asked for stays"
    at_once = make(release, tmp_path / "at_once.parquet")
    assert (whole.content_hash, whole.made_from) == (at_once.content_hash, at_once.made_from)


def test_a_release_of_another_recipe_is_one_line(tables: dict[str, pa.Table], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    release = release_of(tables, tmp_path / "full", "0" * 64)
    with pytest.raises(ReleaseError, match="recipe_hash of the release is 000000000000, must be that of this code"):
        make_replicates(release, tmp_path / "out.parquet")
    assert main([str(release.directory), "--out", str(tmp_path / "out.parquet")]) == 1
    said = capsys.readouterr().err
    assert said.startswith("error: recipe_hash of the release is 000000000000, must be ")
    assert said.count("\n") == 1
    assert main([str(tmp_path / "nothing")]) == 1
    assert not (tmp_path / "out.parquet").exists()
