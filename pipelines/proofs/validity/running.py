"""Runs what is missing of a study and keeps every row as it finishes; what a row is, the study says."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

from pipelines.codecs import Row
from pipelines.proofs.validity.kept_rows import KeptRows
from pipelines.proofs.validity.study import FAULT, Numbers, Study, measured
from pipelines.running.workers import Workers


@dataclass(frozen=True, slots=True)
class StudyResult:
    """What became of a study.

    Attributes:
        rows: of all units that gave one, in the study's order; those with a fault too.
        numbers: by key; empty where the study could not be finished.
        problem: why it could not, "" where it could.
        n_runs: of the engine, those with a fault too.
        core_s: spent in this run.
    """

    name: str
    rows: tuple[Row, ...] = ()
    numbers: Numbers = field(default_factory=dict)
    problem: str = ""
    n_runs: int = 0
    core_s: float = 0.0

    @property
    def faults(self) -> tuple[str, ...]:
        """What the engine said of the runs that it gave no result for."""
        return tuple(row[FAULT] for row in self.rows if FAULT in row)


def run_study(
    study: Study, path: Path, made_from: Mapping[str, str], workers: Workers, on_unit: Callable[[int, int], None] = lambda done, total: None
) -> StudyResult:
    """Measure the units whose rows are not kept yet, and sum up.

    Args:
        path: of the file that keeps the rows.
        made_from: what decides every row besides its unit.
        on_unit: called with the units done, kept ones too, and all of them, at the start and after every unit.

    Returns:
        A result with a problem where a unit failed by anything but the engine, or where the rows cannot be summed up.
    """
    errors: list[str] = []
    core_ms = 0.0
    with KeptRows(path, {"study": study.name, **made_from}) as kept:
        missing = [unit for unit in study.units if unit.key not in kept.rows]
        n_done = len(study.units) - len(missing)
        on_unit(n_done, len(study.units))
        with closing(workers.run(measured, [(study.measure, unit.arguments) for unit in missing])) as outcomes:
            for outcome in outcomes:
                key = missing[outcome.index].key
                if outcome.error is None:
                    kept.add(key, outcome.value)
                else:
                    errors.append(f"{key}: {outcome.error.strip().splitlines()[0]}")
                core_ms += outcome.core_ms
                n_done += 1
                on_unit(n_done, len(study.units))
        if not errors:
            kept.put_in_order([unit.key for unit in study.units])
        rows = tuple(kept.rows[unit.key] for unit in study.units if unit.key in kept.rows)
    return _result(study, rows, sorted(errors), core_ms / 1e3)


def _result(study: Study, rows: tuple[Row, ...], errors: list[str], core_s: float) -> StudyResult:
    numbers: Numbers = {}
    problem = f"{len(errors)} of {len(study.units)} units failed, must be 0: {errors[0]}" if errors else ""
    if not study.units:
        problem = "nothing of this tier can be measured: 0 units, must be at least 1"
    sound = [row for row in rows if FAULT not in row]
    if not problem and not sound:
        problem = f"the engine gave no result for any of {len(rows)} units"
    if not problem:
        numbers = study.summary(sound)
    return StudyResult(study.name, rows, numbers, problem, len(rows) if study.runs_engine else 0, core_s)
