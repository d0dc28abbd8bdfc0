"""The profile of a stage names what its units spend their time in."""

from __future__ import annotations

import time
from pathlib import Path

from pipelines.proofs.cpu_profile import largest_costs
from pipelines.recipe import Recipe
from pipelines.running.data_root import DataRoot
from pipelines.running.shard_runner import ShardInputs
from pipelines.stage import Unit, UnitResult
from pipelines.values import SceneAllocation
from tables.layout import INTERLEAVED
from tests.builders import can_model, made_up_stage


def _sleep_mostly(unit: Unit) -> UnitResult:
    time.sleep(0.01)
    return UnitResult({"splits": []}, [])


def test_the_largest_cost_is_named_with_its_share(tmp_path: Path) -> None:
    object_model = can_model()
    allocations = [SceneAllocation(scene_id, object_model.object_id, "can", 0) for scene_id in INTERLEAVED.scenes_of_shard("mini-000")]
    inputs = ShardInputs(Recipe(), {object_model.object_id: object_model}, allocations, {})
    stage = made_up_stage(_sleep_mostly)
    ((name, share),) = largest_costs(stage, "mini-000", DataRoot(tmp_path), inputs, n_units=4, n_costs=1)
    assert "sleep" in name
    assert 0.8 < share <= 1.0
