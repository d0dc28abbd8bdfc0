"""The profile of a stage names what its units spend their time in."""

from __future__ import annotations

import time
from pathlib import Path

from pipelines.data_root import DataRoot
from pipelines.layout import SceneLayout
from pipelines.profiles import largest_costs
from pipelines.recipe import Recipe
from pipelines.shard_runner import ShardInputs
from pipelines.stages import Stage, Unit, UnitResult
from tables.identity import scenes_of_shard
from tables.schemas import SPLITS
from tests.builders import can_kit


def _sleep_mostly(unit: Unit) -> UnitResult:
    time.sleep(0.01)
    return UnitResult({"splits": []}, [])


def test_the_largest_cost_is_named_with_its_share(tmp_path: Path) -> None:
    kit = can_kit()
    layouts = [SceneLayout(scene_id, kit.object_id, "can", 0) for scene_id in scenes_of_shard("mini-000")]
    inputs = ShardInputs(Recipe(), {kit.object_id: kit}, layouts, "objects")
    stage = Stage("sleep", "1", (), (SPLITS,), ("camera",), _sleep_mostly)
    ((name, share),) = largest_costs(stage, "mini-000", DataRoot(tmp_path), inputs, n_units=4, n_costs=1)
    assert "sleep" in name
    assert 0.8 < share <= 1.0
