"""Laws of the studies' rows: none is lost with a killed run, none is used again after a change, none depends on workers or order."""

from __future__ import annotations

import dataclasses
import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from pipelines.proofs.validity.kept_rows import KeptRows
from pipelines.proofs.validity.running import StudyResult, run_study
from pipelines.proofs.validity.study import Study, StudyError, StudyUnit
from pipelines.running.workers import Workers
from tests.pipelines.proofs.validity.made_up import fail_on_odd, give_up_on_odd, made_up_study, square, total

MADE_FROM = {"release": "abc", "code": "1"}


def run(study: Study, path: Path, made_from: dict[str, str] = MADE_FROM, n_workers: int = 0) -> StudyResult:
    with Workers(n_workers) as workers:
        return run_study(study, path, made_from, workers)


def test_rows_do_not_depend_on_workers_or_order(tmp_path: Path) -> None:
    reference = run(made_up_study(), tmp_path / "here.jsonl")
    assert reference.problem == ""
    assert [row["k"] for row in reference.rows] == list(range(6))
    assert reference.numbers == {"total": sum(k * k / 7.0 for k in range(6))}
    for n_workers in (1, 2):
        path = tmp_path / f"{n_workers}.jsonl"
        # Half of the units in another order first, then all.
        run(made_up_study(3, reverse=True), path, n_workers=n_workers)
        assert run(made_up_study(), path, n_workers=n_workers).rows == reference.rows
        assert path.read_bytes() == (tmp_path / "here.jsonl").read_bytes()


def test_a_killed_run_loses_the_unit_in_work_and_nothing_else(tmp_path: Path) -> None:
    path, log = tmp_path / "rows.jsonl", tmp_path / "log"
    program = (
        "import sys; from pathlib import Path\n"
        "from tests.pipelines.proofs.validity.made_up import made_up_study\n"
        "from tests.pipelines.proofs.validity.test_running import run\n"
        "run(made_up_study(log=Path(sys.argv[2]), kill_at=4), Path(sys.argv[1]))\n"
    )
    died = subprocess.run([sys.executable, "-c", program, str(path), str(log)], check=False)
    assert died.returncode == -signal.SIGKILL
    assert log.read_text().split() == ["0", "1", "2", "3"]
    result = run(made_up_study(log=log), path)
    assert log.read_text().split() == ["0", "1", "2", "3", "4", "5"]
    assert result.rows == run(made_up_study(), tmp_path / "whole.jsonl").rows
    assert path.read_bytes() == (tmp_path / "whole.jsonl").read_bytes()


@pytest.mark.parametrize("n_left", [1, 20, 60])
def test_half_a_line_is_cut_off_and_measured_again(n_left: int, tmp_path: Path) -> None:
    path, log = tmp_path / "rows.jsonl", tmp_path / "log"
    whole = run(made_up_study(), path)
    content = path.read_bytes()
    lines = content.splitlines(keepends=True)
    path.write_bytes(b"".join(lines[:4]) + lines[4][:n_left])
    assert run(made_up_study(log=log), path).rows == whole.rows
    assert log.read_text().split() == ["3", "4", "5"]
    assert path.read_bytes() == content


@pytest.mark.parametrize("made_from", [{"release": "abd", "code": "1"}, {"release": "abc", "code": "2"}, {"release": "abc"}])
def test_rows_of_other_origin_are_not_used_again(made_from: dict[str, str], tmp_path: Path) -> None:
    path, log = tmp_path / "rows.jsonl", tmp_path / "log"
    run(made_up_study(), path)
    run(made_up_study(2, log=log), path, made_from)
    assert log.read_text().split() == ["0", "1"]
    with KeptRows(path, {"study": "made_up", **MADE_FROM}) as kept:
        assert not kept.rows


def test_rows_of_another_study_are_not_used_again(tmp_path: Path) -> None:
    run(made_up_study(), tmp_path / "rows.jsonl")
    log = tmp_path / "log"
    run(dataclasses.replace(made_up_study(log=log), name="other"), tmp_path / "rows.jsonl")
    assert len(log.read_text().split()) == 6


@pytest.mark.parametrize("damage", [b"{}\n", b"\xff\xfe\n", b'{"unit": "unit 1"}\n', b"[1]\n"])
def test_a_file_damaged_in_the_middle_is_not_believed(damage: bytes, tmp_path: Path) -> None:
    path, log = tmp_path / "rows.jsonl", tmp_path / "log"
    whole = run(made_up_study(), path)
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join([*lines[:2], damage, *lines[3:]]))
    assert run(made_up_study(log=log), path).rows == whole.rows
    assert len(log.read_text().split()) == 6


def test_an_interrupted_run_keeps_what_is_finished(tmp_path: Path) -> None:
    path, log = tmp_path / "rows.jsonl", tmp_path / "log"

    def stop(done: int, n: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with Workers(0) as workers, pytest.raises(KeyboardInterrupt):
        run_study(made_up_study(log=log), path, MADE_FROM, workers, stop)
    run(made_up_study(log=log), path)
    assert log.read_text().split() == ["0", "1", "2", "3", "4", "5"]


def test_a_run_that_the_engine_gave_up_is_a_fault_and_not_measured_again(tmp_path: Path) -> None:
    log = tmp_path / "log"
    study = dataclasses.replace(made_up_study(log=log), measure=give_up_on_odd)
    result = run(study, tmp_path / "rows.jsonl")
    assert result.faults == tuple(f"unit {k}: the state is not finite" for k in (1, 3, 5))
    assert result.numbers == {"total": sum(k * k / 7.0 for k in (0, 2, 4))}
    assert result.n_runs == 6
    assert run(study, tmp_path / "rows.jsonl").rows == result.rows
    assert log.read_text().split() == ["0", "2", "4"]


def test_a_unit_that_fails_is_a_problem_and_measured_again(tmp_path: Path) -> None:
    path, log = tmp_path / "rows.jsonl", tmp_path / "log"
    result = run(dataclasses.replace(made_up_study(log=log), measure=fail_on_odd), path, n_workers=1)
    assert result.problem == "3 of 6 units failed, must be 0: unit 1: ValueError: 1 is odd"
    assert result.numbers == {}
    assert len(result.rows) == 3
    assert run(made_up_study(log=log), path).problem == ""
    assert sorted(log.read_text().split()) == ["0", "1", "2", "3", "4", "5"]


def test_a_study_without_units_or_results_is_a_problem(tmp_path: Path) -> None:
    assert "0 units" in run(made_up_study(0), tmp_path / "none.jsonl").problem
    only_faults = Study("faults", (StudyUnit("unit 1", (1, None, -1)),), give_up_on_odd, total, 1.0)
    assert "no result for any of 1 units" in run(only_faults, tmp_path / "faults.jsonl").problem


def test_two_units_of_one_key_are_refused() -> None:
    unit = StudyUnit("unit 1", (1, None, -1))
    with pytest.raises(StudyError, match="unit 1 is there 2 times"):
        Study("made_up", (unit, unit), square, total, 1.0)


def test_rows_are_plain_json(tmp_path: Path) -> None:
    run(made_up_study(2), tmp_path / "rows.jsonl")
    header, *rows = [json.loads(line) for line in (tmp_path / "rows.jsonl").read_text().splitlines()]
    assert header == {"made_from": {"study": "made_up", **MADE_FROM}}
    assert rows[1] == {"unit": "unit 1", "row": {"k": 1, "square": 1 / 7.0, "name": "µ", "none": None, "list": [0.1, 1]}}
