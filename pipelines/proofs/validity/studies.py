"""All studies of the engine, in the order in which they run; a new one is a function from a subject to a Study, here by its name."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from pipelines.proofs.validity.criteria import BESIDE, CRITERIA, measured_by
from pipelines.proofs.validity.flips import flips_study
from pipelines.proofs.validity.hold_creep import creep_elsewhere_study, creep_study
from pipelines.proofs.validity.lifts import lifts_study
from pipelines.proofs.validity.loads import loads_study
from pipelines.proofs.validity.pull_out import pull_out_study, torsion_study
from pipelines.proofs.validity.running import StudyResult, run_study
from pipelines.proofs.validity.second_opinion import second_engine_study
from pipelines.proofs.validity.study import Study
from pipelines.proofs.validity.subject import Subject
from pipelines.running.workers import Workers
from tables.errors import PlaceBenchError

Makers = Mapping[str, Callable[[Subject], Study]]

STUDIES: Makers = {
    "hold_creep": creep_study,
    "hold_creep_elsewhere": creep_elsewhere_study,
    "pull_out": pull_out_study,
    "torsion": torsion_study,
    "loads": loads_study,
    "flips": flips_study,
    "lifts": lifts_study,
    "second_engine": second_engine_study,
}


@dataclass(frozen=True, slots=True)
class StudyProgress:
    """How far all studies are: the one in work, its units done and in all, and about what share of the whole is done."""

    study: str
    done: int
    total: int
    share: float


def run_studies(
    subject: Subject,
    folder: Path,
    made_from: Mapping[str, str],
    n_workers: int,
    on_progress: Callable[[StudyProgress], None] = lambda _: None,
    makers: Makers = STUDIES,
) -> list[StudyResult]:
    """Run what is missing of every study; one that cannot be made or finished is among the results with its problem.

    Args:
        folder: of the files that keep the rows.
        made_from: what decides every row besides its unit: hashes of code, parameters, release and engines.
        n_workers: worker processes; 0 stays in this process. Rows do not depend on it.
        makers: of the studies that run, by their names.
    """
    made = [_made(name, maker, subject) for name, maker in makers.items()]
    costs = [len(one.units) * one.unit_ms if isinstance(one, Study) else 0.0 for one in made]
    whole = sum(costs) or 1.0
    results = []
    with Workers(n_workers, preload=(sys.modules[__name__],)) as workers:
        for k, study in enumerate(made):
            if isinstance(study, StudyResult):
                results.append(study)
                continue

            def tell(done: int, total: int, study: Study = study, before: float = sum(costs[:k])) -> None:
                on_progress(StudyProgress(study.name, done, total, (before + done * study.unit_ms) / whole))

            results.append(run_study(study, folder / f"{study.name}.jsonl", made_from, workers, tell))
    return results


def _made(name: str, maker: Callable[[Subject], Study], subject: Subject) -> Study | StudyResult:
    try:
        return maker(subject)
    except (PlaceBenchError, LookupError, ValueError) as error:  # a release without a table, a value that does not fit
        return StudyResult(name, problem=f"{type(error).__name__}: {error}")


def numbers_of(results: Sequence[StudyResult], subject: Subject) -> dict[str, float | None]:
    """A number for every key that these studies measure, criteria and what is reported beside them, and every count; None for what failed.

    Faults are those that a release can hold (an admitted grasp without a lift, a plan without an execution: a stage whose engine gave up
    publishes nothing, so a release of such a tier cannot be made by its own command) and those of the studies' own runs.
    """
    measured: dict[str, float | None] = {}
    for result in results:
        measured |= result.numbers
    stored, n_stored = _stored_faults(subject)
    seen = sum(len(result.faults) for result in results)
    measured |= {
        "solver_faults": float(stored + seen),
        "n_solver_faults": float(n_stored + sum(result.n_runs for result in results)),
    }
    own = measured_by((*CRITERIA, *BESIDE), {result.name for result in results})
    keys = dict.fromkeys(name for criterion in own for name in (criterion.key, criterion.count_key))
    return {key: measured.get(key, 0.0 if key.startswith("n_") else None) for key in keys}


def _stored_faults(subject: Subject) -> tuple[int, int]:
    """Admitted grasps and planned candidates whose run is missing in the release, and how many of both there are."""
    rows: list[Mapping[str, object]] = [row for grasps in subject.values.grasp_rows.values() for row in grasps]
    lifts = [row["lift_status"] for row in rows if row["admission_status"] == "admitted"]
    planned = subject.candidates.select(["y_plan", "exec_status"]).to_pylist()
    runs = [row["exec_status"] for row in planned if row["y_plan"]]
    return lifts.count(None) + runs.count(None), len(lifts) + len(runs)
