"""A candidate of a release as a recording to be shown: its stored plan run again, or its rejection; pictures are pipelines.pictures'."""

from __future__ import annotations

from pipelines.decoded import Decoded
from pipelines.labels.planning import motion_of
from pipelines.pictures.recording import Recording, record_execution, record_rejection
from pipelines.recipe import Recipe
from reports.report import ReportError


def recording_of(release: Decoded, candidate_id: str, recipe: Recipe) -> Recording:
    """The recording of a candidate, with its stored labels and those of the run, which may be compared.

    Args:
        release: with objects, `scenes`, `obstacles`, `targets`, `grasps`, `candidates` and `plans`.
        recipe: what the labels were made with.

    Raises:
        ReportError: a candidate that is planned and has no plan.
    """
    candidate, stored, plan = release.candidate(candidate_id), release.labels(candidate_id), release.plan(candidate_id)
    object_model = release.object_model_of(candidate)
    if not stored["y_plan"]:
        return record_rejection(object_model, candidate, recipe.planning.release_height_m, stored)
    if plan is None:
        raise ReportError(f"{candidate_id}: is planned, but has no row in plans")
    return record_execution(object_model, candidate, motion_of(candidate, plan, recipe.planning), recipe.execution_setup, stored)
