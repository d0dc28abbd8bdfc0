"""Every lifted grasp with every target of its scene; what becomes of a candidate is decided in labels/."""

from __future__ import annotations

import time
from collections.abc import Sequence

from pipelines import laws
from pipelines.codecs import Row
from pipelines.stage import Stage, Unit, UnitResult, timing_row
from pipelines.values import Candidate, LiftedGrasp, Scene, SceneAllocation
from tables.schemas import CANDIDATE_PAIRS, OBSTACLES, PICK_LIFT, SCENES, TARGETS


def candidate_pair_rows(allocation: SceneAllocation, scene: Scene, lifted: Sequence[LiftedGrasp]) -> list[Row]:
    """Rows of `candidate_pairs` of one scene: the product, nothing left out, ids made of coordinates and so stable for ever."""
    return [
        {
            "candidate_id": Candidate(scene, grasp, target).candidate_id,
            "scene_id": scene.scene_id,
            "target_id": target.target_id,
            "grasp_id": grasp.grasp_id,
            "object_id": allocation.object_id,
            "category": allocation.category,
            "n_obstacles": allocation.n_obstacles,
        }
        for target in scene.targets
        for grasp in lifted
    ]


def run(unit: Unit) -> UnitResult:
    """The candidates of one scene."""
    start = time.process_time_ns()
    rows = candidate_pair_rows(unit.allocation, unit.scene, unit.known.lifted)
    return UnitResult({"candidate_pairs": rows}, [timing_row("candidate_pairs", unit.item_id, start)])


STAGE = Stage(
    name="candidate_pairs",
    group="candidates",
    description="Pairs every lifted grasp with every target of its scene.",
    code_version="1",
    inputs=(SCENES, OBSTACLES, TARGETS, PICK_LIFT),
    objects=(),
    outputs=(CANDIDATE_PAIRS,),
    sections=(),
    engines=(),
    run=run,
    law=laws.candidate_pairs_law,
)
