from __future__ import annotations

import contextlib
import io
import json
import os
import re
import shutil
from pathlib import Path

import pyarrow as pa
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from splits.manifest import MANIFEST, TableEntry, read_manifest, release_hash_of
from splits.release import ReleaseError, main, verify_release, write_release
from tables import schemas
from tables.columns import SchemaError
from tables.store import write_table
from tests.model.synthetic_release import TOLERANCES
from tests.splits.changed import changed

PROVENANCE = {"recipe_hash": "0" * 64, "code_version": "abc"}


@pytest.fixture(scope="module")
def release(release_tables: dict[str, pa.Table], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A release on disk; tests that change it copy it first."""
    directory = tmp_path_factory.mktemp("release")
    write_release(release_tables, directory, "pilot", "0.1.0", PROVENANCE, **TOLERANCES)
    return directory


def copy_of(release: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(release, tmp_path / "copy", dirs_exist_ok=True))


def test_a_written_release_verifies(release: Path, release_tables: dict[str, pa.Table]) -> None:
    manifest = verify_release(release)
    assert manifest.tier == "pilot"
    assert manifest.provenance == PROVENANCE
    assert manifest.licence == "CC-BY-4.0"
    assert {name: entry.rows for name, entry in manifest.tables.items()} == {n: t.num_rows for n, t in release_tables.items()}
    assert manifest.libraries["numpy"]


@given(st.data())
@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_one_flipped_byte_is_found(release: Path, tmp_path: Path, data: st.DataObject) -> None:
    directory = copy_of(release, tmp_path)
    listed = sorted([entry.file for entry in read_manifest(release).tables.values()] + ["README.md"])
    path = directory / data.draw(st.sampled_from(listed))
    content = bytearray(path.read_bytes())
    position = data.draw(st.integers(0, len(content) - 1))
    content[position] ^= 1 << data.draw(st.integers(0, 7))
    path.write_bytes(content)
    with pytest.raises(ReleaseError, match=f"{path.name}: SHA-256"):
        verify_release(directory)


def republished(directory: Path, name: str, table: pa.Table) -> None:
    """Replace a table and make the manifest agree with it, as someone would who regenerates checksums after an edit."""
    sidecar = write_table(schemas.ALL_SCHEMAS[name], table, directory / f"{name}.parquet")
    content = json.loads((directory / MANIFEST).read_text())
    content["tables"][name] = {
        "file": f"{name}.parquet",
        "rows": sidecar.rows,
        "sha256": sidecar.sha256,
        "content_hash": sidecar.content_hash,
    }
    content["release_hash"] = release_hash_of({n: TableEntry(**entry) for n, entry in content["tables"].items()})
    (directory / MANIFEST).write_text(json.dumps(content))


def test_one_flipped_label_is_found_even_with_new_checksums(release: Path, release_tables: dict[str, pa.Table], tmp_path: Path) -> None:
    directory = copy_of(release, tmp_path)
    flipped = changed(schemas.CANDIDATES, release_tables["candidates"], lambda row: row["y_pipe"] is True, y_pipe=False)
    republished(directory, "candidates", flipped)
    with pytest.raises(ReleaseError, match=r"labels: 1 rules broken.*y_pipe says the same as exec_status"):
        verify_release(directory)


def test_a_leak_is_found_even_with_new_checksums(release: Path, release_tables: dict[str, pa.Table], tmp_path: Path) -> None:
    directory = copy_of(release, tmp_path)
    republished(directory, "splits", release_tables["splits"].slice(1))
    with pytest.raises(ReleaseError, match=r"leakage: 1 leaks.*full-0000"):
        verify_release(directory)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda d: (d / MANIFEST).unlink(), "no complete release"),
        (lambda d: (d / MANIFEST).write_text("{"), "cannot be read as a manifest"),
        (lambda d: (d / "targets.parquet").unlink(), "targets.parquet: missing"),
        (lambda d: (d / "targets.parquet.json").unlink(), "targets.parquet: .*not published"),
        (lambda d: shutil.copy(d / "targets.parquet", d / "more.parquet"), "more.parquet: not in the manifest"),
    ],
)
def test_an_incomplete_release_is_refused(release: Path, tmp_path: Path, damage: object, message: str) -> None:
    directory = copy_of(release, tmp_path)
    damage(directory)  # type: ignore[operator]
    with pytest.raises(ReleaseError, match=message):
        verify_release(directory)


def test_impossible_tables_are_not_released(release_tables: dict[str, pa.Table], tmp_path: Path) -> None:
    flipped = changed(schemas.CANDIDATES, release_tables["candidates"], lambda row: row["y_plan"], y_plan=False)
    with pytest.raises(ReleaseError, match="labels: "):
        write_release(release_tables | {"candidates": flipped}, tmp_path, "pilot", "0.1.0", PROVENANCE, **TOLERANCES)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("without", "tier", "provenance", "message"),
    [
        ("targets", "pilot", PROVENANCE, r"missing \['targets'\]"),
        ("", "mini", PROVENANCE, "full-0000 is not in tier mini"),
        ("", "pilot", {}, "recipe_hash is missing"),
    ],
)
def test_a_release_needs_its_tables_tier_and_recipe(
    release_tables: dict[str, pa.Table], tmp_path: Path, without: str, tier: str, provenance: dict[str, str], message: str
) -> None:
    tables = {name: table for name, table in release_tables.items() if name != without}
    with pytest.raises(ReleaseError, match=message):
        write_release(tables, tmp_path, tier, "0.1.0", provenance, **TOLERANCES)


def test_a_table_of_the_wrong_type_is_not_released(release_tables: dict[str, pa.Table], tmp_path: Path) -> None:
    pool = release_tables["grasp_pool"]
    wrong = pool.set_column(pool.column_names.index("jaw_width_m"), "jaw_width_m", pool["jaw_width_m"].cast(pa.float32()))
    with pytest.raises(SchemaError, match="grasp_pool: schema differs"):
        write_release(release_tables | {"grasp_pool": wrong}, tmp_path, "pilot", "0.1.0", PROVENANCE, **TOLERANCES)
    assert not (tmp_path / MANIFEST).exists()


def test_the_same_tables_give_the_same_bytes_and_stale_tables_go(
    release: Path, release_tables: dict[str, pa.Table], tmp_path: Path
) -> None:
    directory = copy_of(release, tmp_path)
    shutil.copy(directory / "targets.parquet", directory / "plans.parquet")
    shutil.copy(directory / "targets.parquet.json", directory / "plans.parquet.json")
    write_release(release_tables, directory, "pilot", "0.1.0", PROVENANCE, **TOLERANCES)
    assert {path.name: path.read_bytes() for path in directory.iterdir()} == {path.name: path.read_bytes() for path in release.iterdir()}


def test_timings_are_no_part_of_the_release_hash(release: Path, release_tables: dict[str, pa.Table], tmp_path: Path) -> None:
    slower = changed(schemas.TIMINGS, release_tables["timings"], lambda row: True, core_ms=1e6)
    manifest = write_release(release_tables | {"timings": slower}, tmp_path, "pilot", "0.1.0", PROVENANCE, **TOLERANCES)
    assert manifest.release_hash == read_manifest(release).release_hash
    other = changed(schemas.TARGETS, release_tables["targets"], lambda row: True, rest_drift_m=1e-6)
    assert (
        write_release(release_tables | {"targets": other}, tmp_path, "pilot", "0.1.0", PROVENANCE, **TOLERANCES).release_hash
        != manifest.release_hash
    )


def test_the_card_states_the_data(release: Path, release_tables: dict[str, pa.Table]) -> None:
    card = (release / "README.md").read_text()
    rows = release_tables["candidates"].to_pylist()
    n_planned = sum(row["y_plan"] for row in rows)
    assert f"| candidates | {len(rows):,} |" in card
    assert f"| `solved` | {n_planned:,} ({100 * n_planned / len(rows):.1f} %) |" in card
    test = {row["scene_id"] for row in release_tables["splits"].to_pylist() if row["split"] == "test"}
    covered = {(row["scene_id"], row["target_id"]) for row in rows if row["scene_id"] in test and row["y_pipe"]}
    n_test = sum(row["scene_id"] in test for row in rows)
    (line,) = [line for line in card.splitlines() if line.startswith("| test |")]
    assert f"| {n_test:,} (" in line
    assert line.endswith(f"| {8 * len(test)} | {len(covered)} ({100 * len(covered) / (8 * len(test)):.1f} %) |")
    for schema in map(schemas.ALL_SCHEMAS.__getitem__, release_tables):
        assert all(f"| `{column.name}` |" in card for column in schema.columns)


def test_the_card_s_queries_run_as_printed(release: Path) -> None:
    code = "\n".join(re.findall(r"```python\n(.*?)```", (release / "README.md").read_text(), re.DOTALL))
    assert code.count("print(") == 3
    printed, before = io.StringIO(), Path.cwd()
    os.chdir(release)
    try:
        with contextlib.redirect_stdout(printed):
            exec(code, {})
    finally:
        os.chdir(before)
    assert printed.getvalue().count("shape:") == 3


def test_the_command_line_says_whether_a_release_is_sound(release: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["verify", str(release)]) == 0
    assert capsys.readouterr().out.startswith("sound: placebench pilot 0.1.0, 11 tables")
    directory = copy_of(release, tmp_path)
    (directory / "README.md").write_text("nothing")
    assert main(["verify", str(directory)]) == 1
    assert "README.md: SHA-256" in capsys.readouterr().err


def test_a_release_is_checked_by_and_states_its_own_tolerances(release_tables: dict[str, pa.Table], tmp_path: Path) -> None:
    manifest = write_release(release_tables, tmp_path, "pilot", "0.1.0", PROVENANCE, **TOLERANCES)
    assert manifest.position_tolerance_m == TOLERANCES["position_tolerance_m"]
    assert "| `position_tolerance_m` | `0.02` |" in (tmp_path / "README.md").read_text()
    with pytest.raises(ReleaseError, match="position error / 0"):
        write_release(release_tables, tmp_path, "pilot", "0.1.0", PROVENANCE, position_tolerance_m=0.0075, rotation_tolerance_rad=0.087)
