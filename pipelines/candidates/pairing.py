"""Every lifted grasp with every target of its scene; what becomes of a candidate is planning_labels' and execution_labels'."""

from __future__ import annotations

from collections.abc import Sequence

from pipelines.codecs import Row
from pipelines.scenes.allocation import SceneAllocation
from pipelines.values import LiftedGrasp, Scene
from tables.identity import candidate_id_of


def candidate_pair_rows(allocation: SceneAllocation, scene: Scene, lifted: Sequence[LiftedGrasp]) -> list[Row]:
    """Rows of `candidate_pairs` of one scene: the product, nothing left out, ids made of coordinates and so stable for ever."""
    return [
        {
            "candidate_id": candidate_id_of(scene.scene_id, target.target_id, grasp.grasp_id),
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
