"""Runs units of work in worker processes; what a unit does is up to its stage, and what is kept of it to shard_runner.py.

A worker that dies takes down its unit only. Nothing here decides a label: order, number of workers and restarts leave results unchanged.
"""

from __future__ import annotations

import multiprocessing.context
import os
import resource
import sys
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.util import Finalize
from types import ModuleType, TracebackType
from typing import Any

from pebble import ProcessExpired, ProcessPool

from tables.errors import PlaceBenchError

# One thread a worker: the units are the parallelism, and two BLAS threads a worker would fight for the same core.
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")
# Restarted after so many units, so that what an engine leaks stays bounded.
UNITS_PER_WORKER_LIFE = 2000
# Pools that broke one after the other before a unit was finished; then it is not bad luck any more.
MAX_RESTARTS = 3
# Starting a process changes the environment and the main module of this one for a moment, so starts take turns.
_ONE_START_AT_A_TIME = threading.Lock()


class WorkersError(PlaceBenchError, ValueError):
    """Workers that cannot be what was asked for; names the value and its bound."""


class WorkersDiedError(PlaceBenchError, RuntimeError):
    """Workers that die again and again before they finish a single unit."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one unit: a value, or the reason why there is none; CPU time spent, peak memory of its process so far."""

    index: int
    value: Any
    error: str | None
    core_ms: float
    peak_gib: float


class Workers:
    """Worker processes for as long as the block lasts: `with Workers(2) as workers: ... workers.run(function, units)`.

    One object serves any number of runs, one after the other; its processes start with the first of them and stay for the next. It belongs
    to one thread.

    Args:
        n_workers: processes; 0 runs the units in this process.
        units_per_life: units a process runs before a new one takes its place; 1 gives every unit a fresh process.
        preload: modules that are imported once, in the server that workers are forked from, instead of in every worker; if none is given,
            the module of the first function that is run. Python has one such server a process: it keeps what it was started with, and
            modules that later Workers need beyond that are imported in each worker.

    Raises:
        WorkersError: a number out of its bounds.
    """

    def __init__(self, n_workers: int, *, units_per_life: int = UNITS_PER_WORKER_LIFE, preload: Sequence[ModuleType] = ()) -> None:
        if n_workers < 0:
            raise WorkersError(f"n_workers is {n_workers}, must be >= 0 (0 runs the units in this process)")
        if units_per_life < 1:
            raise WorkersError(f"units_per_life is {units_per_life}, must be >= 1")
        self.n_workers, self.units_per_life = n_workers, units_per_life
        self._preload = tuple(module.__name__ for module in preload)
        self._is_open = False
        self._pool: ProcessPool | None = None
        self._end_pool: Callable[[], Any] = lambda: None
        # Units of the latest run that are in work, by future: whoever holds another dictionary is an older run.
        self._in_work: dict[Future[Any], int] = {}

    def __enter__(self) -> Workers:
        self._is_open = True
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._is_open = False
        self._end()

    def run(self, function: Callable[..., Any], units: Sequence[tuple[Any, ...]]) -> Generator[Outcome, None, None]:
        """Outcomes of `function(*unit)` for every unit, as they finish.

        A caller may stop early: units in work are ended when the generator is closed, with the next run, or with the block.

        Args:
            function: a module-level function, pure in its arguments.
            units: arguments, picklable.

        Yields:
            One outcome a unit; an exception or a dead worker is an outcome with `error` set.

        Raises:
            WorkersError: a function that workers cannot import.
            WorkersDiedError: workers that die before they finish anything.
            RuntimeError: a run outside the block, or one that goes on after another has begun.
        """
        self._check_open()
        if self.n_workers == 0:
            return self._run_here(function, units)
        if function.__module__ == "__main__":
            raise WorkersError(f"{function.__qualname__} is in __main__, must be in a module that a worker can import")
        return self._run_in_pool(function, units)

    def _run_here(self, function: Callable[..., Any], units: Sequence[tuple[Any, ...]]) -> Generator[Outcome, None, None]:
        for index, unit in enumerate(units):
            yield Outcome(index, *_timed(function, unit))

    def _run_in_pool(self, function: Callable[..., Any], units: Sequence[tuple[Any, ...]]) -> Generator[Outcome, None, None]:
        self._check_open()
        if self._in_work:
            self._end()
        in_work = self._in_work = {}
        to_do = deque(range(len(units)))
        n_broken = 0
        try:
            while to_do or in_work:
                try:
                    # A short queue: a worker never waits, and a killed run has lost little.
                    while to_do and len(in_work) < 3 * self.n_workers:
                        in_work[self._ready_pool(function).schedule(_timed, args=(function, units[to_do[0]]))] = to_do[0]
                        to_do.popleft()
                    outcomes = _finished(in_work)
                except RuntimeError as error:
                    # A worker died between two units, and the pool with it: what it had is given to another one.
                    self._end()
                    to_do.extendleft(sorted(in_work.values(), reverse=True))
                    in_work.clear()
                    n_broken += 1
                    if n_broken > MAX_RESTARTS:
                        times = f"{n_broken} times in a row, must be at most {MAX_RESTARTS}"
                        raise WorkersDiedError(f"workers died {times}: {error}") from error
                    continue
                for outcome in outcomes:
                    n_broken = 0
                    yield outcome
                    if self._in_work is not in_work:
                        raise RuntimeError("another run of these workers has begun, so this one cannot go on")
                    self._check_open()
        except BaseException:
            # An interrupt, or a caller that wants no more, ends the units in work instead of waiting for them.
            if self._in_work is in_work:
                self._end()
                in_work.clear()
            raise

    def _check_open(self) -> None:
        if not self._is_open:
            raise RuntimeError("workers run inside their block only: with Workers(n) as workers: ...")

    def _ready_pool(self, function: Callable[..., Any]) -> ProcessPool:
        """The pool that is there, or a new one."""
        if self._pool is None:
            context = _Context()
            context.set_forkserver_preload(list(self._preload or (function.__module__,)))
            self._pool = ProcessPool(self.n_workers, self.units_per_life, initializer=_limit_threads, context=context)
            # Not atexit: a process that multiprocessing started waits for its children before it gets there.
            self._end_pool = Finalize(self, _end, args=(self._pool,), exitpriority=100)
        return self._pool

    def _end(self) -> None:
        self._pool = None
        self._end_pool()


def run_units(
    function: Callable[..., Any],
    units: Sequence[tuple[Any, ...]],
    n_workers: int,
    units_per_life: int | None = None,
    preload: Sequence[ModuleType] = (),
) -> Generator[Outcome, None, None]:
    """`Workers.run` for a caller that runs once: workers of its own, which end with the last outcome or when the generator is closed."""
    life = UNITS_PER_WORKER_LIFE if units_per_life is None else units_per_life
    with Workers(n_workers, units_per_life=life, preload=preload) as workers:
        yield from workers.run(function, units)


class _Process(multiprocessing.context.ForkServerProcess):
    """A worker that inherits what a worker needs and nothing else; the server that it is forked from is started with the first one."""

    def start(self) -> None:
        with _ONE_START_AT_A_TIME, _without_main(), _with_one_thread():
            super().start()


class _Context(multiprocessing.context.ForkServerContext):
    Process = _Process


@contextmanager
def _without_main() -> Iterator[None]:
    """A child does not import its parent's main module again: Dagster's command line costs seconds, and nothing in it is needed."""
    main = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


@contextmanager
def _with_one_thread() -> Iterator[None]:
    """The environment that the server of the workers is started in: it loads numpy before any worker could say how many threads."""
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES if os.environ.get(name) != "1"}
    os.environ.update(dict.fromkeys(before, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _limit_threads() -> None:
    """In a worker, for what it loads itself; the server may have been started by somebody else."""
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))


def _end(pool: ProcessPool) -> None:
    pool.stop()
    pool.join()


def _finished(in_work: dict[Future[Any], int]) -> list[Outcome]:
    """Outcomes of the units that are finished, at least one; raises BrokenProcessPool where the workers were lost instead."""
    done, _ = wait(in_work, return_when=FIRST_COMPLETED)
    outcomes = [_outcome(in_work[future], future) for future in done]
    for future in done:
        del in_work[future]
    return outcomes


def _outcome(index: int, future: Future[Any]) -> Outcome:
    failure = future.exception()
    if failure is None:
        return Outcome(index, *future.result())
    if isinstance(failure, BrokenProcessPool):
        raise failure
    if isinstance(failure, ProcessExpired):
        return Outcome(index, None, f"worker died with exit code {failure.exitcode} (a crash in an engine)", 0.0, 0.0)
    # What never got to the worker or back, such as a value that cannot be pickled.
    return Outcome(index, None, f"{type(failure).__name__}: {failure}", 0.0, 0.0)


def _timed(function: Callable[..., Any], unit: tuple[Any, ...]) -> tuple[Any, str | None, float, float]:
    start = time.process_time_ns()
    value, error = None, None
    try:
        value = function(*unit)
    except Exception as failure:  # the edge: every failure of a unit becomes that unit's outcome
        error = f"{type(failure).__name__}: {failure}\n{traceback.format_exc(limit=-4)}"
    peak_gib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    return value, error, (time.process_time_ns() - start) / 1e6, peak_gib
