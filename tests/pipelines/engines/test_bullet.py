"""PyBullet is imported without the line about its build, in workers too; nothing else that is written meanwhile is lost."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from pipelines.engines.bullet import _without_build_line

WORKER = """
import pipelines.pictures.renderer
from pipelines.engines.physics import world
from pipelines.running.workers import Workers

if __name__ == "__main__":
    with Workers(1) as workers:
        outcomes = list(workers.run(world.PhysicsWorld, [()]))
    assert "missing" in outcomes[0].error  # it was imported there
"""


def test_neither_a_process_nor_its_workers_say_when_pybullet_was_built() -> None:
    ended = subprocess.run([sys.executable, "-c", WORKER], capture_output=True, text=True, check=True)
    assert (ended.stdout, ended.stderr) == ("", "")


def test_what_else_is_written_meanwhile_is_kept(capfd: pytest.CaptureFixture[str]) -> None:
    with _without_build_line():
        os.write(2, b"a warning\npybullet build time: Jan 1 2000\nanother\n")
    os.write(2, b"after\n")
    assert capfd.readouterr().err == "a warning\nanother\nafter\n"
