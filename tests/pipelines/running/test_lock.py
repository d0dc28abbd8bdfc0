"""Two real processes never hold one lock; whoever dies with it, in whatever way, leaves it free."""

from __future__ import annotations

import json
import logging
import os
import platform
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path

import psutil
import pytest

from pipelines.running.data_root import DataRoot
from pipelines.running.lock import LockError, Owner, locked
from tables.errors import PlaceBenchError

ROOT = Path(__file__).parents[3]
WHAT = "shard mini-000"

# Holds the lock, says so, and then does what is asked.
_BUILDER = """
import os, sys, time
from pathlib import Path
from pipelines.running.lock import locked
def say(word): print(word, flush=True)
def main():
    with locked(Path({path!r}), {what!r}):
        {then}
main()
"""
_HOLD = "say('held'); time.sleep(120)"


@pytest.fixture
def lock(tmp_path: Path) -> Path:
    return DataRoot(tmp_path).shard_lock("mini-000")


@pytest.fixture
def start(lock: Path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Starts a builder in a process of its own and waits for its first word."""
    started: list[subprocess.Popen[str]] = []

    def start(then: str = _HOLD) -> subprocess.Popen[str]:
        program = _BUILDER.format(path=str(lock), what=WHAT, then=textwrap.indent(textwrap.dedent(then), " " * 8).strip())
        environment = os.environ | {"PYTHONPATH": str(ROOT)}
        builder = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True, env=environment, cwd=ROOT)
        started.append(builder)
        assert builder.stdout is not None
        assert builder.stdout.readline() == "held\n"
        return builder

    yield start
    for builder in started:
        builder.kill()
        builder.wait()
        assert builder.stdout is not None
        builder.stdout.close()


def _refusal(lock: Path) -> str:
    with pytest.raises(LockError) as refusal, locked(lock, WHAT):
        pass
    assert "\n" not in str(refusal.value)
    return str(refusal.value)


def _is_free(lock: Path) -> bool:
    with locked(lock, WHAT):
        return True


def test_a_second_builder_is_refused_at_once_and_told_who_the_first_is(lock: Path, start: Callable[..., subprocess.Popen[str]]) -> None:
    builder = start()
    begin = time.monotonic()
    message = _refusal(lock)
    assert time.monotonic() - begin < 1.0
    assert message.startswith(f"{WHAT} is being built by process {builder.pid} on {platform.node()} ({sys.executable} -c")
    assert time.strftime(" since %Y-%m-%dT") in message
    assert f"`kill {builder.pid}`" in message
    assert str(lock) in message
    assert len(message) < 500
    assert _refusal(lock) == message, "a refusal changed the lock file"


def test_a_lock_is_taken_over_from_a_killed_builder_with_one_log_line(
    lock: Path, start: Callable[..., subprocess.Popen[str]], caplog: pytest.LogCaptureFixture
) -> None:
    builder = start()
    _refusal(lock)
    builder.send_signal(signal.SIGKILL)
    builder.wait()
    caplog.set_level(logging.INFO)
    with locked(lock, WHAT):
        assert len(caplog.records) == 1
        assert caplog.messages[0].startswith(f"{WHAT}: lock of process {builder.pid} on {platform.node()}")
        assert caplog.messages[0].endswith("which is gone, taken over")
        assert json.loads(lock.read_text())["pid"] == os.getpid()
    caplog.clear()
    assert _is_free(lock)
    assert not caplog.records, "a lock that was given back is nobody's to take over"


@pytest.mark.parametrize(
    "then",
    [
        "say('held'); pid = os.fork()\nif pid == 0: time.sleep(120)\ntime.sleep(120)",
        "import subprocess; subprocess.Popen(['sleep', '120'], stdout=subprocess.DEVNULL); say('held'); time.sleep(120)",
        """\
        from pipelines.running.workers import Workers
        from tests.pipelines.running.units import pid_after
        with Workers(2) as workers:
            for outcome in workers.run(pid_after, [(0, 0.0), *[(k, 120.0) for k in range(4)]]):
                say('held')
        """,
    ],
    ids=["forked", "started", "workers"],
)
def test_children_that_outlive_a_killed_builder_do_not_keep_its_lock(
    then: str, lock: Path, start: Callable[..., subprocess.Popen[str]]
) -> None:
    builder = start(then)
    children = _wait_for_children(builder)
    _refusal(lock)
    builder.send_signal(signal.SIGKILL)
    builder.wait()
    assert any(child.is_running() for child in children)
    assert _is_free(lock)
    for child in children:
        if child.is_running():
            child.kill()


def _wait_for_children(builder: subprocess.Popen[str]) -> list[psutil.Process]:
    end = time.monotonic() + 20.0
    while not (children := psutil.Process(builder.pid).children(recursive=True)):
        assert time.monotonic() < end
        time.sleep(0.05)
    time.sleep(0.2)  # a forked child closes its copy as its first act
    return children


@pytest.mark.parametrize(
    ("then", "ending", "code"),
    [
        ("say('held')", None, 0),
        ("say('held'); raise ValueError('an engine fails')", None, 1),
        ("say('held'); sys.exit(3)", None, 3),
        (_HOLD, signal.SIGINT, -signal.SIGINT),
        (_HOLD, signal.SIGTERM, -signal.SIGTERM),
        ("say('held'); os._exit(4)", None, 4),
    ],
    ids=["end", "exception", "exit", "interrupt", "SIGTERM", "os._exit"],
)
def test_a_lock_is_free_after_every_end_of_its_owner(
    then: str, ending: signal.Signals | None, code: int, lock: Path, start: Callable[..., subprocess.Popen[str]]
) -> None:
    builder = start(then)
    if ending is not None:
        builder.send_signal(ending)
    assert builder.wait(20) == code
    assert _is_free(lock)


def test_a_lock_that_was_given_back_names_nobody(lock: Path) -> None:
    with locked(lock, WHAT):
        assert json.loads(lock.read_text())["pid"] == os.getpid()
    assert lock.read_bytes() == b""


def test_the_same_process_is_refused_too(lock: Path) -> None:
    with locked(lock, WHAT):
        assert "is being built by this process already, since " in _refusal(lock)
        assert "is being built by this process already, since " in _refusal(lock)
    assert _is_free(lock)


def test_a_forked_child_neither_frees_nor_keeps_the_lock_of_its_parent(lock: Path) -> None:
    with locked(lock, WHAT):
        child = os.fork()
        if child == 0:
            try:
                with locked(lock, WHAT):
                    os._exit(1)
            except LockError:
                os._exit(0)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
        assert "this process already" in _refusal(lock)
        child = os.fork()
        if child == 0:
            time.sleep(60.0)
            os._exit(0)
        time.sleep(0.2)
    assert _is_free(lock)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)


def test_a_forked_child_that_leaves_the_block_leaves_the_lock_alone(lock: Path) -> None:
    with locked(lock, WHAT):
        record, parent, child = lock.read_bytes(), os.getpid(), None
        try:
            with locked(lock.with_name("other"), "another shard"):
                child = os.fork()
                if child == 0:
                    raise KeyError("the child fails")
        except KeyError:
            os._exit(7)
        finally:
            if os.getpid() != parent:
                os._exit(8)  # leaving the block raised something else
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
        assert lock.read_bytes() == record
        assert "this process already" in _refusal(lock)


def test_locks_of_different_things_are_independent(tmp_path: Path) -> None:
    root = DataRoot(tmp_path)
    with (
        locked(root.shard_lock("full-000"), "shard full-000"),
        locked(root.shard_lock("full-001"), "shard full-001"),
        locked(root.objects_lock(), "object tables"),
    ):
        assert "shard full-001 is being built" in _refused(root.shard_lock("full-001"), "shard full-001")
    assert _is_free(root.objects_lock())


def _refused(lock: Path, what: str) -> str:
    with pytest.raises(LockError) as refusal, locked(lock, what):
        pass
    return str(refusal.value)


@pytest.mark.parametrize("content", ["", "garbage", "[]", '{"pid": 1}', "\0" * 50])
def test_what_a_lock_file_says_cannot_stop_a_build(content: str, lock: Path, caplog: pytest.LogCaptureFixture) -> None:
    lock.parent.mkdir(parents=True)
    lock.write_text(content)
    assert _is_free(lock)
    assert len(caplog.records) == (1 if content else 0)
    assert lock.read_bytes() == b""


def test_a_number_that_now_belongs_to_another_process_is_no_owner(lock: Path, caplog: pytest.LogCaptureFixture) -> None:
    started_s = psutil.Process().create_time()
    mine = Owner(os.getpid(), started_s, platform.node(), "python", "2026-01-01T00:00:00+00:00")
    earlier = Owner(os.getpid(), started_s - 3600.0, platform.node(), "python", "2026-01-01T00:00:00+00:00")
    ended = subprocess.Popen(["true"])
    ended.wait()
    gone = Owner(ended.pid, started_s, platform.node(), "true", "2026-01-01T00:00:00+00:00")
    elsewhere = Owner(ended.pid, started_s, "another-host", "true", "2026-01-01T00:00:00+00:00")
    assert [owner.is_alive() for owner in (mine, earlier, gone, elsewhere)] == [True, False, False, True]
    lock.parent.mkdir(parents=True)
    lock.write_text(json.dumps(asdict(earlier)))
    assert _is_free(lock)
    assert f"lock of process {os.getpid()}" in caplog.messages[0]


def test_a_refusal_does_not_name_a_dead_process(lock: Path, start: Callable[..., subprocess.Popen[str]]) -> None:
    """In the moment between locking and writing its name, a builder's lock file still names the one before."""
    start()
    record = json.loads(lock.read_text())
    lock.write_text(json.dumps(record | {"started_s": record["started_s"] - 3600.0}))
    assert "by a process that has only just begun" in _refusal(lock)
    lock.write_text("")
    assert "by a process that has only just begun" in _refusal(lock)


def test_what_cannot_be_locked_says_so(tmp_path: Path) -> None:
    (tmp_path / "shards").write_text("a file in the place of a folder")
    with pytest.raises(LockError, match=r"shard mini-000: .*\.lock cannot be locked: "):
        _is_free(DataRoot(tmp_path).shard_lock("mini-000"))
    folder = DataRoot(tmp_path).objects_lock()
    folder.mkdir(parents=True)
    with pytest.raises(PlaceBenchError, match="cannot be locked: Is a directory"):
        _is_free(folder)
