"""The command that makes `test_replicates`: published once, kept while nothing changed, refused for a release of another recipe."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pytest

from pipelines.proofs.replicates import SceneWork
from pipelines.recipe import load_recipe
from splits import replicates
from splits.errors import ReleaseError
from splits.release import write_release
from splits.release_reader import Release
from splits.replicates import default_path, main, make_replicates
from tables.schemas import TEST_REPLICATES
from tables.store import read_sidecar, read_table
from tests.model.synthetic_release import RELEASE_SCHEMAS, TOLERANCES, write_synthetic_release
from tests.reports.replicates import replicates_of
from tests.splits.damage import PROVENANCE


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> dict[str, pa.Table]:
    loose = write_synthetic_release(tmp_path_factory.mktemp("loose"), n_scenes=10, seed=1, n_points=4)
    return {schema.name: read_table(schema, loose / f"{schema.name}.parquet") for schema in RELEASE_SCHEMAS}


def release_of(tables: dict[str, pa.Table], folder: Path, recipe_hash: str) -> Release:
    write_release(tables, folder, "full", "0.1.0", {**PROVENANCE, "recipe_hash": recipe_hash}, TOLERANCES)
    return Release.open(folder)


def test_the_table_is_made_once_of_planned_test_candidates(
    tables: dict[str, pa.Table], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    release = release_of(tables, tmp_path / "data" / "release" / "full", load_recipe("full").hash_of())
    asked: list[list[str]] = []

    def works(values: object, candidate_ids: list[str], recipe: object, n: int) -> list[SceneWork]:
        asked.append(candidate_ids)
        return []

    def made(works: object, kept: Path, *rest: object) -> pa.Table:
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_text("")
        return replicates_of(tables)

    monkeypatch.setattr(replicates, "works_of", works)
    monkeypatch.setattr(replicates, "replicate_table", made)
    path = default_path(release.directory, "full")
    assert path == (tmp_path / "data" / "tiers" / "full" / "test_replicates.parquet").resolve()
    sidecar = make_replicates(release, path, log=lambda text: None)
    assert read_sidecar(path) == sidecar
    assert sidecar.made_from["release"] == release.manifest.release_hash
    assert read_table(TEST_REPLICATES, path, of="full", verify=True).equals(replicates_of(tables))
    in_test = {row["scene_id"] for row in tables["splits"].to_pylist() if row["split"] == "test"}
    planned = [row["candidate_id"] for row in tables["candidates"].to_pylist() if row["scene_id"] in in_test and row["y_plan"]]
    assert asked == [planned]
    assert make_replicates(release, path, log=lambda text: None) == sidecar
    assert len(asked) == 1, "nothing changed, so nothing is made"
    make_replicates(release, path, n_replicates=3, log=lambda text: None)
    assert len(asked) == 2
    assert not list(path.parent.glob(".*.jsonl"))


def test_a_release_of_another_recipe_is_one_line(tables: dict[str, pa.Table], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    release = release_of(tables, tmp_path / "full", "0" * 64)
    with pytest.raises(ReleaseError, match="of recipe 000000000000, must be this code's"):
        make_replicates(release, tmp_path / "out.parquet")
    assert main([str(release.directory), "--out", str(tmp_path / "out.parquet")]) == 1
    said = capsys.readouterr().err
    assert said.startswith(f"error: {release.directory}: of recipe 000000000000")
    assert said.count("\n") == 1
    assert main([str(tmp_path / "nothing")]) == 1
    assert not (tmp_path / "out.parquet").exists()
