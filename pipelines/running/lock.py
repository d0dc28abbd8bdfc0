"""One builder at a time: a lock on a shard, the object tables or a tier, held by one process and free again however that process ends.

The operating system keeps the lock (flock) for as long as its owner lives, so a killed build leaves nothing that has to be removed. The
lock file says who the owner is; it stays, empty, when the lock is free.
"""

from __future__ import annotations

import fcntl
import json
import logging
import os
import platform
import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from typing import BinaryIO

import psutil

from tables.errors import PlaceBenchError

LOG = logging.getLogger(__name__)

_MAX_COMMAND = 120  # characters of a command line that are shown


class LockError(PlaceBenchError, RuntimeError):
    """What is to be built is being built by somebody else, or cannot be locked; names the owner and what to do."""


@dataclass(frozen=True, slots=True)
class Owner:
    """The process that holds a lock, as it describes itself in the lock file; `started_s` tells it from a later one with its number."""

    pid: int
    started_s: float
    host: str
    command: str
    since: str

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host} ({self.command}) since {self.since}"

    def is_alive(self) -> bool:
        """Whether the process still runs; of another host nothing is known, so its processes count as alive."""
        if self.host != platform.node():
            return True
        try:
            started_s = float(psutil.Process(self.pid).create_time())
        except psutil.Error:
            return False
        return abs(started_s - self.started_s) < 2.0  # clocks are set while processes run


@contextmanager
def locked(path: Path, what: str) -> Iterator[None]:
    """Hold the lock file at `path` for as long as the block lasts.

    Args:
        path: the lock file, see data_root.py; made if missing.
        what: what is locked, in words, for example "shard mini-000".

    Raises:
        LockError: somebody else holds it, in this process or another one. Nobody waits: two builds of one thing are a mistake.
    """
    with _opened(path, what) as handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise LockError(_refusal(_owner_in(handle), path, what)) from None
        except OSError as error:
            raise LockError(f"{what}: {path} cannot be locked: {error.strerror}") from error
        # A forked child would keep the lock beyond its parent's end. There is no way to take this back, so it stays, at no cost.
        os.register_at_fork(after_in_child=handle.close)
        if _content(handle):
            LOG.warning("%s: lock of %s, which is gone, taken over", what, _owner_in(handle) or "a process that left no name")
        try:
            _write(handle, json.dumps(asdict(_this_process())).encode())
            yield
        finally:
            if not handle.closed:  # it is in a forked child
                _write(handle, b"")


def _refusal(owner: Owner | None, path: Path, what: str) -> str:
    if owner is None or not owner.is_alive():
        return f"{what} is being built by a process that has only just begun; wait until it has ended (lock file {path})"
    if owner.pid == os.getpid():
        return f"{what} is being built by this process already, since {owner.since} (lock file {path})"
    return f"{what} is being built by {owner}; wait until it has ended, or end it with `kill {owner.pid}` (lock file {path})"


def _this_process() -> Owner:
    process = psutil.Process()
    command = " ".join(shlex.join(process.cmdline()).split())
    shown = command if len(command) <= _MAX_COMMAND else f"{command[: _MAX_COMMAND - 3]}..."
    return Owner(process.pid, process.create_time(), platform.node(), shown, datetime.now().astimezone().isoformat(timespec="seconds"))


def _opened(path: Path, what: str) -> BinaryIO:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # Unbuffered, and nothing is cut off before the lock is held: until then what is in it belongs to somebody else.
        return path.open("a+b", buffering=0)
    except OSError as error:
        raise LockError(f"{what}: {path} cannot be locked: {error.strerror}") from error


def _content(handle: BinaryIO) -> bytes:
    handle.seek(0)
    return handle.read()


def _write(handle: BinaryIO, content: bytes) -> None:
    handle.truncate(0)
    handle.write(content)


def _owner_in(handle: BinaryIO) -> Owner | None:
    """Who the lock file names; None where it names nobody, as in the moment between locking and writing."""
    try:
        return Owner(**json.loads(_content(handle)))
    except (ValueError, TypeError):
        return None
