"""Finished scenes of a stage that was interrupted: kept where they are what they should be, made again where they are not."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from pipelines.running.data_root import DataRoot
from pipelines.running.unfinished import SceneParts
from pipelines.stage import UnitResult
from pipelines.stages import STAGE
from tables.identity import candidate_id_of
from tables.schemas import CANDIDATE_PAIRS
from tables.store import sidecar_path
from tests.tables.damage import SIDECAR_DAMAGE, TABLE_DAMAGE, Damage

SHARD = "mini-000"
SCENES = ("mini-0000", "mini-0001", "mini-0002")
DAMAGE = SIDECAR_DAMAGE | {f"table {name}": damage for name, damage in TABLE_DAMAGE.items()}


def _result(scene_id: str) -> UnitResult:
    rows = [
        {
            "candidate_id": candidate_id_of(scene_id, target_id, 7),
            "scene_id": scene_id,
            "target_id": target_id,
            "grasp_id": 7,
            "object_id": "can_01",
            "category": "can",
            "n_obstacles": 1,
        }
        for target_id in range(8)
    ]
    return UnitResult({"candidate_pairs": rows}, [{"stage": "candidate_pairs", "item_id": scene_id, "core_ms": 1.0}])


@pytest.fixture
def root(tmp_path: Path) -> DataRoot:
    """Three scenes that an interrupted run left behind."""
    parts = _parts(DataRoot(tmp_path))
    for scene_id in SCENES:
        parts.add(scene_id, [_result(scene_id)])
    parts.flush()
    return DataRoot(tmp_path)


def _parts(root: DataRoot, code: str = "1") -> SceneParts:
    return SceneParts(STAGE["candidate_pairs"], SHARD, root, {"code": code})


def _on_disk(parts: SceneParts) -> list[bool]:
    return [parts.is_on_disk(scene_id) for scene_id in SCENES]


def _part(root: DataRoot, scene_id: str, table: str = "candidate_pairs") -> Path:
    return root.scene_part(SHARD, "candidate_pairs", scene_id, table)


def test_scenes_that_are_what_they_should_be_are_kept(root: DataRoot, caplog: pytest.LogCaptureFixture) -> None:
    assert _on_disk(_parts(root)) == [True, True, True]
    assert not caplog.records


@pytest.mark.parametrize("table", ["candidate_pairs", "timings"])
@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE)
def test_a_damaged_scene_is_made_again_with_one_log_line(
    damage: Damage, table: str, root: DataRoot, caplog: pytest.LogCaptureFixture
) -> None:
    whole = _parts(root).joined(CANDIDATE_PAIRS, SCENES)
    damage(_part(root, SCENES[1], table))
    parts = _parts(root)
    assert _on_disk(parts) == [True, False, True]
    (line,) = caplog.messages
    assert line.startswith(f"mini-000.candidate_pairs: finished scene is damaged, made again: {table} of mini-0001: ")
    assert "\n" not in line
    parts.add(SCENES[1], [_result(SCENES[1])])
    parts.flush()
    assert _on_disk(_parts(root)) == [True, True, True]
    assert _parts(root).joined(CANDIDATE_PAIRS, SCENES).equals(whole)


@pytest.mark.parametrize("with_sidecars", [False, True])
def test_two_swapped_scenes_are_made_again(with_sidecars: bool, root: DataRoot, caplog: pytest.LogCaptureFixture) -> None:
    first, second = _part(root, SCENES[0]), _part(root, SCENES[1])
    pairs = [(first, second), *([(sidecar_path(first), sidecar_path(second))] if with_sidecars else [])]
    for a, b in pairs:
        content = a.read_bytes()
        a.write_bytes(b.read_bytes())
        b.write_bytes(content)
    assert _on_disk(_parts(root)) == [False, False, True]
    assert len(caplog.records) == 2
    assert ("is of 'mini-0001', expected 'mini-0000'" in caplog.messages[0]) == with_sidecars


def test_a_scene_that_a_kill_cut_off_is_made_again_without_ado(root: DataRoot, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.DEBUG)
    sidecar_path(_part(root, SCENES[0], "timings")).unlink()
    for path in (_part(root, SCENES[1], "timings"), sidecar_path(_part(root, SCENES[1], "timings"))):
        path.unlink()
    assert _on_disk(_parts(root)) == [False, False, True]
    assert not caplog.records


def test_scenes_made_from_other_inputs_are_made_again_without_ado(root: DataRoot, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.DEBUG)
    assert _on_disk(_parts(root, code="2")) == [False, False, False]
    assert not caplog.records
