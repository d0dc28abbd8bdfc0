"""A unit that raises, dies or hangs on to nothing becomes its own outcome; the others are untouched, and so is the process that asked."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import psutil
import pytest

from pipelines.running.workers import THREAD_VARIABLES, Workers, WorkersDiedError, WorkersError, run_units
from tables.errors import PlaceBenchError

ROOT = Path(__file__).parents[3]


@pytest.fixture
def two() -> Iterator[Workers]:
    with Workers(2) as workers:
        yield workers


@pytest.fixture
def one() -> Iterator[Workers]:
    with Workers(1) as workers:
        yield workers


def _square_or_fail(k: int) -> int:
    if k == 3:
        raise ValueError(f"unit {k} is 3, must be another")
    if k == 5:
        os.kill(os.getpid(), signal.SIGSEGV)
    return k * k


def test_results_do_not_depend_on_the_number_of_workers() -> None:
    units = [(k,) for k in (0, 1, 2, 4, 6, 7)]
    found = [{o.index: o.value for o in run_units(_square_or_fail, units, n)} for n in (0, 1, 2)]
    assert found[0] == found[1] == found[2] == {i: u[0] ** 2 for i, u in enumerate(units)}


def test_a_raising_and_a_crashing_unit_leave_the_others_intact(two: Workers) -> None:
    outcomes = {o.index: o for o in two.run(_square_or_fail, [(k,) for k in range(10)])}
    assert sorted(outcomes) == list(range(10))
    assert "unit 3 is 3, must be another" in (outcomes[3].error or "")
    assert "died with exit code" in (outcomes[5].error or "")
    assert [outcomes[k].value for k in (0, 1, 2, 4, 6, 7, 8, 9)] == [k * k for k in (0, 1, 2, 4, 6, 7, 8, 9)]


def _leave(k: int) -> object:
    if k == 1:
        sys.exit(3)
    return (lambda: None) if k == 2 else k


def test_what_cannot_be_given_back_is_an_outcome_of_its_own(one: Workers) -> None:
    """A unit that leaves its process, a value and an argument that cannot be pickled."""
    outcomes = {o.index: o for o in one.run(_leave, [(0,), (1,), (2,), (lambda: None,), (4,)])}
    assert [outcomes[k].value for k in range(5)] == [0, None, None, None, 4]
    assert [k for k in range(5) if outcomes[k].error] == [1, 2, 3]
    assert "SystemExit" in (outcomes[1].error or "")


def _pid(k: int, seconds: float = 0.05) -> int:
    time.sleep(seconds)
    return os.getpid()


def _pids(workers: Workers, n_units: int = 8) -> list[int]:
    outcomes = list(workers.run(_pid, [(k,) for k in range(n_units)]))
    assert sorted(outcome.index for outcome in outcomes) == list(range(n_units))
    assert all(outcome.error is None for outcome in outcomes)
    return [outcome.value for outcome in outcomes]


def test_workers_serve_many_runs(two: Workers) -> None:
    first = set(_pids(two))
    assert len(first) == 2
    assert os.getpid() not in first
    assert all(set(_pids(two)) == first for _ in range(3))


def test_workers_end_with_their_block() -> None:
    with Workers(2) as workers:
        pids = set(_pids(workers))
        assert all(psutil.pid_exists(pid) for pid in pids)
    assert not any(psutil.pid_exists(pid) for pid in pids)
    with pytest.raises(RuntimeError, match="inside their block only"):
        workers.run(_pid, [(0,)])


def test_two_pools_do_not_know_of_each_other(one: Workers) -> None:
    (mine,) = set(_pids(one))
    with Workers(1) as other:
        assert set(_pids(other)) != {mine}
        assert set(_pids(one)) == {mine}
    assert set(_pids(one)) == {mine}


@pytest.mark.parametrize("units_per_life", [1, 3])
def test_a_worker_is_replaced_after_its_units(units_per_life: int) -> None:
    with Workers(1, units_per_life=units_per_life) as workers:
        pids = _pids(workers, 6)
    assert [pids.count(pid) for pid in dict.fromkeys(pids)] == [units_per_life] * (6 // units_per_life)


def test_a_worker_that_dies_between_two_runs_is_replaced(one: Workers) -> None:
    (before,) = set(_pids(one))
    _kill(before)
    (after,) = set(_pids(one))
    assert after != before


def test_a_worker_that_dies_between_two_units_costs_no_unit(one: Workers) -> None:
    with closing(one.run(_pid, [(k,) for k in range(12)])) as outcomes:
        seen = [next(outcomes)]
        time.sleep(1.0)  # all units that were handed out are done, so the worker dies with nothing to do
        _kill(seen[0].value)
        seen += outcomes
    assert sorted(outcome.index for outcome in seen) == list(range(12))
    assert all(outcome.error is None for outcome in seen)
    assert len({outcome.value for outcome in seen}) == 2


class _DeadlyOnce:
    """An argument that kills the worker that receives it, before the worker can say which unit it has; the first time only."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> tuple[object, tuple[Path]]:
        return _receive, (self.marker,)


def _receive(marker: Path) -> int:
    if not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return 4


def test_units_that_a_dying_pool_had_are_given_to_another_one(one: Workers, tmp_path: Path) -> None:
    units = [(0,), (1,), (_DeadlyOnce(tmp_path / "received"),), (2,), (6,)]
    outcomes = {outcome.index: outcome for outcome in one.run(_square_or_fail, units)}
    assert [outcomes[k].value for k in range(5)] == [0, 1, 16, 4, 36]
    assert (tmp_path / "received").exists()


def test_the_death_of_the_server_of_the_workers_costs_at_most_the_units_in_work(one: Workers) -> None:
    with closing(one.run(_pid, [(k,) for k in range(12)])) as outcomes:
        seen = [next(outcomes)]
        _kill(psutil.Process(seen[0].value).ppid())
        _kill(seen[0].value)
        seen += outcomes
    assert sorted(outcome.index for outcome in seen) == list(range(12))
    assert len([outcome for outcome in seen if outcome.error]) <= 1
    assert _threads(one) == (["1"] * len(THREAD_VARIABLES), 1)


def _only_here(k: int) -> int:
    return k


def test_workers_that_cannot_live_are_an_error_and_not_a_loop(one: Workers, monkeypatch: pytest.MonkeyPatch) -> None:
    """A function of a module that is known here and to no other process."""
    monkeypatch.setattr(_only_here, "__module__", "tests.no_such_module")
    monkeypatch.setitem(sys.modules, "tests.no_such_module", sys.modules[__name__])
    with pytest.raises(WorkersDiedError, match="workers died 4 times in a row"):
        list(one.run(_only_here, [(0,)]))


def _kill(pid: int) -> None:
    os.kill(pid, signal.SIGKILL)
    time.sleep(0.5)


def test_who_stops_listening_ends_the_units_in_work_and_does_not_disturb_the_next_run(two: Workers) -> None:
    with closing(two.run(_pid, [(0, 0.0), *((k, 60.0) for k in range(8))])) as outcomes:
        pid = next(outcomes).value
    _wait_until_gone(pid)
    assert len(set(_pids(two))) == 2


def test_an_error_of_who_listens_does_not_disturb_the_next_run(two: Workers) -> None:
    """The generator is still alive then, in the error's traceback; closing it late changes nothing either."""
    outcomes = two.run(_pid, [(0, 0.0), *((k, 60.0) for k in range(8))])

    def listen() -> None:
        for _ in outcomes:
            raise KeyError("who listens fails")

    with pytest.raises(KeyError):
        listen()
    start = time.monotonic()
    later = two.run(_pid, [(k,) for k in range(8)])
    first = next(later)
    outcomes.close()
    assert sorted(outcome.index for outcome in (first, *later)) == list(range(8))
    assert time.monotonic() - start < 30.0


def test_a_run_that_goes_on_after_another_has_begun_is_refused(two: Workers) -> None:
    earlier = two.run(_pid, [(k,) for k in range(20)])
    next(earlier)
    assert len(_pids(two)) == 8
    with pytest.raises(RuntimeError, match="another run of these workers has begun"):
        list(earlier)
    assert len(_pids(two)) == 8


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
        _wait_until_gone(pid)


def test_a_kill_of_the_process_that_asked_ends_its_idle_workers(tmp_path: Path) -> None:
    child = multiprocessing.get_context("spawn").Process(target=_run_and_wait, args=(str(tmp_path),))
    child.start()
    (pid,) = _wait_for_files(tmp_path, 1)
    child.kill()
    child.join(30)
    _wait_until_gone(pid)


def _run_and_wait(folder: str) -> None:
    with Workers(1) as workers:
        (pid,) = set(_pids(workers))
        (Path(folder) / str(pid)).touch()
        time.sleep(60.0)


def _wait_for_files(folder: Path, n: int) -> list[int]:
    end = time.monotonic() + 60.0
    while len(names := [path.name for path in folder.iterdir()]) < n:
        assert time.monotonic() < end, "no unit began within 60 s"
        time.sleep(0.1)
    return [int(name) for name in names]


def _wait_until_gone(pid: int) -> None:
    end = time.monotonic() + 20.0
    while psutil.pid_exists(pid) and psutil.Process(pid).status() != psutil.STATUS_ZOMBIE:
        assert time.monotonic() < end, f"process {pid} is alive after 20 s"
        time.sleep(0.1)


def _run_some() -> None:
    with Workers(1) as workers:
        assert len(set(_pids(workers))) == 1


def _run_some_and_leave_the_block_open() -> None:
    workers = Workers(1).__enter__()
    assert len(set(_pids(workers))) == 1
    sys.modules[__name__].__dict__["_left_open"] = workers


@pytest.mark.parametrize("run", [_run_some, _run_some_and_leave_the_block_open])
@pytest.mark.parametrize("method", ["spawn", "forkserver"])
def test_a_process_that_ran_units_ends(run, method: str) -> None:
    """Dagster starts the runs of its UI so; workers must not hold it back."""
    child = multiprocessing.get_context(method).Process(target=run)
    child.start()
    child.join(60)
    assert child.exitcode == 0


def _thread_limits() -> tuple[list[str | None], int]:
    """The variables as this process sees them, and its threads after a product that BLAS would spread over all cores."""
    np.ones((500, 500)) @ np.ones((500, 500))
    return [os.environ.get(name) for name in THREAD_VARIABLES], psutil.Process().num_threads()


def _threads(workers: Workers) -> tuple[list[str | None], int]:
    (outcome,) = workers.run(_thread_limits, [()])
    assert outcome.error is None
    return outcome.value


def _say_threads() -> None:
    for name in THREAD_VARIABLES:
        os.environ.pop(name, None)
    before = dict(os.environ)
    with Workers(1) as workers:
        assert _threads(workers) == (["1"] * len(THREAD_VARIABLES), 1)
    with Workers(1, units_per_life=1) as workers:
        assert all(outcome.value[1] == 1 for outcome in workers.run(_thread_limits, [()] * 3))
    assert dict(os.environ) == before


def _say_threads_with_another_server() -> None:
    """The server of the workers was started before, by code that wants all cores."""
    for name in THREAD_VARIABLES:
        os.environ.pop(name, None)
    child = multiprocessing.get_context("forkserver").Process(target=int)
    child.start()
    child.join()
    with Workers(1) as workers:
        assert _threads(workers) == (["1"] * len(THREAD_VARIABLES), 1)


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
        _pids(workers)
    assert dict(os.environ) == before
    assert sys.modules["__main__"] is main


_PROGRAM = """
print("main module imported", flush=True)
from pipelines.running.workers import Workers, WorkersError
from tests.pipelines.running.test_workers import _loaded, _square_or_fail
from tests import builders
def mine(k): return k
with Workers(2, preload=({preload})) as workers:
    print(sum(outcome.value for outcome in workers.run(_square_or_fail, [(k,) for k in range(3)])))
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


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ({"n_workers": -1}, r"n_workers is -1, must be >= 0"),
        ({"n_workers": 1, "units_per_life": 0}, r"units_per_life is 0, must be >= 1"),
    ],
)
def test_numbers_out_of_bounds_are_refused_at_once(how: dict[str, int], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Workers(**how)
    with pytest.raises(WorkersError, match=message):
        list(run_units(_square_or_fail, [], **how))
    assert issubclass(WorkersError, PlaceBenchError)
    assert issubclass(WorkersDiedError, PlaceBenchError)


def test_no_workers_run_units_in_this_process() -> None:
    with Workers(0) as workers:
        assert set(_pids(workers, 2)) == {os.getpid()}
        assert "ValueError: unit 3" in (next(workers.run(_square_or_fail, [(3,)])).error or "")
