"""The order of the chain from scenes to labels, nothing else: a new stage is a module of its own and one name here."""

from __future__ import annotations

from pipelines.candidates import pairing, policy_features
from pipelines.grasps import admission, pick_lift
from pipelines.labels import execution, planning
from pipelines.scenes import points, sampling

STAGES = (
    sampling.STAGE,
    points.STAGE,
    admission.STAGE,
    pick_lift.STAGE,
    pairing.STAGE,
    policy_features.STAGE,
    planning.STAGE,
    execution.STAGE,
)
STAGE = {stage.name: stage for stage in STAGES}
