"""What a study is: units of work that each give one row of plain numbers, and what the rows say together; running.py runs them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pipelines.codecs import Row
from pipelines.engines.physics.errors import PhysicsError
from tables.errors import PlaceBenchError

# Of a row that a run ended without a result: what the engine said.
FAULT = "fault"

# A number for each key; None where the rows cannot tell.
Numbers = Mapping[str, float | None]


class StudyError(PlaceBenchError, ValueError):
    """A study that cannot be made of its inputs; names the study, what was found and what it needs."""


@dataclass(frozen=True, slots=True)
class StudyUnit:
    """One unit of work: who it is, and what it is given (picklable). Rows are kept by `key`, so that it names all that decides a row."""

    key: str
    arguments: tuple[Any, ...]


@dataclass(frozen=True, slots=True)
class Study:
    """One test of the engine.

    Attributes:
        name: also of the file that keeps its rows.
        units: in the order in which `summary` sees their rows.
        measure: a module-level function from a unit's arguments to its row: numbers, texts, None and lists of them, by their arguments
            alone. A `PhysicsError` of it is a row as well, with the text under `fault`.
        summary: what the rows without a fault say; at least the criteria's keys that belong to this study.
        unit_ms: what a unit costs about, so that an end can be foretold.
        runs_engine: whether a unit simulates anything; stored rows are only read otherwise.
    """

    name: str
    units: tuple[StudyUnit, ...]
    measure: Callable[..., Row]
    summary: Callable[[Sequence[Row]], Numbers]
    unit_ms: float
    runs_engine: bool = True

    def __post_init__(self) -> None:
        keys = [unit.key for unit in self.units]
        if len(set(keys)) < len(keys):
            twice = next(key for key in keys if keys.count(key) > 1)
            raise StudyError(f"{self.name}: unit {twice} is there {keys.count(twice)} times, must be once")
        if not self.unit_ms > 0.0:
            raise StudyError(f"{self.name}: unit_ms = {self.unit_ms}, must be above 0")


def measured(measure: Callable[..., Row], arguments: tuple[Any, ...]) -> Row:
    """A unit's row, in a worker."""
    try:
        return measure(*arguments)
    except PhysicsError as error:
        return {FAULT: str(error)}
