"""Laws of training: it learns geometry, repeats itself, resumes exactly, chooses on validation alone and never sees test."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
import safetensors.torch
import torch

from model import local_settings
from model.batches import scene_batches
from model.errors import CheckpointError, RankerError, SettingsError, TrainingError
from model.inputs import InputReader, read_inputs, scenes_of_split
from model.labels import read_labels
from model.optimisation import HistoryRow, learning_rate_at, quality_of
from model.scoring import score, success_at_1
from model.settings import LIGHT, RankerSettings, Variant, settings_from_dict, settings_to_dict
from model.training import _training_scenes, main, train
from tables.schemas import CANDIDATES
from tables.store import read_table, write_table
from tests.model.conftest import tiny_of
from tests.model.damage import rewrite
from tests.model.synthetic_release import write_synthetic_release


def test_learns_what_follows_from_geometry(tmp_path: Path) -> None:
    """On scenes it never saw, the first choice succeeds far more often than a random one.

    A random choice succeeds in about 35 % of the covered fixed-target groups; chance puts 32 groups above 55 % once in a hundred times.
    """
    release = write_synthetic_release(tmp_path / "release", n_scenes=25, seed=11, n_points=200)
    settings = replace(
        LIGHT, n_points=128, n_centres_1=32, n_neighbours_1=8, n_centres_2=16, n_neighbours_2=8, n_epochs=12, scenes_per_batch=2
    )
    train(release, Variant.FULL, 42, settings, tmp_path / "ranker")
    rows = pl.from_arrow(score(release, tmp_path / "ranker"))
    assert isinstance(rows, pl.DataFrame)
    rows = rows.select("candidate_id", score=pl.col("log_p_plan") + pl.col("log_p_exec"))
    candidates = pl.read_parquet(release / "candidates.parquet").with_columns(pl.col("scene_id").cast(pl.String))
    splits = pl.read_parquet(release / "splits.parquet").with_columns(pl.col("scene_id", "split").cast(pl.String))
    judged = candidates.join(rows, on="candidate_id").join(splits, on="scene_id").filter(pl.col("split") == "test")
    judged = judged.with_columns(success=pl.col("y_plan") & pl.col("y_pipe").fill_null(False))
    groups = judged.group_by("scene_id", "target_id").agg(
        random=pl.col("success").mean(), first=pl.col("success").sort_by("score", descending=True).first()
    )
    covered = groups.filter(pl.col("random") > 0)
    random_s1, ours = covered["random"].mean(), covered["first"].mean()
    assert len(covered) > 25
    assert ours > random_s1 + 0.2, f"S1 {ours:.2f}, random {random_s1:.2f}"


def test_two_trainings_with_one_seed_are_equal_and_another_seed_differs(small_release: Path, tiny: RankerSettings, tmp_path: Path) -> None:
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        train(small_release, "full", seed, tiny, tmp_path / name)
    a, b, c = ((tmp_path / name / "ranker.safetensors").read_bytes() for name in "abc")
    assert a == b
    assert a != c
    assert (tmp_path / "a" / "ranker.json").read_text() == (tmp_path / "b" / "ranker.json").read_text()


@pytest.mark.parametrize("variant", list(Variant))
def test_a_resumed_training_equals_an_uninterrupted_one(small_release: Path, tmp_path: Path, variant: Variant) -> None:
    tiny = tiny_of(variant)
    whole = train(small_release, variant, 5, tiny, tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        train(small_release, variant, 5, tiny, tmp_path / "parts", on_epoch=_interrupt_after(1))
    assert not (tmp_path / "parts" / "ranker.json").exists()
    seen: list[int] = []
    resumed = train(small_release, variant, 5, tiny, tmp_path / "parts", resume=True, on_epoch=lambda row: seen.append(row["epoch"]))
    assert seen == [2, 3]
    assert resumed.n_epochs_resumed == 2
    assert resumed.history == whole.history
    assert (tmp_path / "parts" / "ranker.safetensors").read_bytes() == (tmp_path / "whole" / "ranker.safetensors").read_bytes()


def test_the_state_of_another_training_is_not_resumed(small_release: Path, tiny: RankerSettings, tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        train(small_release, "full", 5, tiny, tmp_path / "parts", on_epoch=_interrupt_after(0))
    other = train(small_release, "full", 6, tiny, tmp_path / "parts", resume=True)
    assert other.n_epochs_resumed == 0
    assert other.history == train(small_release, "full", 6, tiny, tmp_path / "whole").history


def test_a_broken_resume_state_is_an_error(small_release: Path, tiny: RankerSettings, tmp_path: Path) -> None:
    (tmp_path / "resume.safetensors").write_bytes(b"not tensors")
    with pytest.raises(CheckpointError, match="not a resume state"):
        train(small_release, "full", 5, tiny, tmp_path, resume=True)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("weights/exec_head.bias", torch.zeros(2), r"exec_head.bias is torch.float32 \[2\], its settings need torch.float32 \[1\]"),
        ("best/exec_head.bias", None, "exec_head.bias is missing from a ranker of variant full"),
        ("best/exec_head.bias", torch.tensor([torch.nan]), "exec_head.bias has values that are not finite"),
        ("moments/exec_head.bias/exp_avg", torch.zeros(2), "moments of exec_head.bias"),
        ("moments/exec_head.bias/exp_avg_sq", None, "moments of exec_head.bias"),
    ],
)
def test_a_resume_state_that_does_not_fit_is_an_error(
    small_release: Path, tiny: RankerSettings, tmp_path: Path, name: str, value: torch.Tensor | None, message: str
) -> None:
    with pytest.raises(KeyboardInterrupt):
        train(small_release, "full", 5, tiny, tmp_path, on_epoch=_interrupt_after(0))
    path = tmp_path / "resume.safetensors"
    with safetensors.safe_open(path, framework="pt") as stored:
        metadata, tensors = stored.metadata(), {key: stored.get_tensor(key) for key in stored.keys()}  # noqa: SIM118 (not a mapping)
    tensors = {key: tensor for key, tensor in tensors.items() if key != name} | ({} if value is None else {name: value})
    path.write_bytes(safetensors.torch.save(tensors, metadata))
    with pytest.raises(CheckpointError, match=rf"resume\.safetensors: {message}"):
        train(small_release, "full", 5, tiny, tmp_path, resume=True)


def test_a_state_killed_before_the_checkpoint_was_written_still_gives_it(small_release: Path, tiny: RankerSettings, tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        train(small_release, "full", 5, tiny, tmp_path / "parts", on_epoch=_interrupt_after(tiny.n_epochs - 1))
    assert train(small_release, "full", 5, tiny, tmp_path / "parts", resume=True).n_epochs_resumed == tiny.n_epochs
    train(small_release, "full", 5, tiny, tmp_path / "whole")
    for name in ("ranker.safetensors", "ranker.json"):
        assert (tmp_path / "parts" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    assert not (tmp_path / "parts" / "resume.safetensors").exists()


def test_test_scenes_do_not_reach_a_training(small_release: Path, tiny: RankerSettings, tmp_path: Path) -> None:
    """Without any row of the test scenes, but for their split, the weights are the same to the bit."""
    copy = Path(shutil.copytree(small_release, tmp_path / "release"))
    for path in copy.glob("*.parquet"):
        table = pq.read_table(path)
        if "scene_id" in table.column_names and path.stem != "splits":
            rewrite(path, table.filter(pc.not_equal(table["scene_id"].cast(pa.string()), "full-0004")))
    train(small_release, "full", 1, tiny, tmp_path / "with")
    train(copy, "full", 1, tiny, tmp_path / "without")
    assert (tmp_path / "with" / "ranker.safetensors").read_bytes() == (tmp_path / "without" / "ranker.safetensors").read_bytes()


def test_a_training_of_some_scenes_is_one_on_a_release_that_has_no_others(
    small_release: Path, tiny: RankerSettings, tmp_path: Path
) -> None:
    reader = InputReader(small_release)
    every, two, one = (set(_training_scenes(reader, n)) for n in (0, 2, 1))
    assert one < two < every == set(scenes_of_split(reader, "train"))
    copy = Path(shutil.copytree(small_release, tmp_path / "release"))
    splits = pq.read_table(copy / "splits.parquet")
    kept = [name not in every - two for name in splits["scene_id"].to_pylist()]
    rewrite(copy / "splits.parquet", splits.filter(pa.array(kept)))
    train(small_release, "full", 1, replace(tiny, n_train_scenes=2), tmp_path / "some")
    train(copy, "full", 1, tiny, tmp_path / "all")
    assert (tmp_path / "some" / "ranker.safetensors").read_bytes() == (tmp_path / "all" / "ranker.safetensors").read_bytes()
    with pytest.raises(TrainingError, match=rf"^n_train_scenes: 99, must be at most {len(every)}, the scenes of the training split$"):
        train(small_release, "full", 1, replace(tiny, n_train_scenes=99), tmp_path / "none")


def test_best_epoch_is_chosen_by_validation_s1_then_joint_s1_then_loss(small_release: Path, tiny: RankerSettings, tmp_path: Path) -> None:
    result = train(small_release, "full", 1, replace(tiny, n_epochs=6), tmp_path)
    assert result.selected_by == "validation S1"
    best = max(result.history, key=lambda row: (row["fixed_s1"], row["joint_s1"], -row["validation_loss"], -row["epoch"]))
    assert result.best_epoch == best["epoch"]
    # The stored weights are the best epoch's: scored again, they have its S1.
    table = score(small_release, tmp_path)
    rows = dict(zip(table["candidate_id"].to_pylist(), table["log_p_plan"].to_numpy() + table["log_p_exec"].to_numpy(), strict=True))
    inputs = read_inputs(InputReader(small_release), ["full-0003"])
    scores = np.array([rows[candidate_id] for candidate_id in inputs.candidate_ids])
    s1, n_covered = success_at_1(scores, read_labels(small_release, inputs.candidate_ids).success, inputs.candidate_group)
    assert (s1, n_covered) == (best["fixed_s1"], best["n_fixed_covered"])


def test_epochs_are_ordered_by_fixed_s1_then_joint_s1_then_loss() -> None:
    better_first = [(0.8, 0.5, 2.0), (0.7, 0.9, 3.0), (0.7, 0.6, 1.0), (0.7, 0.6, 1.5), (None, None, 0.5), (None, None, 0.6)]
    rows = [dict(zip(("fixed_s1", "joint_s1", "validation_loss"), values, strict=True)) for values in better_first]
    qualities = [quality_of(row) for row in rows]
    assert all(better > worse for better, worse in pairwise(qualities))


def test_without_covered_validation_groups_the_loss_chooses(small_release: Path, tiny: RankerSettings, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(small_release, tmp_path / "release"))
    rows = read_table(CANDIDATES, copy / "candidates.parquet").to_pylist()
    nobody = {column.name: None for column in CANDIDATES.columns if column.nullable} | {"y_plan": False, "plan_status": "no_ik"}
    rows = [row | nobody if row["scene_id"] == "full-0003" else row for row in rows]
    write_table(CANDIDATES, pa.Table.from_pylist(rows, schema=CANDIDATES.arrow), copy / "candidates.parquet")
    result = train(copy, "full", 1, tiny, tmp_path / "ranker")
    assert result.selected_by == "validation loss (no covered validation group)"
    assert result.best_epoch == min(result.history, key=lambda row: row["validation_loss"])["epoch"]


@pytest.mark.parametrize("split", ["train", "validation"])
def test_an_empty_split_is_an_error(small_release: Path, tiny: RankerSettings, tmp_path: Path, split: str) -> None:
    with pytest.raises(TrainingError, match=f"the {split} split has 0 candidates, must have at least 1"):
        train(_with_splits(small_release, tmp_path / "release", split, "test"), "full", 1, tiny, tmp_path / "ranker")
    assert not (tmp_path / "ranker").exists()


def test_a_diverging_training_is_an_error(small_release: Path, tiny: RankerSettings, tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match=r"step \d+: loss (nan|inf), must be finite; lower learning_rate \(1e\+30\)"):
        train(small_release, "full", 1, replace(tiny, learning_rate=1e30, n_epochs=20), tmp_path)


def test_a_training_that_diverges_in_its_last_step_is_an_error(small_release: Path, tiny: RankerSettings, tmp_path: Path) -> None:
    """With one step an epoch the loss before it is finite; only the validation scenes see the weights after it."""
    one_step = replace(tiny, learning_rate=1e30, n_epochs=1, scenes_per_batch=3)
    with pytest.raises(TrainingError, match=r"epoch 0: validation loss (nan|inf), must be finite; lower learning_rate \(1e\+30\)"):
        train(small_release, "full", 1, one_step, tmp_path / "ranker")
    assert not (tmp_path / "ranker").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--variant", "fuller"], "variant 'fuller', must be one of"),
        (["--setting", "huge"], "setting 'huge', must be one of"),
        (["--epochs", "0"], "n_epochs: 0, must be above 0"),
        (["--device", "abacus"], "device 'abacus', must be auto, cpu or cuda"),
        (["--seed", "2147483648"], "seed: 2147483648, must be a whole number in [-2147483648, 2147483647]"),
        ([], "splits.parquet: missing"),
    ],
)
def test_command_line_says_what_is_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str) -> None:
    assert main(["--release", str(tmp_path), "--out", str(tmp_path / "out"), *arguments]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ")
    assert message in line
    assert not (tmp_path / "out").exists()


def test_every_scene_comes_once_an_epoch_in_an_order_of_seed_and_epoch(tiny: RankerSettings) -> None:
    settings = replace(tiny, scenes_per_batch=3)

    def order(seed: int, epoch: int) -> list[int]:
        return np.concatenate(list(scene_batches(10, settings, seed, epoch))).tolist()

    assert sorted(order(1, 0)) == list(range(10))
    assert order(1, 0) == order(1, 0)
    assert order(1, 0) != order(1, 1)
    assert order(1, 0) != order(2, 0)


def test_learning_rate_warms_up_and_ends_near_zero() -> None:
    rates = [learning_rate_at(step, 100, LIGHT) for step in range(100)]
    peak = int(np.argmax(rates))
    assert rates[peak] == LIGHT.learning_rate
    assert np.all(np.diff(rates[: peak + 1]) > 0)
    assert np.all(np.diff(rates[peak + 1 :]) < 0)
    assert 0 < rates[-1] < 0.01 * LIGHT.learning_rate


def test_settings_survive_json_and_refuse_what_cannot_be() -> None:
    for named in (LIGHT, local_settings.LIGHT):
        assert settings_from_dict(type(named), json.loads(json.dumps(settings_to_dict(named)))) == named
    older = {name: value for name, value in settings_to_dict(LIGHT).items() if name != "n_train_scenes"}
    assert settings_from_dict(RankerSettings, older) == LIGHT, "of a checkpoint that is older than the setting"
    changes = ({"dropout": 1.0}, {"n_points": 510}, {"n_centres_1": 500}, {"learning_rate": float("nan")}, {"widths_1": (8,)})
    for change in (*changes, {"learning_rate": float("inf")}, {"crop_centre_m": (float("nan"), 0.0, 0.0)}):
        with pytest.raises(SettingsError, match=next(iter(change))):
            replace(LIGHT, **change)
    with pytest.raises(SettingsError, match="momentum"):
        settings_from_dict(RankerSettings, settings_to_dict(LIGHT) | {"momentum": 0.9})
    with pytest.raises(SettingsError, match="n_epochs: '3', must be int"):
        settings_from_dict(RankerSettings, settings_to_dict(LIGHT) | {"n_epochs": "3"})
    assert issubclass(SettingsError, RankerError)


def _with_splits(release: Path, copy: Path, old: str, new: str) -> Path:
    shutil.copytree(release, copy)
    splits = pq.read_table(copy / "splits.parquet")
    names = [new if name == old else name for name in splits["split"].to_pylist()]
    rewrite(copy / "splits.parquet", pa.table({"scene_id": splits["scene_id"], "split": names}))
    return copy


def _interrupt_after(epoch: int) -> Callable[[HistoryRow], None]:
    def on_epoch(row: HistoryRow) -> None:
        if row["epoch"] == epoch:
            raise KeyboardInterrupt

    return on_epoch
