"""Makes a candidate's labels again, in a fresh process or under a change that ought not to matter, and compares them with the stored ones.

What the mismatches mean, and which tasks are repeated blindly, is decided in reports.repeatability.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass

import pyarrow as pa

from objects.object_model import ObjectModel
from pipelines.codecs import Row, plan_in
from pipelines.labels.execution import execute_perturbed
from pipelines.labels.planning import motion_of, planning_rows
from pipelines.recipe import Recipe
from pipelines.running.workers import UNITS_PER_WORKER_LIFE, run_units
from pipelines.values import Candidate
from tables.columns import TableSchema
from tables.errors import PlaceBenchError
from tables.identity import order_key
from tables.schemas import EXECUTION_LABELS, PLANNING_LABELS
from tables.vocabulary import Perturbation


class RepeatError(PlaceBenchError, RuntimeError):
    """A repeat that could not be run; names the candidate and why."""


@dataclass(frozen=True, slots=True)
class Repeat:
    """One repeat of one candidate; `stored` is its row of `candidates`."""

    recipe: Recipe
    object_model: ObjectModel
    candidate: Candidate
    stored: Mapping[str, object]
    perturbation: Perturbation
    repeat: int


def choose_perturbed(candidates: pa.Table, seed: int, n: int) -> list[tuple[str, Perturbation]]:
    """Executed candidates to run again under every perturbation: of each category the same number, the ones that hash lowest.

    Args:
        candidates: table `candidates`.
        n: candidates in all, as far as there are enough.
    """
    executed: dict[str, list[str]] = {}
    for row in candidates.select(["candidate_id", "category", "exec_status"]).to_pylist():
        if row["exec_status"] is not None:
            executed.setdefault(row["category"], []).append(row["candidate_id"])
    chosen = [
        name
        for category in sorted(executed)
        for name in sorted(executed[category], key=lambda name: order_key(seed, "perturbed", name))[: -(-n // len(executed))]
    ]
    return [(name, kind) for name in chosen for kind in Perturbation if kind is not Perturbation.FRESH]


def attempt_rows(repeats: Sequence[Repeat], n_workers: int) -> Iterator[Row]:
    """Rows of `attempts`, as they finish.

    A plain repeat runs in a process of its own that has run nothing before; perturbed ones share workers, a second of start-up each
    would be most of their cost.

    Raises:
        RepeatError: a repeat failed or its process died.
    """
    fresh = [repeat for repeat in repeats if repeat.perturbation is Perturbation.FRESH]
    perturbed = [repeat for repeat in repeats if repeat.perturbation is not Perturbation.FRESH]
    for some, units_per_life in ((fresh, 1), (perturbed, UNITS_PER_WORKER_LIFE)):
        with closing(run_units(attempt_row, [(repeat,) for repeat in some], max(1, n_workers), units_per_life)) as outcomes:
            for outcome in outcomes:
                if outcome.error is not None:
                    raise RepeatError(f"{some[outcome.index].stored['candidate_id']}: {outcome.error}")
                yield outcome.value


def attempt_row(repeat: Repeat) -> Row:
    """Plan again and, where a plan is found, execute again from the stored post-lift state."""
    recipe, candidate, stored = repeat.recipe, repeat.candidate, repeat.stored
    label, plan_row = planning_rows(repeat.object_model, candidate, recipe.planning_setup)
    execution: Row = dict.fromkeys(EXECUTION_LABELS.names)
    if plan_row is not None:
        motion = motion_of(candidate, plan_in(plan_row), recipe.planning)
        execution = execute_perturbed(repeat.object_model, candidate, motion, repeat.perturbation, recipe.execution_setup)
    return {
        "candidate_id": candidate.candidate_id,
        "perturbation": repeat.perturbation.value,
        "repeat": repeat.repeat,
        "plan_status": label["plan_status"],
        "exec_status": execution["exec_status"],
        "final_position_error_m": execution["final_position_error_m"],
        "final_rotation_error_rad": execution["final_rotation_error_rad"],
        "plan_matches": label["plan_status"] == stored["plan_status"],
        "exec_matches": execution["exec_status"] == stored["exec_status"],
        "is_identical": _agrees(PLANNING_LABELS, label, stored) and _agrees(EXECUTION_LABELS, execution, stored),
    }


def _agrees(schema: TableSchema, fresh: Row, stored: Mapping[str, object]) -> bool:
    return all(fresh[name] == stored[name] for name in schema.names if name != "candidate_id")
