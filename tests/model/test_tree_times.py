from __future__ import annotations

from pathlib import Path

import pytest

from model.decision_times import machine_name
from model.inputs import InputReader, read_inputs, scenes_of_split
from model.tree_times import tree_decision_times
from model.trees import TreeSettings, TreeVariant, fit_trees, read_tree_data
from tests.model.synthetic_release import write_synthetic_release


@pytest.fixture(scope="module")
def release(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_synthetic_release(tmp_path_factory.mktemp("timed"), n_scenes=10, seed=1, n_points=40)


def test_every_group_of_the_scenes_is_timed_once_with_its_candidates(release: Path) -> None:
    data = read_tree_data(release)
    trees = fit_trees(data.geometry, data.labels, TreeVariant.GEOMETRY, 1, TreeSettings(max_iter=2))
    times = tree_decision_times(release, trees, n_scenes=1)
    reader = InputReader(release)
    (scene,) = scenes_of_split(reader, "test")[:1]
    inputs = read_inputs(reader, (scene,))
    joint, *fixed = times
    assert (joint.task, joint.scene_id, joint.target_id, joint.n_candidates) == ("joint", scene, None, len(inputs.candidate_ids))
    assert [time.target_id for time in fixed] == inputs.group_target_id.tolist()
    assert sum(time.n_candidates for time in fixed) == joint.n_candidates
    assert all(time.prepare_s > 0.0 and time.forward_s > 0.0 for time in times)


def test_the_machine_has_a_name() -> None:
    system, _, processor = machine_name().partition(", ")
    assert len(system.split()) == 2
    assert processor
