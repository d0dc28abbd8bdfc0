"""Units that tests hand to workers, and what they ask about processes; a worker must be able to import them."""

from __future__ import annotations

import os
import signal
import time

import numpy as np
import psutil

from pipelines.running.workers import THREAD_VARIABLES, Workers


def square_or_fail(k: int) -> int:
    """k squared; 3 raises, 5 kills its process."""
    if k == 3:
        raise ValueError(f"unit {k} is 3, must be another")
    if k == 5:
        os.kill(os.getpid(), signal.SIGSEGV)
    return k * k


def pid_after(k: int, seconds: float = 0.05) -> int:
    """The number of the process that runs the unit."""
    time.sleep(seconds)
    return os.getpid()


def pids_of(workers: Workers, n_units: int = 8) -> list[int]:
    """The processes that ran some units, all of which succeeded."""
    outcomes = list(workers.run(pid_after, [(k,) for k in range(n_units)]))
    assert sorted(outcome.index for outcome in outcomes) == list(range(n_units))
    assert all(outcome.error is None for outcome in outcomes)
    return [outcome.value for outcome in outcomes]


def kill(pid: int) -> None:
    """End a process at once and wait until the system has noticed."""
    os.kill(pid, signal.SIGKILL)
    time.sleep(0.5)


def wait_until_gone(pid: int) -> None:
    """A process must end within 20 seconds."""
    end = time.monotonic() + 20.0
    while psutil.pid_exists(pid) and psutil.Process(pid).status() != psutil.STATUS_ZOMBIE:
        assert time.monotonic() < end, f"process {pid} is alive after 20 s"
        time.sleep(0.1)


def thread_limits() -> tuple[list[str | None], int]:
    """The variables as this process sees them, and its threads after a product that BLAS would spread over all cores."""
    np.ones((500, 500)) @ np.ones((500, 500))
    return [os.environ.get(name) for name in THREAD_VARIABLES], psutil.Process().num_threads()


def threads_of(workers: Workers) -> tuple[list[str | None], int]:
    """What `thread_limits` says in a worker."""
    (outcome,) = workers.run(thread_limits, [()])
    assert outcome.error is None
    return outcome.value
