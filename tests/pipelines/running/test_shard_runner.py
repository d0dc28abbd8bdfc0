"""What a shard costs when something goes wrong: only the failed scene, only once; and the table never depends on how it was made."""

from __future__ import annotations

import os
import random
import shutil
import signal
from importlib import metadata
from pathlib import Path

import pytest

from objects.object_model import ObjectModel
from pipelines.recipe import Recipe
from pipelines.running import shard_runner, unfinished
from pipelines.running.data_root import DataRoot
from pipelines.running.lock import LockError
from pipelines.running.shard_runner import Progress, ShardInputs, StageError, is_published, run_stage
from pipelines.stage import Stage, Unit, UnitResult
from pipelines.values import SceneAllocation
from tables.identity import rng_for
from tables.layout import INTERLEAVED
from tables.schemas import TIMINGS
from tables.sidecar import sidecar_path
from tables.store import read_table
from tests.builders import can_model, made_up_stage
from tests.split_rows import split_row

SHARD = "mini-000"
SCENES = INTERLEAVED.scenes_of_shard(SHARD)


def _draw(unit: Unit) -> UnitResult:
    scene_id = unit.allocation.scene_id
    name = ["train", "validation", "test"][int(rng_for(unit.seed, "draw", scene_id).integers(3))]
    rows = {"splits": [split_row(scene_id, name)]}
    return UnitResult(rows, [{"stage": "draw", "item_id": scene_id, "core_ms": 1.0}])


def _draw_but_crash(unit: Unit) -> UnitResult:
    if unit.allocation.scene_id == SCENES[4]:
        os.kill(os.getpid(), signal.SIGSEGV)
    if unit.allocation.scene_id == SCENES[7]:
        raise ValueError("volume 0.0 m3, must be above 0")
    return _draw(unit)


def _stage(run=_draw, version: str = "1", law=lambda tables, promise: []) -> Stage:
    return made_up_stage(run, version, law)


@pytest.fixture
def inputs() -> ShardInputs:
    object_model: ObjectModel = can_model()
    allocations = [SceneAllocation(scene_id, object_model.object_id, "can", 0) for scene_id in SCENES]
    return ShardInputs(Recipe(), {object_model.object_id: object_model}, allocations, {})


def test_table_is_the_same_for_any_number_of_workers_and_any_order(tmp_path: Path, inputs: ShardInputs) -> None:
    shuffled = ShardInputs(
        inputs.recipe, inputs.object_models, random.Random(1).sample(inputs.allocations, len(inputs.allocations)), inputs.object_hashes
    )
    runs = ((0, inputs), (1, inputs), (2, inputs), (2, shuffled))
    hashes = {
        run_stage(_stage(), SHARD, DataRoot(tmp_path / str(k)), some, n).sidecars["splits"].content_hash for k, (n, some) in enumerate(runs)
    }
    assert len(hashes) == 1


def test_an_unchanged_stage_is_reused_and_a_changed_one_is_not(tmp_path: Path, inputs: ShardInputs) -> None:
    root = DataRoot(tmp_path)
    assert not run_stage(_stage(), SHARD, root, inputs, 0).is_reused
    assert run_stage(_stage(), SHARD, root, inputs, 0).is_reused
    assert not is_published(_stage(version="2"), SHARD, root, inputs)
    assert not run_stage(_stage(version="2"), SHARD, root, inputs, 0).is_reused
    changed = ShardInputs(Recipe(seed=1), inputs.object_models, inputs.allocations, inputs.object_hashes)
    assert not run_stage(_stage(version="2"), SHARD, root, changed, 0).is_reused


def test_tables_of_another_engine_version_are_not_reused(tmp_path: Path, inputs: ShardInputs, monkeypatch: pytest.MonkeyPatch) -> None:
    root, stage = DataRoot(tmp_path), made_up_stage(_draw, engines=("numpy", "ompl"))
    made = run_stage(stage, SHARD, root, inputs, 0)
    assert made.sidecars["splits"].made_from["engine.numpy"] == metadata.version("numpy")
    assert run_stage(stage, SHARD, root, inputs, 0).is_reused
    real = metadata.version
    monkeypatch.setattr(metadata, "version", lambda name: "99.0" if name == "ompl" else real(name))
    assert not is_published(stage, SHARD, root, inputs)


def test_a_damaged_table_is_made_again(tmp_path: Path, inputs: ShardInputs) -> None:
    root = DataRoot(tmp_path)
    first = run_stage(_stage(), SHARD, root, inputs, 0).sidecars["splits"]
    path = root.shard_table(SHARD, "splits")
    path.write_bytes(path.read_bytes()[:-1] + b"x")
    again = run_stage(_stage(), SHARD, root, inputs, 0)
    assert not again.is_reused
    assert again.sidecars["splits"].content_hash == first.content_hash


@pytest.mark.parametrize("damage", ["garbage\n", "", "[1]", "{}", '{"table": 3}'])
def test_a_damaged_sidecar_is_told_and_made_again(tmp_path: Path, inputs: ShardInputs, damage: str) -> None:
    root, told = DataRoot(tmp_path), []
    first = run_stage(_stage(), SHARD, root, inputs, 0).sidecars["splits"]
    sidecar_path(root.shard_table(SHARD, "splits")).write_text(damage)
    assert not is_published(_stage(), SHARD, root, inputs)
    again = run_stage(_stage(), SHARD, root, inputs, 0, log=told.append)
    assert again.sidecars["splits"].content_hash == first.content_hash
    assert len(told) == 1
    assert told[0].startswith("splits of mini-000: ")
    assert told[0].endswith("; made again")


def test_a_shard_that_somebody_builds_is_refused_at_once(tmp_path: Path, inputs: ShardInputs) -> None:
    root, refused = DataRoot(tmp_path), []

    def meanwhile(progress: Progress) -> None:
        if progress.done == 1:
            with pytest.raises(LockError, match=r"shard mini-000 is being built by this process already") as error:
                run_stage(_stage(), SHARD, root, inputs, 0)
            refused.append(str(error.value))

    run_stage(_stage(), SHARD, root, inputs, 0, meanwhile)
    assert len(refused) == 1
    assert run_stage(_stage(), SHARD, root, inputs, 0).is_reused


def test_a_table_of_another_shard_does_not_count(tmp_path: Path, inputs: ShardInputs) -> None:
    """Made from the very same inputs, so only its owner tells it apart."""
    root = DataRoot(tmp_path)
    run_stage(_stage(), SHARD, root, inputs, 0)
    shutil.copytree(tmp_path / "shards" / SHARD, tmp_path / "shards" / "full-000")
    assert is_published(_stage(), SHARD, root, inputs)
    assert not is_published(_stage(), "full-000", root, inputs)


def test_a_crash_fails_its_scene_with_its_id_and_keeps_the_others(
    tmp_path: Path, inputs: ShardInputs, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = DataRoot(tmp_path)
    with pytest.raises(StageError, match="2 of 12 scenes failed") as failure:
        run_stage(_stage(_draw_but_crash), SHARD, root, inputs, 2)
    assert f"{SCENES[4]}: worker died" in str(failure.value)
    assert f"{SCENES[7]}: ValueError: volume 0.0 m3, must be above 0" in str(failure.value)
    assert not root.shard_table(SHARD, "splits").exists()

    made = []
    real = shard_runner.units_of_shard

    def noted(stage, inputs, upstream, allocations):
        made.extend(allocation.scene_id for allocation in allocations)
        return real(stage, inputs, upstream, allocations)

    monkeypatch.setattr(shard_runner, "units_of_shard", noted)
    resumed = run_stage(_stage(), SHARD, root, inputs, 0)
    assert sorted(made) == [SCENES[4], SCENES[7]]
    whole = run_stage(_stage(), SHARD, DataRoot(tmp_path / "whole"), inputs, 0)
    assert resumed.sidecars["splits"].content_hash == whole.sidecars["splits"].content_hash
    assert not (tmp_path / "shards" / SHARD / ".unfinished" / "draw").exists()


@pytest.mark.parametrize("seconds", [0.0, 1e9])
def test_finished_scenes_survive_an_interrupt_whenever_they_are_written(
    seconds: float, tmp_path: Path, inputs: ShardInputs, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(unfinished, "SECONDS_IN_MEMORY", seconds)
    root, kept_folder = DataRoot(tmp_path), tmp_path / "shards" / SHARD / ".unfinished" / "draw"

    def interrupt(progress: Progress) -> None:
        if progress.done == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_stage(_stage(), SHARD, root, inputs, 0, interrupt)
    assert sorted(path.name for path in kept_folder.iterdir()) == sorted(SCENES[:5])
    done: list[int] = []
    resumed = run_stage(_stage(), SHARD, root, inputs, 0, lambda p: done.append(p.total))
    assert done == [len(SCENES) - 5] * (len(SCENES) - 5)
    assert not kept_folder.exists()
    whole = run_stage(_stage(), SHARD, DataRoot(tmp_path / "whole"), inputs, 0)
    assert resumed.sidecars["splits"].content_hash == whole.sidecars["splits"].content_hash


def test_a_quick_stage_writes_no_parts(tmp_path: Path, inputs: ShardInputs, monkeypatch: pytest.MonkeyPatch) -> None:
    written: list[Path] = []
    monkeypatch.setattr(unfinished, "write_table", lambda schema, table, path, made_from: written.append(path))
    run_stage(_stage(), SHARD, DataRoot(tmp_path), inputs, 0)
    assert not written


def test_what_a_kill_after_publishing_left_is_removed(tmp_path: Path, inputs: ShardInputs) -> None:
    root = DataRoot(tmp_path)
    run_stage(_stage(), SHARD, root, inputs, 0)
    left = root.scene_part(SHARD, "draw", SCENES[0], "splits")
    left.parent.mkdir(parents=True)
    assert run_stage(_stage(), SHARD, root, inputs, 0).is_reused
    assert not left.parent.exists()


def test_timings_are_kept_beside_the_tables(tmp_path: Path, inputs: ShardInputs) -> None:
    root = DataRoot(tmp_path)
    run_stage(_stage(), SHARD, root, inputs, 0)
    assert read_table(TIMINGS, root.timings(SHARD, "draw"))["item_id"].to_pylist() == list(SCENES)


def test_progress_counts_every_unit(tmp_path: Path, inputs: ShardInputs) -> None:
    seen = []
    run_stage(_stage(), SHARD, DataRoot(tmp_path), inputs, 0, seen.append)
    assert [p.done for p in seen] == list(range(1, 13))
    assert {p.total for p in seen} == {12}


def test_an_unlawful_table_is_not_published_and_its_scenes_are_made_again(tmp_path: Path, inputs: ShardInputs) -> None:
    root, rows = DataRoot(tmp_path), []
    with pytest.raises(StageError, match="1 laws broken, must be 0; nothing is published:\nsplits have no test") as failure:
        run_stage(_stage(law=lambda tables, promise: ["splits have no test"]), SHARD, root, inputs, 0)
    assert SHARD in str(failure.value)
    assert not root.shard_table(SHARD, "splits").exists()
    assert not is_published(_stage(), SHARD, root, inputs)

    def law(tables, promise):
        rows.append((tables["splits"].num_rows, len(promise.allocations)))
        return []

    done: list[int] = []
    run_stage(_stage(law=law), SHARD, root, inputs, 0, lambda p: done.append(p.total))
    assert rows == [(len(SCENES), len(SCENES))]
    assert done == [len(SCENES)] * len(SCENES)
