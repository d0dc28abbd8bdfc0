"""A ranker is trained under one split scheme, says which, and reads no scene that the scheme tests on."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from model import scoring
from model.checkpoint import input_errors, load_checkpoint
from model.errors import CheckpointError, SettingsError, TrainingError
from model.inputs import InputReader, scenes_of_split
from model.settings import SCHEME_OF_PREDICTIONS, RankerSettings
from model.training import train
from model.trees import TreeVariant, read_tree_data, split_predictions
from tables.store import read_sidecar
from tables.vocabulary import SplitScheme
from tests.model.commands import Commands
from tests.model.damage import edit_json, rewrite

FILES = ("ranker.safetensors", "ranker.json")


@pytest.fixture(scope="module")
def by_object(small_release: Path, tiny: RankerSettings, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The checkpoint of `checkpoint`'s training under scheme `object`: four scenes to train on, the fifth for validation."""
    return train(small_release, "full", 7, tiny, tmp_path_factory.mktemp("by_object"), scheme="object").checkpoint_dir


def test_the_paper_s_split_is_the_default(small_release: Path, checkpoint: Path, tiny: RankerSettings, tmp_path: Path) -> None:
    train(small_release, "full", 7, tiny, tmp_path, scheme=SplitScheme.SCENE)
    assert [(tmp_path / name).read_bytes() for name in FILES] == [(checkpoint / name).read_bytes() for name in FILES]


def test_a_checkpoint_says_under_which_scheme_it_was_trained(by_object: Path, checkpoint: Path) -> None:
    assert load_checkpoint(by_object)[1].split_scheme is SplitScheme.OBJECT
    assert load_checkpoint(checkpoint)[1].split_scheme is SplitScheme.SCENE
    recorded = {path: json.loads((path / "ranker.json").read_text())["input_columns"]["splits"] for path in (by_object, checkpoint)}
    assert recorded == {by_object: ["scene_id", "split_object"], checkpoint: ["scene_id", "split"]}
    assert input_errors(by_object) == input_errors(checkpoint) == []
    assert (by_object / FILES[0]).read_bytes() != (checkpoint / FILES[0]).read_bytes()


def test_a_checkpoint_from_before_schemes_is_of_the_paper_s_split(copy: Path) -> None:
    def without(described: dict[str, Any]) -> None:
        del described["identity"]["split_scheme"]
        del described["description_sha256"]

    edit_json(copy / "ranker.json", without)
    assert load_checkpoint(copy)[1].split_scheme is SplitScheme.SCENE
    assert input_errors(copy) == []


def test_a_record_of_another_scheme_than_the_training_s_is_named(copy: Path) -> None:
    edit_json(copy / "ranker.json", lambda described: described["input_columns"].update(splits=["scene_id", "split_object"]))
    assert [error.split(": ")[0] for error in input_errors(copy)] == ["splits.split_object", "splits.split"]
    edit_json(copy / "ranker.json", lambda described: described["identity"].update(split_scheme="kitchen"))
    with pytest.raises(CheckpointError, match="split 'kitchen', must be one of"):
        load_checkpoint(copy)


def test_test_scenes_of_the_scheme_are_never_read(small_release: Path, tiny: RankerSettings, release: Path, tmp_path: Path) -> None:
    """Without the candidates of its test scenes, which the paper's split trains on, the same weights come out."""
    test = scenes_of_split(InputReader(release, SplitScheme.LAYOUT), "test")
    assert set(test) & set(scenes_of_split(InputReader(release), "train"))
    candidates = pq.read_table(release / "candidates.parquet")
    is_test = pc.is_in(candidates["scene_id"].cast(pa.string()), pa.array(test))
    rewrite(release / "candidates.parquet", candidates.filter(pc.invert(is_test)))
    for folder, name in ((small_release, "whole"), (release, "without")):
        train(folder, "full", 7, tiny, tmp_path / name, scheme="layout")
    assert (tmp_path / "whole" / FILES[0]).read_bytes() == (tmp_path / "without" / FILES[0]).read_bytes()


def test_an_unfinished_training_under_another_scheme_is_not_resumed(small_release: Path, tiny: RankerSettings, tmp_path: Path) -> None:
    def stop(row: Any) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(small_release, "full", 7, tiny, tmp_path, on_epoch=stop)
    assert train(small_release, "full", 7, tiny, tmp_path, scheme="object", resume=True).n_epochs_resumed == 0


def test_a_scheme_without_a_part_in_this_release_is_refused(small_release: Path, tiny: RankerSettings, tmp_path: Path) -> None:
    """The only validation scene of five has a can."""
    with pytest.raises(TrainingError, match="the validation split of scheme category_can has 0 candidates, must have at least 1"):
        train(small_release, "full", 7, tiny, tmp_path / "out", scheme="category_can")
    with pytest.raises(SettingsError, match="split 'kitchen', must be one of"):
        train(small_release, "full", 7, tiny, tmp_path / "out", scheme="kitchen")
    assert not (tmp_path / "out").exists()


def test_the_commands_take_and_tell_the_scheme(commands: Commands, by_object: Path, small_release: Path, tmp_path: Path) -> None:
    assert "the validation split of scheme category_can has 0 candidates" in commands.training(None, "--split", "category_can")
    assert "split 'kitchen', must be one of ['scene', 'object'," in commands.training(None, "--split", "kitchen")
    out = tmp_path / "predictions.parquet"
    assert scoring.main(["--release", str(small_release), "--checkpoint", str(by_object), "--out", str(out), "--time", "1"]) == 0
    assert read_sidecar(out).made_from == {SCHEME_OF_PREDICTIONS: "object"}


def test_trees_see_the_train_split_of_the_scheme_alone(release: Path) -> None:
    data = read_tree_data(release)
    scores = {scheme: split_predictions(release, data, TreeVariant.POSES, 1, scheme) for scheme in (SplitScheme.SCENE, SplitScheme.OBJECT)}
    assert scores[SplitScheme.SCENE].equals(split_predictions(release, data, TreeVariant.POSES, 1))
    assert not scores[SplitScheme.SCENE].equals(scores[SplitScheme.OBJECT])
