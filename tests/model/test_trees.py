"""Laws of the tree probe: same arguments, same predictions; no candidate is scored by trees that saw its scene's labels."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pytest
from threadpoolctl import threadpool_limits

from model.errors import SettingsError
from model.inputs import InputReader, scenes_of_split
from model.labels import Labels
from model.trees import TreeData, TreeSettings, TreeVariant, cross_validated_predictions, fit_trees, read_tree_data, split_predictions
from reports.metrics import auroc
from tests.model.synthetic_release import write_synthetic_release


@pytest.fixture(scope="module")
def tree_release(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten scenes: six to train on, two validation, two test."""
    return write_synthetic_release(tmp_path_factory.mktemp("trees"), n_scenes=10, seed=3, n_points=120)


@pytest.fixture(scope="module")
def data(tree_release: Path) -> TreeData:
    return read_tree_data(tree_release)


@pytest.fixture(scope="module")
def predictions(tree_release: Path, data: TreeData) -> pa.Table:
    return split_predictions(tree_release, data, TreeVariant.GEOMETRY, 42)


def test_the_same_arguments_give_the_same_predictions(tree_release: Path, data: TreeData, predictions: pa.Table) -> None:
    with threadpool_limits(2):  # what surrounds the training does not reach it
        assert split_predictions(tree_release, data, TreeVariant.GEOMETRY, 42).equals(predictions)
    assert not split_predictions(tree_release, data, TreeVariant.GEOMETRY, 43)["log_p_exec"].equals(predictions["log_p_exec"])


def test_predictions_are_log_probabilities_of_every_candidate(data: TreeData, predictions: pa.Table) -> None:
    assert predictions["candidate_id"].to_pylist() == sorted(data.inputs.candidate_ids)
    assert predictions["variant"].unique().to_pylist() == ["trees"]
    for name in ("log_p_plan", "log_p_exec"):
        assert pc.max(predictions[name]).as_py() <= 0.0


def test_they_learn_what_geometry_decides(tree_release: Path, data: TreeData, predictions: pa.Table) -> None:
    """Synthetic plans are decided by the hand at the place, which raw poses do not name, on scenes that the trees never saw."""
    unseen = ~data.of_scenes(scenes_of_split(InputReader(tree_release), "train"))
    poses = split_predictions(tree_release, data, TreeVariant.POSES, 42)
    y_plan = data.labels.y_plan[unseen]
    area = {variant: auroc(table["log_p_plan"].to_numpy()[unseen], y_plan) for variant, table in (("all", predictions), ("poses", poses))}
    assert area["all"] > 0.95
    assert area["all"] > area["poses"] + 0.02


def test_only_labels_of_the_train_split_reach_the_trees(tree_release: Path, data: TreeData, predictions: pa.Table) -> None:
    train = data.of_scenes(scenes_of_split(InputReader(tree_release), "train"))
    shifted = replace(data, labels=_shifted(data.labels, ~train))
    assert split_predictions(tree_release, shifted, TreeVariant.GEOMETRY, 42).equals(predictions)
    leaking = replace(data, labels=_shifted(data.labels, train))
    assert not split_predictions(tree_release, leaking, TreeVariant.GEOMETRY, 42)["log_p_exec"].equals(predictions["log_p_exec"])


def test_a_scene_is_scored_by_trees_that_never_saw_it(data: TreeData) -> None:
    """Labels of one scene changed: its own scores stay to the bit, those of other folds move."""
    honest = cross_validated_predictions(data, TreeVariant.POSES, 42, 2)
    scene_id = data.scene_ids[3]
    mine = np.array([candidate_id.startswith(scene_id) for candidate_id in honest["candidate_id"].to_pylist()])
    shifted = replace(data, labels=_shifted(data.labels, data.of_scenes([scene_id])))
    changed = cross_validated_predictions(shifted, TreeVariant.POSES, 42, 2)["log_p_exec"].to_numpy() != honest["log_p_exec"].to_numpy()
    assert mine.any()
    assert not changed[mine].any()
    assert changed[~mine].any()


def test_raw_poses_see_raw_poses_alone(tree_release: Path, data: TreeData) -> None:
    """A derived feature that is the label itself helps those that may see it and nobody else."""
    planted = data.geometry.copy()
    planted[:, -1] = data.labels.success
    honest, seeing = (replace(data, geometry=geometry) for geometry in (data.geometry, planted))
    poses = [split_predictions(tree_release, each, TreeVariant.POSES, 42) for each in (honest, seeing)]
    derived = [split_predictions(tree_release, each, TreeVariant.GEOMETRY, 42) for each in (honest, seeing)]
    assert poses[0].equals(poses[1])
    assert not derived[0].equals(derived[1])


def test_a_head_that_saw_one_kind_alone_holds_all_candidates_for_alike(data: TreeData) -> None:
    """Laplace's rule of succession: (true + 1) / (all + 2)."""
    n, n_planned = len(data.geometry), int(data.labels.y_plan.sum())
    all_true = Labels(np.ones_like(data.labels.y_plan), data.labels.y_pipe)
    plan, _ = fit_trees(data.geometry, all_true, TreeVariant.POSES, 42).log_probabilities(data.geometry)
    assert plan == pytest.approx(np.log((n + 1) / (n + 2)))
    none_true = Labels(data.labels.y_plan, np.zeros_like(data.labels.y_pipe))
    plan, execution = fit_trees(data.geometry, none_true, TreeVariant.POSES, 42).log_probabilities(data.geometry)
    assert execution == pytest.approx(np.log(1 / (n_planned + 2)))
    assert len(set(plan.tolist())) > 1, "the other head is trained all the same"


def test_what_cannot_be_trained_is_refused(data: TreeData) -> None:
    with pytest.raises(SettingsError, match="seed: 2147483648"):
        fit_trees(data.geometry, data.labels, TreeVariant.POSES, 2**31)
    for n_folds in (1, 11):
        with pytest.raises(SettingsError, match=rf"folds: {n_folds}, must be in \[2, 10\]"):
            cross_validated_predictions(data, TreeVariant.POSES, 42, n_folds)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("max_iter", 0),
        ("max_leaf_nodes", 1),
        ("min_samples_leaf", 0),
        ("learning_rate", 0.0),
        ("max_features", 1.5),
        ("l2_regularization", -1.0),
    ],
)
def test_impossible_settings_are_refused(name: str, value: float) -> None:
    with pytest.raises(SettingsError, match=f"{name}: {value}, must be"):
        TreeSettings(**{name: value})


def _shifted(labels: Labels, rows: np.ndarray) -> Labels:
    """Labels of some candidates handed on to the seventh after."""
    shifted = Labels(labels.y_plan.copy(), labels.y_pipe.copy())
    for values in (shifted.y_plan, shifted.y_pipe):
        values[rows] = np.roll(values[rows], 7)
    return shifted
