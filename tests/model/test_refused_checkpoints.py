"""Damaged checkpoints and places to write to that training and scoring refuse: one line, exit code 1, nothing left behind."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from model import scoring
from tests.model.commands import Commands, contents
from tests.model.damage import cut, edit_json, edit_weights, name_weights, set_values

NAN = float("nan")

_BAD_SETTINGS: list[tuple[dict[str, Any], str]] = [
    ({"width_global": 16}, r"ranker\.safetensors: scene\.overall\S+ is torch\.float32 \[32\], its settings need torch\.float32 \[16\]"),
    ({"widths_1": [16, 12]}, r"ranker\.safetensors: scene\.local\S+ is torch\.float32 \[8"),
    ({"n_frequencies": 3}, r"is torch\.float32 \[256, 45\], its settings need torch\.float32 \[256, 63\]"),
    ({"widths_1": [8, 8, 12]}, r"scene\.local\S+ is missing from a ranker of variant full"),
    ({"width_global": 10**13}, r"ranker\.json: width_global: 10000000000000, must be at most 4096"),
    ({"radius_1_m": 10**400}, r"ranker\.json: not a checkpoint \(OverflowError: .+\)$"),
    ({"widths_1": [8] * 9}, r"ranker\.json: widths_1: \(.+\), must be 2 to 8 widths of 1 to 4096"),
    ({"widths_2": [16, 10**13]}, r"ranker\.json: widths_2: \(16, 10000000000000\), must be 2 to 8 widths of 1 to 4096"),
    ({"n_frequencies": 10**9}, r"ranker\.json: n_frequencies: 1000000000, must be at most 16"),
    ({"n_points": 32}, r"ranker\.json: SHA-256 \w+, it says \w+; it was changed after training"),
    ({"n_points": "64"}, r"ranker\.json: n_points: '64', must be int"),
    ({"radius_1_m": NAN}, r"ranker\.json: radius_1_m: nan, must be finite"),
    ({"n_heads": 2}, r"ranker\.json: settings \['n_heads'\] are unknown or missing"),
]


@pytest.mark.parametrize(("settings", "problem"), _BAD_SETTINGS)
def test_edited_sizes_of_a_checkpoint_are_named(commands: Commands, copy: Path, settings: dict[str, Any], problem: str) -> None:
    edit_json(copy / "ranker.json", lambda described: described["identity"]["settings"].update(settings))
    assert re.search(problem, commands.scoring(checkpoint=copy))


_BAD_DESCRIPTIONS: list[tuple[str, dict[str, Any] | None, str]] = [
    ("identity", {"variant": "direct"}, r"ranker\.safetensors: plan_head.bias is not a weight of a ranker of variant direct"),
    ("identity", {"variant": "fuller"}, r"ranker\.json: variant 'fuller', must be one of"),
    ("identity", {"seed": "x"}, r"ranker\.json: seed: 'x', must be a whole number"),
    ("identity", {"seed": 2**31}, r"ranker\.json: seed: 2147483648, must be a whole number in \[-2147483648, 2147483647\]"),
    ("progress", {"best_epoch": 4}, r"ranker\.json: progress: best epoch 4, must be in \[0, 4\)"),
    ("progress", {"n_epochs_done": 3}, r"ranker\.json: progress: 3 epochs done, 4 in the history, must be equal"),
    ("progress", {"history": None}, r"ranker\.json: not a checkpoint \(TypeError: .+\)$"),
    ("identity", None, r"ranker\.json: not a checkpoint \(KeyError: 'identity'\)$"),
]


@pytest.mark.parametrize(("part", "change", "problem"), _BAD_DESCRIPTIONS)
def test_an_edited_checkpoint_is_named(commands: Commands, copy: Path, part: str, change: dict[str, Any] | None, problem: str) -> None:
    edit_json(copy / "ranker.json", lambda described: described[part].update(change) if change else described.pop(part))
    assert re.search(problem, commands.scoring(checkpoint=copy))


@pytest.mark.parametrize(
    ("damage", "problem"),
    [
        (lambda folder: cut(folder / "ranker.json", 0.5), r"ranker\.json: not a checkpoint"),
        (lambda folder: (folder / "ranker.json").write_bytes(b"\xff\xfe\x00"), r"ranker\.json: not a checkpoint \('utf-8'"),
        (lambda folder: (folder / "ranker.json").write_text("[" * 100_000), r"ranker\.json: not a checkpoint \(maximum recursion"),
        (lambda folder: (folder / "ranker.json").write_text("9" * 5000), r"ranker\.json: not a checkpoint \(Exceeds the limit"),
        (lambda folder: (folder / "ranker.json").write_text("[1]"), r"ranker\.json: not a checkpoint \(a JSON list, must be an object\)"),
        (lambda folder: (folder / "ranker.json").unlink(), r"ranker\.json: missing; train first"),
        (lambda folder: (folder / "ranker.safetensors").unlink(), r"ranker\.safetensors: missing; train first"),
        (lambda folder: cut(folder / "ranker.safetensors", 0.6), r"ranker\.safetensors: SHA-256 \w+, ranker\.json says \w+$"),
        (lambda folder: edit_weights(folder, lambda w: w.pop("exec_head.bias")), r"exec_head\.bias is missing from a ranker"),
        (lambda folder: edit_weights(folder, lambda w: w["exec_head.bias"].fill_(NAN)), r"exec_head\.bias has values that are not finite"),
        (lambda folder: edit_weights(folder, lambda w: w["exec_head.bias"].fill_(1.0)), r"ranker\.json: SHA-256 \w+, it says \w+; it was"),
    ],
)
def test_a_damaged_checkpoint_is_named(commands: Commands, copy: Path, damage: Callable[[Path], Any], problem: str) -> None:
    damage(copy)
    assert re.search(problem, commands.scoring(checkpoint=copy))


def test_weights_that_end_early_are_named_even_where_their_hash_agrees(commands: Commands, copy: Path) -> None:
    for share in (0.6, 0.0):
        cut(copy / "ranker.safetensors", share)
        name_weights(copy)
        assert re.search(r"ranker\.safetensors: not the weights of a ranker \(.+\)$", commands.scoring(checkpoint=copy))


def test_weights_whose_scores_overflow_are_named(commands: Commands, copy: Path) -> None:
    edit_weights(copy, lambda weights: weights["exec_head.weight"].fill_(-3e38))
    edit_json(copy / "ranker.json", lambda described: described.pop("description_sha256"))
    assert re.search(r"checkpoint: log_p_exec of full-\S+ is (nan|-inf), must be finite; train again$", commands.scoring(checkpoint=copy))


def test_a_missing_checkpoint_is_named(commands: Commands, tmp_path: Path) -> None:
    assert "nowhere/ranker.json: missing; train first" in commands.scoring(checkpoint=tmp_path / "nowhere")


def test_a_file_in_the_way_is_named(commands: Commands, tmp_path: Path) -> None:
    in_the_way = tmp_path / "in_the_way"
    in_the_way.write_text("a file")
    for out in (in_the_way, in_the_way / "deeper"):
        assert f"cannot be written, {in_the_way} is not a folder" in commands.training(out)
    assert f"cannot be written, {in_the_way} is not a folder" in commands.scoring(in_the_way / "predictions.parquet")


def test_a_folder_in_the_way_is_named(commands: Commands, tmp_path: Path) -> None:
    for name in ("ranker.json", "ranker.safetensors", "resume.safetensors"):
        out = tmp_path / f"out_{name}"
        (out / name).mkdir(parents=True)
        assert f"{out}/{name}: is a folder, must be a file or not exist" in commands.training(out)
    out = tmp_path / "predictions.parquet"
    (tmp_path / "predictions.parquet.json").mkdir()
    assert "predictions.parquet.json: is a folder" in commands.scoring(out)
    out.mkdir()
    assert "predictions.parquet: is a folder" in commands.scoring(out)


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs a file system that takes no files, whoever asks")
def test_a_folder_that_takes_no_files_is_named(commands: Commands) -> None:
    assert "/proc takes no files (" in commands.training(Path("/proc/ranker"))
    assert "/proc takes no files (" in commands.scoring(Path("/proc/predictions.parquet"))


def test_an_older_checkpoint_survives_a_training_that_is_refused(commands: Commands, copy: Path) -> None:
    before = {path.name: path.read_bytes() for path in copy.iterdir()}
    set_values(commands.release, "targets", 3, {"target_qx": NAN})
    commands.training(copy)
    assert {path.name: path.read_bytes() for path in copy.iterdir()} == before


def test_older_predictions_survive_a_scoring_that_is_refused(commands: Commands, tmp_path: Path) -> None:
    out = tmp_path / "predictions.parquet"
    arguments = ["--release", str(commands.release), "--checkpoint", str(commands.checkpoint), "--out", str(out)]
    assert scoring.main(arguments) == 0
    before = contents(tmp_path)
    set_values(commands.release, "targets", 3, {"target_qx": NAN})
    after_damage = contents(tmp_path)
    commands.scoring(out)
    assert contents(tmp_path) == after_damage
    assert {path: content for path, content in before.items() if path.parent == tmp_path} == {
        path: content for path, content in after_damage.items() if path.parent == tmp_path
    }


def test_decision_times_of_fewer_than_no_scenes_are_refused(commands: Commands) -> None:
    assert commands.scoring(None, None, "--time", "-1") == "error: --time: -1 scenes, must be at least 0"
