"""A unit that raises, dies or hangs on to nothing becomes its own outcome; the others are untouched."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from contextlib import closing

import pytest

from pipelines.running.workers import run_units


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


def test_a_raising_and_a_crashing_unit_leave_the_others_intact() -> None:
    outcomes = {o.index: o for o in run_units(_square_or_fail, [(k,) for k in range(10)], 2)}
    assert sorted(outcomes) == list(range(10))
    assert "unit 3 is 3, must be another" in (outcomes[3].error or "")
    assert "died with exit code" in (outcomes[5].error or "")
    assert [outcomes[k].value for k in (0, 1, 2, 4, 6, 7, 8, 9)] == [k * k for k in (0, 1, 2, 4, 6, 7, 8, 9)]


def _thread_limits() -> list[str | None]:
    return [os.environ.get(name) for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")]


def test_workers_are_single_threaded() -> None:
    (outcome,) = run_units(_thread_limits, [()], 1)
    assert outcome.value == ["1", "1"]


def _pid(k: int) -> int:
    time.sleep(0.05)
    return os.getpid()


def _pids(n: int) -> set[int]:
    return {outcome.value for outcome in run_units(_pid, [(k,) for k in range(4 * n)], n)}


def test_workers_are_kept_for_the_next_call() -> None:
    assert _pids(2) == _pids(2)


def test_a_worker_that_dies_between_two_calls_is_replaced() -> None:
    (before,) = _pids(1)
    os.kill(before, signal.SIGKILL)
    time.sleep(0.5)
    (after,) = _pids(1)
    assert after != before


def test_who_stops_listening_does_not_disturb_the_next_call() -> None:
    with closing(run_units(_pid, [(k,) for k in range(40)], 2)) as outcomes:
        next(outcomes)
    assert len(_pids(2)) == 2


def _run_some() -> None:
    assert len(_pids(1)) == 1


def test_a_process_that_ran_units_ends() -> None:
    """Dagster starts the runs of its UI so; kept workers must not hold it back."""
    child = multiprocessing.get_context("spawn").Process(target=_run_some)
    child.start()
    child.join(60)
    assert child.exitcode == 0


def test_a_negative_number_of_workers_is_refused() -> None:
    with pytest.raises(ValueError, match="n_workers is -1"):
        list(run_units(_square_or_fail, [], -1))
