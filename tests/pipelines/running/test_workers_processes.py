"""Workers and the process that asked: both end when they should, and neither changes the other's threads, environment or main module."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pipelines.running.workers import THREAD_VARIABLES, Workers
from tests.pipelines.running.units import pids_of, thread_limits, threads_of, wait_until_gone

ROOT = Path(__file__).parents[3]


def _note_and_sleep(folder: str) -> None:
    (Path(folder) / str(os.getpid())).touch()
    time.sleep(60.0)


def _run_long_units(folder: str) -> None:
    with Workers(2) as workers:
        list(workers.run(_note_and_sleep, [(folder,)] * 4))


def test_an_interrupt_ends_the_units_in_work(tmp_path: Path) -> None:
    child = multiprocessing.get_context("spawn").Process(target=_run_long_units, args=(str(tmp_path),))
    child.start()
    pids = _wait_for_files(tmp_path, 2)
    assert child.pid is not None
    os.kill(child.pid, signal.SIGINT)
    child.join(30)
    assert child.exitcode == 1
    for pid in pids:
        wait_until_gone(pid)


def test_a_kill_of_the_process_that_asked_ends_its_idle_workers(tmp_path: Path) -> None:
    child = multiprocessing.get_context("spawn").Process(target=_run_and_wait, args=(str(tmp_path),))
    child.start()
    (pid,) = _wait_for_files(tmp_path, 1)
    child.kill()
    child.join(30)
    wait_until_gone(pid)


def _run_and_wait(folder: str) -> None:
    with Workers(1) as workers:
        (pid,) = set(pids_of(workers))
        (Path(folder) / str(pid)).touch()
        time.sleep(60.0)


def _wait_for_files(folder: Path, n: int) -> list[int]:
    end = time.monotonic() + 60.0
    while len(names := [path.name for path in folder.iterdir()]) < n:
        assert time.monotonic() < end, "no unit began within 60 s"
        time.sleep(0.1)
    return [int(name) for name in names]


def _run_some() -> None:
    with Workers(1) as workers:
        assert len(set(pids_of(workers))) == 1


def _run_some_and_leave_the_block_open() -> None:
    workers = Workers(1).__enter__()
    assert len(set(pids_of(workers))) == 1
    sys.modules[__name__].__dict__["_left_open"] = workers


@pytest.mark.parametrize("run", [_run_some, _run_some_and_leave_the_block_open])
@pytest.mark.parametrize("method", ["spawn", "forkserver"])
def test_a_process_that_ran_units_ends(run, method: str) -> None:
    """Dagster starts the runs of its UI so; workers must not hold it back."""
    child = multiprocessing.get_context(method).Process(target=run)
    child.start()
    child.join(60)
    assert child.exitcode == 0


def _say_threads() -> None:
    for name in THREAD_VARIABLES:
        os.environ.pop(name, None)
    before = dict(os.environ)
    with Workers(1) as workers:
        assert threads_of(workers) == (["1"] * len(THREAD_VARIABLES), 1)
    with Workers(1, units_per_life=1) as workers:
        assert all(outcome.value[1] == 1 for outcome in workers.run(thread_limits, [()] * 3))
    assert dict(os.environ) == before


def _say_threads_with_another_server() -> None:
    """The server of the workers was started before, by code that wants all cores."""
    for name in THREAD_VARIABLES:
        os.environ.pop(name, None)
    child = multiprocessing.get_context("forkserver").Process(target=int)
    child.start()
    child.join()
    with Workers(1) as workers:
        assert threads_of(workers) == (["1"] * len(THREAD_VARIABLES), 1)


@pytest.mark.parametrize("run", [_say_threads, _say_threads_with_another_server])
def test_workers_have_one_thread_and_leave_the_environment_as_it_was(run) -> None:
    child = multiprocessing.get_context("spawn").Process(target=run)
    child.start()
    child.join(60)
    assert child.exitcode == 0


def test_the_environment_and_the_main_module_stay_as_they_were(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    before, main = dict(os.environ), sys.modules["__main__"]
    with Workers(2, units_per_life=1) as workers:
        pids_of(workers)
    assert dict(os.environ) == before
    assert sys.modules["__main__"] is main


_PROGRAM = """
print("main module imported", flush=True)
from pipelines.running.workers import Workers, WorkersError
from tests.pipelines.running.test_workers_processes import _loaded
from tests.pipelines.running.units import square_or_fail
from tests import builders
def mine(k): return k
with Workers(2, preload=({preload})) as workers:
    print(sum(outcome.value for outcome in workers.run(square_or_fail, [(k,) for k in range(3)])))
    print([outcome.value for outcome in workers.run(_loaded, [("tests.builders",)])])
    try:
        workers.run(mine, [(1,)])
    except WorkersError as error:
        print(error)
"""


def _loaded(name: str) -> bool:
    return name in sys.modules


@pytest.mark.parametrize(("preload", "is_loaded"), [("builders,", True), ("", False)])
def test_workers_load_what_is_named_and_never_the_program_that_was_started(preload: str, is_loaded: bool, tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    program.write_text(_PROGRAM.format(preload=preload))
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    said = subprocess.run([sys.executable, program], capture_output=True, text=True, timeout=120, cwd=ROOT, env=environment, check=True)
    lines = said.stdout.splitlines()
    assert lines.count("main module imported") == 1
    assert lines[1:] == ["5", f"[{is_loaded}]", "mine is in __main__, must be in a module that a worker can import"]
