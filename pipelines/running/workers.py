"""Runs units of work in worker processes; what a unit does is a stage's, what is kept of it is shard_runner's.

A worker that dies takes down its unit only. Nothing here decides a label: order, number of workers and restarts leave results unchanged.
"""

from __future__ import annotations

import multiprocessing
import multiprocessing.context
import os
import resource
import sys
import time
import traceback
import types
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.util import Finalize
from typing import Any

from pebble import ProcessExpired, ProcessPool

# One thread a worker: the units are the parallelism, and two BLAS threads a worker would fight for the same core.
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")
# Restarted after so many units, so that what an engine leaks stays bounded.
UNITS_PER_WORKER_LIFE = 2000
# The pool that waits for the next call.
_KEPT: dict[int, ProcessPool] = {}


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one unit: a value, or the reason why there is none; CPU time spent, peak memory of its process so far."""

    index: int
    value: Any
    error: str | None
    core_ms: float
    peak_gib: float


def run_units(
    function: Callable[..., Any], units: Sequence[tuple[Any, ...]], n_workers: int, units_per_life: int | None = None
) -> Generator[Outcome, None, None]:
    """Outcomes of `function(*unit)` for every unit, as they finish; close it (`contextlib.closing`) to stop early.

    Args:
        function: a module-level function, pure in its arguments.
        units: arguments, picklable.
        n_workers: processes; 0 runs the units in this process.
        units_per_life: units a worker runs before a new process takes its place; 1 gives every unit a fresh process. None keeps the
            workers for the next call.

    Yields:
        One outcome a unit; an exception or a dead worker is an outcome with `error` set.
    """
    if n_workers < 0:
        raise ValueError(f"n_workers is {n_workers}, must be >= 0")
    if n_workers == 0:
        for index, unit in enumerate(units):
            yield Outcome(index, *_timed(function, unit))
        return
    with _pool(n_workers, units_per_life) as pool:
        waiting: dict[Future[Any], int] = {}
        # A short queue: a worker never waits, and a killed run has lost little.
        for index, unit in enumerate(units):
            waiting[pool.schedule(_timed, args=(function, unit))] = index
            if len(waiting) >= 3 * n_workers:
                yield from _finished(waiting)
        while waiting:
            yield from _finished(waiting)


class _Process(multiprocessing.context.ForkServerProcess):
    """A worker that does not import its parent's main module again: Dagster's command line costs seconds, and nothing in it is needed."""

    def start(self) -> None:
        main = sys.modules["__main__"]
        sys.modules["__main__"] = types.ModuleType("__main__")
        try:
            super().start()
        finally:
            sys.modules["__main__"] = main


class _Context(multiprocessing.context.ForkServerContext):
    Process = _Process


@contextmanager
def _pool(n_workers: int, units_per_life: int | None) -> Iterator[ProcessPool]:
    pool = _kept_pool(n_workers) if units_per_life is None else _new_pool(n_workers, units_per_life)
    try:
        yield pool
    except BaseException:
        # An interrupt, or a caller that wants no more, ends the units in work instead of waiting for them.
        if _KEPT.get(n_workers) is pool:
            del _KEPT[n_workers]
        _end(pool)
        raise
    if units_per_life is not None:
        pool.close()
        pool.join()


def _kept_pool(n_workers: int) -> ProcessPool:
    """The pool of the last call, where it has as many workers and is alive: a shard has eight stages, and a start costs a second or two."""
    for n, pool in list(_KEPT.items()):
        if n != n_workers or not pool.active:
            _end(_KEPT.pop(n))
    if n_workers not in _KEPT:
        _KEPT[n_workers] = _new_pool(n_workers, UNITS_PER_WORKER_LIFE)
        # Not atexit: a process that multiprocessing started waits for its children before it gets there.
        Finalize(None, _end, args=(_KEPT[n_workers],), exitpriority=100)
    return _KEPT[n_workers]


def _new_pool(n_workers: int, units_per_life: int) -> ProcessPool:
    for name in THREAD_VARIABLES:
        os.environ[name] = "1"
    context = _Context()
    # Engines are imported once in the fork server instead of once in every worker.
    context.set_forkserver_preload(["pipelines.stages"])
    return ProcessPool(max_workers=n_workers, max_tasks=units_per_life, context=context)


def _end(pool: ProcessPool) -> None:
    pool.stop()
    pool.join()


def _finished(waiting: dict[Future[Any], int]) -> Iterator[Outcome]:
    done, _ = wait(waiting, return_when=FIRST_COMPLETED)
    for future in done:
        index = waiting.pop(future)
        try:
            yield Outcome(index, *future.result())
        except ProcessExpired as death:
            yield Outcome(index, None, f"worker died with exit code {death.exitcode} (a crash in an engine)", 0.0, 0.0)


def _timed(function: Callable[..., Any], unit: tuple[Any, ...]) -> tuple[Any, str | None, float, float]:
    start = time.process_time_ns()
    value, error = None, None
    try:
        value = function(*unit)
    except Exception as failure:  # the edge: every failure of a unit becomes that unit's outcome
        error = f"{type(failure).__name__}: {failure}\n{traceback.format_exc(limit=-4)}"
    peak_gib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    return value, error, (time.process_time_ns() - start) / 1e6, peak_gib
