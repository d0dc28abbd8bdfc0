"""A study that simulates nothing: rows that follow from a number, and units that do what a test wants of them."""

from __future__ import annotations

import os
import signal
from collections.abc import Sequence
from pathlib import Path

from pipelines.codecs import Row
from pipelines.engines.physics.errors import PhysicsError
from pipelines.proofs.validity.study import Numbers, Study, StudyUnit


def made_up_study(n: int = 6, reverse: bool = False, log: Path | None = None, kill_at: int = -1) -> Study:
    """Squares of the first numbers; `log` gets a line a unit that is measured, and the process dies in unit `kill_at`."""
    units = [StudyUnit(f"unit {k}", (k, log, kill_at)) for k in range(n)]
    return Study("made_up", tuple(units[::-1] if reverse else units), square, total, unit_ms=1.0)


def square(k: int, log: Path | None, kill_at: int) -> Row:
    if k == kill_at:
        os.kill(os.getpid(), signal.SIGKILL)
    if log is not None:
        with log.open("a") as handle:
            handle.write(f"{k}\n")
    return {"k": k, "square": k * k / 7.0, "name": "µ", "none": None, "list": [0.1, k]}


def total(rows: Sequence[Row]) -> Numbers:
    return {"total": sum(row["square"] for row in rows)}


def give_up_on_odd(k: int, log: Path | None, kill_at: int) -> Row:
    if k % 2:
        raise PhysicsError(f"unit {k}: the state is not finite")
    return square(k, log, kill_at)


def fail_on_odd(k: int, log: Path | None, kill_at: int) -> Row:
    if k % 2:
        raise ValueError(f"{k} is odd")
    return square(k, log, kill_at)
