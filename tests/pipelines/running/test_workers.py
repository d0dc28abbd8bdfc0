"""A unit that raises, dies or hangs on to nothing becomes its own outcome and the others are untouched; so are the runs of others."""

from __future__ import annotations

import os
import signal
import sys
import time
from contextlib import closing
from pathlib import Path

import psutil
import pytest

from pipelines.running.workers import THREAD_VARIABLES, Workers, WorkersDiedError, WorkersError, run_units
from tables.errors import PlaceBenchError
from tests.pipelines.running.units import kill, pid_after, pids_of, square_or_fail, threads_of, wait_until_gone


def test_results_do_not_depend_on_the_number_of_workers() -> None:
    units = [(k,) for k in (0, 1, 2, 4, 6, 7)]
    found = [{o.index: o.value for o in run_units(square_or_fail, units, n)} for n in (0, 1, 2)]
    assert found[0] == found[1] == found[2] == {i: u[0] ** 2 for i, u in enumerate(units)}


def test_a_raising_and_a_crashing_unit_leave_the_others_intact(two: Workers) -> None:
    outcomes = {o.index: o for o in two.run(square_or_fail, [(k,) for k in range(10)])}
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


def test_workers_serve_many_runs(two: Workers) -> None:
    first = set(pids_of(two))
    assert len(first) == 2
    assert os.getpid() not in first
    assert all(set(pids_of(two)) == first for _ in range(3))


def test_workers_end_with_their_block() -> None:
    with Workers(2) as workers:
        pids = set(pids_of(workers))
        assert all(psutil.pid_exists(pid) for pid in pids)
    assert not any(psutil.pid_exists(pid) for pid in pids)
    with pytest.raises(RuntimeError, match="inside their block only"):
        workers.run(pid_after, [(0,)])


def test_two_pools_do_not_know_of_each_other(one: Workers) -> None:
    (mine,) = set(pids_of(one))
    with Workers(1) as other:
        assert set(pids_of(other)) != {mine}
        assert set(pids_of(one)) == {mine}
    assert set(pids_of(one)) == {mine}


@pytest.mark.parametrize("units_per_life", [1, 3])
def test_a_worker_is_replaced_after_its_units(units_per_life: int) -> None:
    with Workers(1, units_per_life=units_per_life) as workers:
        pids = pids_of(workers, 6)
    assert [pids.count(pid) for pid in dict.fromkeys(pids)] == [units_per_life] * (6 // units_per_life)


def test_a_worker_that_dies_between_two_runs_is_replaced(one: Workers) -> None:
    (before,) = set(pids_of(one))
    kill(before)
    (after,) = set(pids_of(one))
    assert after != before


def test_a_worker_that_dies_between_two_units_costs_no_unit(one: Workers) -> None:
    with closing(one.run(pid_after, [(k,) for k in range(12)])) as outcomes:
        seen = [next(outcomes)]
        time.sleep(1.0)  # all units that were handed out are done, so the worker dies with nothing to do
        kill(seen[0].value)
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
    outcomes = {outcome.index: outcome for outcome in one.run(square_or_fail, units)}
    assert [outcomes[k].value for k in range(5)] == [0, 1, 16, 4, 36]
    assert (tmp_path / "received").exists()


def test_the_death_of_the_server_of_the_workers_costs_at_most_the_units_in_work(one: Workers) -> None:
    with closing(one.run(pid_after, [(k,) for k in range(12)])) as outcomes:
        seen = [next(outcomes)]
        kill(psutil.Process(seen[0].value).ppid())
        kill(seen[0].value)
        seen += outcomes
    assert sorted(outcome.index for outcome in seen) == list(range(12))
    assert len([outcome for outcome in seen if outcome.error]) <= 1
    assert threads_of(one) == (["1"] * len(THREAD_VARIABLES), 1)


def _only_here(k: int) -> int:
    return k


def test_workers_that_cannot_live_are_an_error_and_not_a_loop(one: Workers, monkeypatch: pytest.MonkeyPatch) -> None:
    """A function of a module that is known here and to no other process."""
    monkeypatch.setattr(_only_here, "__module__", "tests.no_such_module")
    monkeypatch.setitem(sys.modules, "tests.no_such_module", sys.modules[__name__])
    with pytest.raises(WorkersDiedError, match="workers died 4 times in a row"):
        list(one.run(_only_here, [(0,)]))


def test_who_stops_listening_ends_the_units_in_work_and_does_not_disturb_the_next_run(two: Workers) -> None:
    with closing(two.run(pid_after, [(0, 0.0), *((k, 60.0) for k in range(8))])) as outcomes:
        pid = next(outcomes).value
    wait_until_gone(pid)
    assert len(set(pids_of(two))) == 2


def test_an_error_of_who_listens_does_not_disturb_the_next_run(two: Workers) -> None:
    """The generator is still alive then, in the error's traceback; closing it late changes nothing either."""
    outcomes = two.run(pid_after, [(0, 0.0), *((k, 60.0) for k in range(8))])

    def listen() -> None:
        for _ in outcomes:
            raise KeyError("who listens fails")

    with pytest.raises(KeyError):
        listen()
    start = time.monotonic()
    later = two.run(pid_after, [(k,) for k in range(8)])
    first = next(later)
    outcomes.close()
    assert sorted(outcome.index for outcome in (first, *later)) == list(range(8))
    assert time.monotonic() - start < 30.0


def test_a_run_that_goes_on_after_another_has_begun_is_refused(two: Workers) -> None:
    earlier = two.run(pid_after, [(k,) for k in range(20)])
    next(earlier)
    assert len(pids_of(two)) == 8
    with pytest.raises(RuntimeError, match="another run of these workers has begun"):
        list(earlier)
    assert len(pids_of(two)) == 8


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
        list(run_units(square_or_fail, [], **how))
    assert issubclass(WorkersError, PlaceBenchError)
    assert issubclass(WorkersDiedError, PlaceBenchError)


def test_no_workers_run_units_in_this_process() -> None:
    with Workers(0) as workers:
        assert set(pids_of(workers, 2)) == {os.getpid()}
        assert "ValueError: unit 3" in (next(workers.run(square_or_fail, [(3,)])).error or "")
