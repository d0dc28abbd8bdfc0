"""A release is opened with its checks, read once, and gives back the tables that were written."""

from __future__ import annotations

import shutil
from pathlib import Path

import polars as pl
import pyarrow as pa
import pytest

from splits.errors import ReleaseError
from splits.manifest import CARD, MANIFEST
from splits.release_reader import Release
from tables.identity import IdentityError
from tables.vocabulary import SplitScheme
from tests.splits.damage import Damage, copy_of, edited, republished, rewritten, signed


@pytest.mark.parametrize("verify", [False, True])
def test_tables_are_those_that_were_written(release: Path, release_tables: dict[str, pa.Table], verify: bool) -> None:
    opened = Release.open(release, verify=verify)
    assert (opened.manifest.tier, opened.manifest.version, opened.directory) == ("pilot", "0.1.0", release)
    tables = opened.tables()
    assert tables.keys() == release_tables.keys()
    assert all(tables[name].equals(release_tables[name]) for name in tables)
    assert list(opened.tables("targets", "scenes")) == ["targets", "scenes"]
    assert opened.table("grasps").equals(release_tables["grasps"])
    assert Release.open(str(release)).directory == release


def test_each_table_is_read_once(release: Path, tmp_path: Path) -> None:
    directory = copy_of(release, tmp_path)
    opened = Release.open(directory)
    candidates, table = opened.candidates, opened.table("candidates")
    shutil.rmtree(directory)
    assert opened.candidates is candidates
    assert opened.table("candidates") is table
    assert opened.tables("candidates", "splits")["candidates"] is table
    with pytest.raises(ReleaseError, match=r"targets\.parquet"):
        opened.table("targets")


def test_candidates_are_strings_with_their_split(release: Path, release_tables: dict[str, pa.Table]) -> None:
    frame = Release.open(release).candidates
    rows = release_tables["candidates"].to_pylist()
    splits_of = {row["scene_id"]: row for row in release_tables["splits"].to_pylist()}
    assert frame.columns == [*release_tables["candidates"].column_names, *(scheme.column for scheme in SplitScheme)]
    assert frame.to_dicts() == [row | splits_of[row["scene_id"]] for row in rows]
    assert pl.Categorical not in frame.dtypes
    assert frame.schema["plan_status"] == frame.schema["split"] == frame.schema["split_object"] == pl.String


# (name, damage, what the error says, whether the sizes alone show it)
DAMAGES: list[tuple[str, Damage, str, bool]] = [
    ("no folder", shutil.rmtree, "no such folder", True),
    ("no manifest", lambda d: (d / MANIFEST).unlink(), "no complete release", True),
    ("an edited manifest", edited("licence", to="MIT"), r"manifest\.json: its fields have SHA-256", True),
    ("newer data", signed("version", to="2.0.0"), "version 2.0.0 is of a newer major version", True),
    ("a newer schema", signed("schema_version", to="3.0.0"), "schema_version 3.0.0 is of a newer major version", True),
    ("no table", lambda d: (d / "grasps.parquet").unlink(), r"grasps\.parquet: missing", True),
    ("no card", lambda d: (d / CARD).unlink(), r"README\.md: missing", True),
    ("a truncated table", rewritten("grasps.parquet", lambda b: b[:-1]), r"grasps\.parquet: .* bytes, manifest says", True),
    ("another byte", rewritten("grasps.parquet", lambda b: b[:100] + b"?" + b[101:]), r"grasps\.parquet: SHA-256", False),
    ("another word", rewritten(CARD, lambda b: b.replace(b"train", b"brain")), r"README\.md: SHA-256", False),
]


@pytest.mark.parametrize(("damage", "message", "is_cheap"), [pytest.param(d, m, c, id=name) for name, d, m, c in DAMAGES])
def test_a_damaged_folder_is_not_opened(release: Path, tmp_path: Path, damage: Damage, message: str, is_cheap: bool) -> None:
    directory = copy_of(release, tmp_path)
    damage(directory)
    with pytest.raises(ReleaseError, match=message):
        Release.open(directory, verify=True)
    if is_cheap:
        with pytest.raises(ReleaseError, match=message):
            Release.open(directory)
    else:
        assert Release.open(directory).manifest.tier == "pilot", "hashes are compared on request only"


def test_other_files_in_the_folder_do_not_matter(release: Path, tmp_path: Path) -> None:
    directory = copy_of(release, tmp_path)
    (directory / "notes.txt").write_text("mine")
    assert Release.open(directory, verify=True).candidates.height


def test_a_table_that_is_not_there_is_named(release: Path) -> None:
    with pytest.raises(ReleaseError, match=r"table 'plans' is not in this release, must be one of \['candidates'"):
        Release.open(release).tables("scenes", "plans")


def test_a_table_that_is_not_what_the_manifest_says_is_not_read(release: Path, release_tables: dict[str, pa.Table], tmp_path: Path) -> None:
    directory = copy_of(release, tmp_path)
    signed("tables", "targets", "rows", to=1)(directory)
    republished(directory, "scenes", release_tables["scenes"].drop_columns(["n_obstacles"]))
    opened = Release.open(directory)
    with pytest.raises(ReleaseError, match=r"targets\.parquet: 96 rows, manifest says 1"):
        opened.table("targets")
    with pytest.raises(ReleaseError, match=r"scenes\.parquet: column n_obstacles is missing"):
        opened.table("scenes")


def test_a_value_outside_the_schema_is_found_on_request(release: Path, release_tables: dict[str, pa.Table], tmp_path: Path) -> None:
    directory = copy_of(release, tmp_path)
    splits = release_tables["splits"]
    twice = pa.concat_tables([splits, splits.slice(0, 1)])
    republished(directory, "splits", twice)
    with pytest.raises(ReleaseError, match=r"splits\.parquet: splits: 1 repeated keys"):
        Release.open(directory, verify=True).table("splits")
    with pytest.raises(ReleaseError, match=r"every scene of candidates must be in 1 split; .* rows too many"):
        _ = Release.open(directory).candidates
    republished(directory, "splits", splits.slice(1))
    with pytest.raises(ReleaseError, match=r"every scene of candidates must be in 1 split; scene full-0000 is in none"):
        _ = Release.open(directory).candidates


def test_candidates_and_scenes_are_values_by_id(release: Path, release_tables: dict[str, pa.Table]) -> None:
    opened = Release.open(release)
    row = next(row for row in release_tables["candidates"].to_pylist() if row["target_id"] == 3)
    candidate = opened.candidate(row["candidate_id"])
    assert candidate.candidate_id == row["candidate_id"]
    assert candidate.scene is opened.scene(row["scene_id"])
    target = next(t for t in release_tables["targets"].to_pylist() if (t["scene_id"], t["target_id"]) == (row["scene_id"], 3))
    assert candidate.target.T_base_target[0, 3] == target["target_x_m"]
    assert opened.values.labels(row["candidate_id"])["y_plan"] == row["y_plan"]


@pytest.mark.parametrize("name", ["full-0000-t3-g63", "full-0999-t0-g00", "full-0999", "kitchen"])
def test_ids_that_the_release_does_not_hold_are_refused(release: Path, name: str) -> None:
    opened = Release.open(release)
    with pytest.raises(IdentityError, match=name):
        opened.candidate(name) if "-t" in name else opened.scene(name)
