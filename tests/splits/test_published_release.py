"""The release that is in the repository: what everyone has after `git clone`, without building anything."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from splits.manifest import DATA_VERSION, read_manifest
from splits.release import verify_release
from splits.release_folder import left_out
from tables.layout import INTERLEAVED
from tables.schemas import HEAVY_TABLES
from tests.test_readme import QUERIES

ROOT = Path(__file__).resolve().parents[2]
FULL = ROOT / "data" / "release" / "full"
MAX_BYTES = 40e6


def test_it_is_sound_and_as_large_as_promised() -> None:
    manifest = verify_release(FULL, may_be_light=True)
    assert (manifest.tier, manifest.version) == ("full", DATA_VERSION)
    assert manifest.tables["scenes"].rows == INTERLEAVED.n_scenes_of("full") == 1235
    assert manifest.tables["candidates"].rows >= 250_000
    assert "-dirty" not in manifest.provenance["git_commit"]


def test_the_repository_holds_its_light_tables_and_no_others() -> None:
    listed = subprocess.run(["git", "ls-files", "data"], cwd=ROOT, capture_output=True, check=True, text=True).stdout.splitlines()
    released = [name for name in listed if name.startswith("data/release/")]
    files = {Path(name).relative_to("data/release/full").as_posix() for name in released}
    heavy = {f"{name}.parquet" for name in HEAVY_TABLES}
    assert files == {"manifest.json", *read_manifest(FULL).files} - heavy
    assert sum((ROOT / name).stat().st_size for name in released) < MAX_BYTES
    assert set(left_out(FULL, read_manifest(FULL))) <= set(HEAVY_TABLES)


def test_three_lines_of_polars_count_every_candidate(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    scope: dict[str, Any] = {}
    exec(compile(QUERIES[0], "README.md", "exec"), scope)
    counted = scope["candidates"].group_by(scope["outcome"].alias("outcome")).len().collect()
    assert counted["len"].sum() == read_manifest(FULL).tables["candidates"].rows
    assert counted["outcome"].null_count() == 0


def test_it_loads_where_people_load_datasets(hub_datasets: Any) -> None:
    found = hub_datasets.load_dataset(str(FULL))
    rows = pl.scan_parquet(FULL / "candidates").group_by("split").len().collect()
    assert {name: part.num_rows for name, part in found.items()} == dict(rows.iter_rows())
    assert isinstance(found["test"][0]["plan_status"], str)
    assert hub_datasets.load_dataset(str(FULL), "grasps")["all_splits"].num_rows == read_manifest(FULL).tables["grasps"].rows


def test_its_croissant_names_every_file() -> None:
    content = json.loads((FULL / "croissant.json").read_text())
    named = {item.get("contentUrl") for item in content["distribution"]}
    assert {f"{name}.parquet" for name in ("grasps", "scenes", "targets", "objects")} <= named
