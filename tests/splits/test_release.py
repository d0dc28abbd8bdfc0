from __future__ import annotations

import hashlib
import json
import re
import shutil
from dataclasses import asdict, replace
from pathlib import Path

import pyarrow as pa
import pytest

from splits.errors import ReleaseError
from splits.manifest import DATA_VERSION, MANIFEST, read_manifest
from splits.release import main, verify_release, write_release
from tables import schemas
from tables.columns import SchemaError
from tests.model.synthetic_release import TOLERANCES
from tests.splits.changed import changed
from tests.splits.damage import PROVENANCE, contents, copy_of, read_json


def test_a_written_release_verifies(release: Path, release_tables: dict[str, pa.Table]) -> None:
    manifest = verify_release(release)
    assert manifest.tier == "pilot"
    assert manifest.provenance == PROVENANCE
    assert manifest.licence == "CC-BY-4.0"
    assert {name: entry.rows for name, entry in manifest.tables.items()} == {n: t.num_rows for n, t in release_tables.items()}
    assert manifest.libraries["numpy"]


def test_impossible_tables_are_not_released(release_tables: dict[str, pa.Table], tmp_path: Path) -> None:
    flipped = changed(schemas.CANDIDATES, release_tables["candidates"], lambda row: row["y_plan"], y_plan=False)
    with pytest.raises(ReleaseError, match="labels: "):
        write_release(release_tables | {"candidates": flipped}, tmp_path, "pilot", "0.1.0", PROVENANCE, TOLERANCES)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("without", "tier", "provenance", "message"),
    [
        ("targets", "pilot", PROVENANCE, r"missing \['targets'\]"),
        ("", "mini", PROVENANCE, "full-0000 is not in tier mini"),
        ("", "bogus", PROVENANCE, "tier: 'bogus' is not a tier; expected mini, pilot or full"),
        ("", "pilot", {}, "recipe_hash is missing"),
        ("", "pilot", {"recipe_hash": "0" * 64}, "catalogue_hash is missing, must be 64 hex digits"),
        ("", "pilot", {**PROVENANCE, "catalogue_hash": "C" * 64}, "catalogue_hash 'CCC.*', must be 64 hex digits"),
        ("", "pilot", {"recipe_hash": "0" * 64, "catalogue_hash": "c" * 64}, "git_commit is missing"),
        ("", "pilot", {**PROVENANCE, "git_commit": "main"}, "git_commit 'main', must be 40 hex digits"),
    ],
)
def test_a_release_needs_its_tables_tier_and_provenance(
    release_tables: dict[str, pa.Table], tmp_path: Path, without: str, tier: str, provenance: dict[str, str], message: str
) -> None:
    tables = {name: table for name, table in release_tables.items() if name != without}
    with pytest.raises(ReleaseError, match=message):
        write_release(tables, tmp_path, tier, "0.1.0", provenance, TOLERANCES)


def test_a_table_of_the_wrong_type_is_not_released(release_tables: dict[str, pa.Table], tmp_path: Path) -> None:
    pool = release_tables["grasp_pool"]
    wrong = pool.set_column(pool.column_names.index("jaw_width_m"), "jaw_width_m", pool["jaw_width_m"].cast(pa.float32()))
    with pytest.raises(SchemaError, match="grasp_pool: schema differs"):
        write_release(release_tables | {"grasp_pool": wrong}, tmp_path, "pilot", "0.1.0", PROVENANCE, TOLERANCES)
    assert not (tmp_path / MANIFEST).exists()


def test_the_same_tables_give_the_same_bytes_and_stale_tables_go(
    release: Path, release_tables: dict[str, pa.Table], tmp_path: Path
) -> None:
    directory = copy_of(release, tmp_path)
    shutil.copy(directory / "targets.parquet", directory / "plans.parquet")
    shutil.copy(directory / "targets.parquet", directory / "candidates.parquet")
    (directory / "plans.parquet.json").write_text("{}")
    write_release(release_tables, directory, "pilot", "0.1.0", PROVENANCE, TOLERANCES)
    assert contents(directory) == contents(release)


def test_timings_are_no_part_of_the_release_hash(release: Path, release_tables: dict[str, pa.Table], tmp_path: Path) -> None:
    slower = changed(schemas.TIMINGS, release_tables["timings"], lambda row: True, core_ms=1e6)
    manifest = write_release(release_tables | {"timings": slower}, tmp_path, "pilot", "0.1.0", PROVENANCE, TOLERANCES)
    assert manifest.release_hash == read_manifest(release).release_hash
    other = changed(schemas.TARGETS, release_tables["targets"], lambda row: True, rest_drift_m=1e-6)
    assert (
        write_release(release_tables | {"targets": other}, tmp_path, "pilot", "0.1.0", PROVENANCE, TOLERANCES).release_hash
        != manifest.release_hash
    )


def test_the_card_states_the_data(release: Path, release_tables: dict[str, pa.Table]) -> None:
    card = (release / "README.md").read_text()
    rows = release_tables["candidates"].to_pylist()
    n_planned = sum(row["y_plan"] for row in rows)
    assert f"| candidates | {len(rows):,} |" in card
    n_valid = sum(row["exec_status"] in ("success", "slipped_in_hand") for row in rows)
    n_slipped = n_valid - sum(bool(row["y_pipe"]) for row in rows)
    assert n_slipped > 0
    assert f"| `slipped_in_hand` | {n_slipped:,} ({100 * n_slipped / n_planned:.1f} %) |" in card
    assert "`exec_status` in (`success`, `slipped_in_hand`)" in " ".join(card.split())
    assert f"| `solved` | {n_planned:,} ({100 * n_planned / len(rows):.1f} %) |" in card
    test = {row["scene_id"] for row in release_tables["splits"].to_pylist() if row["split"] == "test"}
    covered = {(row["scene_id"], row["target_id"]) for row in rows if row["scene_id"] in test and row["y_pipe"]}
    n_test = sum(row["scene_id"] in test for row in rows)
    (line,) = [line for line in card.splitlines() if line.startswith("| test |")]
    assert f"| {n_test:,} (" in line
    assert line.endswith(f"| {8 * len(test)} | {len(covered)} ({100 * len(covered) / (8 * len(test)):.1f} %) |")
    for schema in map(schemas.ALL_SCHEMAS.__getitem__, release_tables):
        assert all(f"| `{column.name}` |" in card for column in schema.columns)


def test_the_command_line_says_whether_a_release_is_sound(release: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["verify", str(release)]) == 0
    assert capsys.readouterr().out.startswith("sound: placebench pilot 0.1.0, 11 tables")
    directory = copy_of(release, tmp_path)
    card = (directory / "README.md").read_text()
    (directory / "README.md").write_text(card.replace("pilot", "mini!", 1))
    assert main(["verify", str(directory)]) == 1
    assert "README.md: SHA-256" in capsys.readouterr().err


def test_a_release_is_checked_by_and_states_its_own_tolerances(release_tables: dict[str, pa.Table], tmp_path: Path) -> None:
    manifest = write_release(release_tables, tmp_path, "pilot", "0.1.0", PROVENANCE, TOLERANCES)
    assert manifest.tolerances == read_manifest(tmp_path).tolerances == TOLERANCES
    stated = {"position_m": "0.02", "rotation_rad": "0.1745", "slip_m": "0.002", "slip_rad": "0.03491"}
    card = (tmp_path / "README.md").read_text()
    assert [name for name, value in stated.items() if f"| `tolerances.{name}` | `{value}` |" not in card] == []
    assert read_json(tmp_path / MANIFEST)["tolerances"] == asdict(TOLERANCES)
    for tighter, words in (({"position_m": 0.0075}, "position error / 0.0075"), ({"slip_m": 0.0009}, "transport_slip_m of at most 0.0009")):
        with pytest.raises(ReleaseError, match=words):
            write_release(release_tables, tmp_path, "pilot", "0.1.0", PROVENANCE, replace(TOLERANCES, **tighter))


@pytest.mark.parametrize(
    ("version", "message"),
    [
        ("0.1", "version '0.1', must be major.minor.patch"),
        ("2.0.0", rf"version 2.0.0 is of a newer major version than this code knows \({DATA_VERSION}\)"),
    ],
)
def test_a_release_that_could_not_be_read_is_not_written(
    release_tables: dict[str, pa.Table], tmp_path: Path, version: str, message: str
) -> None:
    with pytest.raises(ReleaseError, match=message):
        write_release(release_tables, tmp_path, "pilot", version, PROVENANCE, TOLERANCES)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["notes.txt", "sub/", "targets.parquet/", ".hidden"])
def test_a_folder_with_something_else_is_refused_untouched(
    release: Path, release_tables: dict[str, pa.Table], tmp_path: Path, name: str
) -> None:
    directory = copy_of(release, tmp_path)
    if name.endswith("/"):
        (directory / name.rstrip("/")).unlink(missing_ok=True)
        (directory / name).mkdir()
    else:
        (directory / name).write_text("mine")
    before = {path.name: path.stat().st_mtime_ns for path in directory.iterdir()}
    with pytest.raises(ReleaseError, match=f"{re.escape(name.rstrip('/'))}: not a file of a release"):
        write_release(release_tables, directory, "pilot", "0.1.0", PROVENANCE, TOLERANCES)
    assert {path.name: path.stat().st_mtime_ns for path in directory.iterdir()} == before


def test_what_a_killed_write_left_goes(release: Path, release_tables: dict[str, pa.Table], tmp_path: Path) -> None:
    directory = copy_of(release, tmp_path)
    for name in (".targets.parquet.a1b2c3", ".targets.parquet.json.a1b2c3", ".README.md.x_y", ".manifest.json.x_y", "old.parquet.json"):
        (directory / name).write_text("half")
    write_release(release_tables, directory, "pilot", "0.1.0", PROVENANCE, TOLERANCES)
    assert contents(directory).keys() == contents(release).keys()
    with pytest.raises(ReleaseError, match=r"README\.md: not a folder"):
        write_release(release_tables, directory / "README.md", "pilot", "0.1.0", PROVENANCE, TOLERANCES)


def test_the_release_hash_knows_the_tables_only(release: Path, release_tables: dict[str, pa.Table], tmp_path: Path) -> None:
    dirty = {**PROVENANCE, "git_commit": f"{PROVENANCE['git_commit']}-dirty"}
    other = write_release(release_tables, tmp_path, "pilot", "0.2.0", dirty, TOLERANCES)
    first = read_manifest(release)
    assert other.release_hash == first.release_hash
    of_tables = [file for entry in first.tables.values() for file in entry.files]
    assert [other.files[file] for file in of_tables] == [first.files[file] for file in of_tables]
    own_hashes = [read_json(directory / MANIFEST)["manifest_sha256"] for directory in (release, tmp_path)]
    assert own_hashes[0] != own_hashes[1]
    assert f"| `git_commit` | `{dirty['git_commit']}` |" in (tmp_path / "README.md").read_text()
    assert f"| `catalogue_hash` | `{dirty['catalogue_hash']}` |" in (tmp_path / "README.md").read_text()


def test_the_own_hash_of_a_manifest_needs_nothing_but_json_and_sha256(release: Path) -> None:
    content = read_json(release / MANIFEST)
    stated = content.pop("manifest_sha256")
    canonical = json.dumps(content, sort_keys=True, separators=(",", ":"))
    assert hashlib.sha256(canonical.encode()).hexdigest() == stated
