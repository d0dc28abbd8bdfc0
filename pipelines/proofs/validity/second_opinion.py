"""The study of the other engine: the same candidates executed by MuJoCo and by PyBullet, both with the same rigid pads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

from pipelines.codecs import Row
from pipelines.proofs.validity.second_engine import choose, opinion, summary
from pipelines.proofs.validity.study import Numbers, Study, StudyUnit
from pipelines.proofs.validity.subject import Case, Subject


def second_engine_study(subject: Subject) -> Study:
    """Executed cans and cuboids, a third each that the labels call success, lost on the way and missed."""
    chosen = choose(subject.candidates, subject.recipe.seed, subject.sizes.n_second_engine)
    units = tuple(StudyUnit(one.candidate_id, (subject.case(one.candidate_id),)) for one in chosen)
    # Weights are of the sample, so that rows stay what they are in a larger one.
    weights = {one.candidate_id: one.weight for one in chosen}
    return Study("second_engine", units, opinion_row, partial(opinion_summary, weights=weights), unit_ms=1700.0)


def opinion_row(case: Case) -> Row:
    """How both engines say the candidate ends."""
    return opinion(case.object_model, case.candidate, case.motion(), case.recipe.execution_setup)


def opinion_summary(rows: Sequence[Row], weights: Mapping[str, float]) -> Numbers:
    """Agreement and kappa, as they are and weighted to the tier; nothing where there is no row.

    Args:
        weights: how many executed candidates each candidate stands for.
    """
    return summary(rows, weights) if rows else {}
