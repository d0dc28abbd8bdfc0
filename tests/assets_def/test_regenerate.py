"""Scenes of a real release made again from their ids, each in a fresh process: no row differs, and one that was changed is named."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from pipelines.codecs import Row, rows_by, rows_by_scene
from pipelines.running.data_root import DataRoot
from pipelines.running.workers import Outcome
from pipelines.stages import STAGES
from splits import regenerate as command
from splits.release import make_light
from splits.release_reader import Release
from tables.schemas import ALL_SCHEMAS, OBJECT_TABLES
from tables.store import table_from_rows
from tests.assets_def.conftest import Built
from tests.assets_def.small import SCENES, SHARD, TIER, small_benchmark
from tests.splits.damage import read_json, republished, write_signed


@pytest.fixture
def whole(built: Built) -> Path:
    return small_benchmark(built.folder).root.release(TIER)


@pytest.fixture
def recipe(built: Built) -> Path:
    return Path(small_benchmark(built.folder).recipe_path)


def test_every_row_of_every_scene_is_the_same(whole: Path, recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "regenerated.json"
    assert command.main([str(whole), "--recipe", str(recipe), "--out", str(out), "--workers", "2"]) == 0
    manifest = Release.open(whole).manifest
    summary = json.loads(out.read_text())
    tables = {name: entry.rows for name, entry in manifest.tables.items() if name not in ("splits", "timings", "attempts")}
    # The small release holds the objects of its two scenes and no others, so that every row of every table is compared once.
    assert summary["rows_by_table"] == tables
    assert {"scenes", "grasps", "candidates", "plans", "scene_points", *OBJECT_TABLES} < tables.keys()
    assert tables["plans"], "at least one candidate must be planned, else nothing is shown"
    assert (summary["scenes"], summary["candidates"], summary["rows"]) == (2, tables["candidates"], sum(tables.values()))
    assert (summary["differences"], summary["scenes_not_made"]) == (0, 0)
    assert summary["release_hash"] == manifest.release_hash
    assert list(summary["by_scene"]) == list(SCENES)
    *lines, total = capsys.readouterr().out.splitlines()
    assert sorted(line.partition(":")[0] for line in lines) == list(SCENES)
    assert all("0 differences" in line for line in lines)
    assert f"2 scenes, {tables['candidates']} candidates, {sum(tables.values()):,} rows" in total
    assert "not compared: splits, timings" in total


def test_a_changed_row_is_named(built: Built, whole: Path, recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A label and a lost row of a light release whose checksums all fit; made again are what the shard holds."""
    light, out = tmp_path / "light", tmp_path / "regenerated.json"
    make_light(whole, light)
    release = Release.open(light)
    made = _rows_of_the_shard(small_benchmark(built.folder).root)
    monkeypatch.setattr(
        command, "run_units", lambda _, units, *__, **___: (Outcome(k, made[u[0]], None, 0.0, 0.0) for k, u in enumerate(units))
    )
    rows = release.table("candidates").to_pylist()
    rows[0]["n_checks"] += 1
    republished(light, "candidates", table_from_rows(ALL_SCHEMAS["candidates"], rows))
    features = release.table("policy_features").to_pylist()
    republished(light, "policy_features", table_from_rows(ALL_SCHEMAS["policy_features"], features[1:]))

    lines: list[str] = []
    assert not command.regenerated(light, out, recipe_path=recipe, log=lines.append)
    summary, name = read_json(out), rows[0]["candidate_id"]
    assert summary["differences"] == 2
    assert "plans" in summary["tables_not_compared"]
    changed, same = sorted(lines[:2])
    assert (
        f"candidates {rows[0]['scene_id']}-{rows[0]['target_id']}-{rows[0]['grasp_id']} has n_checks {rows[0]['n_checks'] - 1}, " in changed
    )
    assert f"policy_features {name} is not in the release" in changed
    assert "0 differences" in same
    assert ": 2 differences" in lines[2]


def _rows_of_the_shard(root: DataRoot) -> dict[str, dict[str, list[Row]]]:
    """By scene and table, as a scene made again would give them."""
    rows = rows_by_scene(root.read_shard(SHARD, [schema for stage in STAGES for schema in stage.outputs]), SCENES)
    objects = {name: rows_by(table, "object_id") for name, table in root.read_objects().items()}
    for own in rows.values():
        own |= {name: by_object[own["scenes"][0]["object_id"]] for name, by_object in objects.items()}
    return rows


def test_a_scene_that_cannot_be_made_is_no_success(
    whole: Path, recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command, "rows_of_scene", _fail)
    assert command.main([str(whole), "--scenes", "1", "--recipe", str(recipe), "--out", str(tmp_path / "out.json")]) == 1
    assert "NOT MADE, ValueError: " in capsys.readouterr().out
    summary = read_json(tmp_path / "out.json")
    assert (summary["scenes"], summary["candidates"], summary["scenes_not_made"]) == (1, 0, 1)


def _fail(scene_id: str, recipe_path: Path, catalogue: Path) -> None:
    raise ValueError(f"{scene_id} fails")


def test_another_recipe_catalogue_or_stage_is_refused_before_any_work(
    whole: Path, recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other, light = tmp_path / "other.toml", tmp_path / "light"
    other.write_text("[grasp_admission]\nquota = 3\n")
    make_light(whole, light)
    assert command.main([str(light), "--recipe", str(other)]) == 1
    assert command.main([str(light), "--recipe", str(recipe), "--scenes", "0"]) == 1
    content = read_json(light / "manifest.json")
    provenance = dict(content["provenance"])
    for key in ("code.execution_labels", "catalogue_hash"):
        write_signed(light, {**content, "provenance": provenance | {key: "0" * 64}})
        assert command.main([str(light), "--recipe", str(recipe)]) == 1
    recipe_line, number_line, code_line, catalogue_line = capsys.readouterr().err.splitlines()
    assert recipe_line.startswith("not regenerated: recipe_hash of the release is ")
    assert number_line == "not regenerated: scenes to make again: 0, must be at least 1"
    assert code_line.startswith("not regenerated: code.execution_labels of the release is 0000")
    assert catalogue_line.startswith("not regenerated: catalogue_hash of the release is 0000")
