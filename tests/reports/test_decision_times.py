"""The command that measures decision times writes what reports read; no number of it is asserted, which a machine decides."""

from __future__ import annotations

from pathlib import Path

import pytest

from model.decision_times import machine_name
from reports.decision_times import decision_time_section, main
from reports.ranking import MACHINE, stage_of_variant
from splits.release import write_release
from tables.schemas import TIMINGS
from tables.store import read_sidecar, read_table
from tests.model.synthetic_release import RELEASE_SCHEMAS, TOLERANCES, write_synthetic_release
from tests.splits.damage import PROVENANCE


@pytest.fixture(scope="module")
def release(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("timed")
    loose = write_synthetic_release(root / "loose", n_scenes=10, seed=1, n_points=40)
    tables = {schema.name: read_table(schema, loose / f"{schema.name}.parquet") for schema in RELEASE_SCHEMAS}
    write_release(tables, root / "pilot", "pilot", "0.1.0", PROVENANCE, TOLERANCES)
    return root / "pilot"


def test_times_of_the_trees_are_of_test_groups_and_name_release_and_machine(release: Path, tmp_path: Path) -> None:
    assert main([str(release), "--trees", "--scenes", "1", "--out", str(tmp_path)]) == 0
    path = tmp_path / "tree_decision_times.parquet"
    rows = read_table(TIMINGS, path, verify=True).to_pylist()
    assert {row["stage"] for row in rows} == {"trees"}
    (scene,) = {row["item_id"].partition("-t")[0] for row in rows}
    assert scene in {row["item_id"] for row in rows}
    made_from = read_sidecar(path).made_from
    assert made_from[MACHINE] == machine_name()
    assert set(made_from) == {MACHINE, "release"}
    assert not (tmp_path / "decision_times.parquet").exists()


def test_nothing_measured_is_said_and_what_is_not_timed_has_no_stage() -> None:
    assert "Not measured" in decision_time_section([], "")[1]
    assert [stage_of_variant(name) for name in ("full", "local", "pose_only", "trees")] == ["ranker", "local", "pose_only", "trees"]
    with pytest.raises(KeyError):
        stage_of_variant("trees_poses")


def test_a_folder_that_is_no_release_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(tmp_path / "nothing"), "--trees", "--out", str(tmp_path)]) == 1
    assert capsys.readouterr().err == f"error: {tmp_path / 'nothing'}: no such folder\n"
