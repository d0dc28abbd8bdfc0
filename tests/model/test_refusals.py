"""What `python -m model.training` and `python -m model.scoring` refuse: one line that names the place, exit code 1, nothing left behind."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from model import scoring, training
from model.errors import InputError
from model.inputs import FIVE_INPUTS, KEY_COLUMNS, InputReader, read_inputs
from tables.poses import pose_columns
from tables.schemas import ALL_SCHEMAS
from tests.model.damage import copy_of, cut, edit_json, edit_weights, name_weights, rewrite, set_values, write_manifest

NAN, INF = float("nan"), float("inf")
_POSES = {"scenes": "object", "targets": "target", "grasps": "grasp"}
_REAL_COLUMNS = [
    *((table, column) for table, prefix in _POSES.items() for column in pose_columns(prefix)),
    *(("scene_points", column) for column in ("x_m", "y_m", "z_m")),
]


@pytest.fixture
def release(small_release: Path, tmp_path: Path) -> Path:
    return copy_of(small_release, tmp_path / "release")


@pytest.fixture
def copy(checkpoint: Path, tmp_path: Path) -> Path:
    return copy_of(checkpoint, tmp_path / "checkpoint")


class Commands:
    """Both commands; each way to run one demands that it refuses."""

    def __init__(self, release: Path, checkpoint: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
        self.release, self.checkpoint, self.tmp_path, self.capfd = release, checkpoint, tmp_path, capfd

    def training(self, out: Path | None = None, *more: str) -> str:
        arguments = ["--release", str(self.release), "--out", str(out or self.tmp_path / "new" / "ranker"), "--setting", "light", *more]
        return self._refused(training.main, arguments)

    def scoring(self, out: Path | None = None, checkpoint: Path | None = None, *more: str) -> str:
        arguments = ["--release", str(self.release), "--checkpoint", str(checkpoint or self.checkpoint)]
        return self._refused(scoring.main, [*arguments, "--out", str(out or self.tmp_path / "new" / "predictions.parquet"), *more])

    def both(self) -> str:
        """The line that both commands say."""
        said = self.training()
        assert self.scoring() == said
        return said

    def _refused(self, main: Callable[[list[str]], int], arguments: list[str]) -> str:
        before = _contents(self.tmp_path)
        self.capfd.readouterr()
        assert main(arguments) == 1
        (line,) = self.capfd.readouterr().err.splitlines()
        assert _contents(self.tmp_path) == before
        assert line.startswith("error: ")
        return line


@pytest.fixture
def commands(release: Path, checkpoint: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> Commands:
    return Commands(release, checkpoint, tmp_path, capfd)


@pytest.mark.parametrize(("table", "column"), _REAL_COLUMNS)
def test_a_number_that_is_not_finite_is_named_by_row_and_column(release: Path, table: str, column: str) -> None:
    for value in (NAN, INF, -INF):
        set_values(release, table, 3, {column: value})
        row = pq.read_table(release / f"{table}.parquet").slice(3, 1).to_pylist()[0]
        named = ", ".join(f"{key} {row[key]}" for key in ALL_SCHEMAS[table].key)
        with pytest.raises(InputError, match=rf"{table}\.parquet: {named}: {column} is {value}, must be finite$"):
            read_inputs(InputReader(release))


@pytest.mark.parametrize(
    ("table", "values", "problem"),
    [
        ("targets", {"target_qx": NAN}, "scene_id full-0000, target_id 3: target_qx is nan, must be finite"),
        ("grasps", {"grasp_z_m": -INF}, "scene_id full-0000, grasp_id 3: grasp_z_m is -inf, must be finite"),
        ("scenes", {"object_x_m": INF}, "scene_id full-0003: object_x_m is inf, must be finite"),
        ("scene_points", {"y_m": NAN}, "scene_id full-0000, point 3: y_m is nan, must be finite"),
        ("targets", {"target_x_m": 1e300}, "target_id 3: target_x_m is 1e+300 m, must be within 1000 m of 0"),
        ("scene_points", {"z_m": -1000.5}, "point 3: z_m is -1000.5 m, must be within 1000 m of 0"),
        ("grasps", {"grasp_x_m": None}, "grasp_id 3: grasp_x_m is null, must have a value"),
        ("scene_points", {"scene_id": None}, "scene_id None, point 3: scene_id is null, must have a value"),
        ("scene_points", {"point_type": "ghost"}, "point 3: point_type is 'ghost', must be one of"),
        ("targets", {"target_id": 0}, "scene_id full-0000, target_id 0 has 2 rows or more, must have 1"),
        ("candidates", {"target_id": 7}, "candidates: "),
    ],
)
def test_an_impossible_value_is_named_by_both(commands: Commands, table: str, values: dict[str, Any], problem: str) -> None:
    if table == "candidates":  # a second row of one candidate
        rows = pq.read_table(commands.release / "candidates.parquet")
        rewrite(commands.release / "candidates.parquet", pa.concat_tables([rows, rows.slice(3, 1)]))
        problem = "has 2 rows or more, must have 1"
    else:
        set_values(commands.release, table, 3, values)
    said = commands.both()
    assert f"{table}.parquet: " in said
    assert said.endswith(problem) or f"{problem} [" in said


@pytest.mark.parametrize(("table", "prefix"), _POSES.items())
@pytest.mark.parametrize(("length", "shown"), [(0.0, "0"), (1e-7, "1e-07"), (1e200, "inf")])
def test_a_quaternion_without_direction_is_named(commands: Commands, table: str, prefix: str, length: float, shown: str) -> None:
    columns = pose_columns(prefix)[3:]
    set_values(commands.release, table, 2, {column: length if column == columns[0] else 0.0 for column in columns})
    said = commands.both()
    assert f"{table}.parquet: scene_id full-000" in said
    assert said.endswith(f"quaternion {prefix}_qx ... {prefix}_qw has length {shown}, must be finite and at least 1e-06")


@pytest.mark.parametrize(
    ("column", "value", "problem"),
    [
        ("y_plan", None, "y_plan is null, must have a value"),
        ("y_pipe", None, "y_plan is true and y_pipe null, must have both labels"),
    ],
)
def test_an_impossible_label_is_named_by_training(commands: Commands, column: str, value: None, problem: str) -> None:
    rows = pq.read_table(commands.release / "candidates.parquet")
    planned = rows["y_plan"].to_pylist().index(True)
    set_values(commands.release, "candidates", planned, {column: value})
    assert f"candidates.parquet: candidate_id {rows['candidate_id'][planned]}: {problem}" in commands.training()


def test_a_split_that_is_none_is_named_by_training(commands: Commands) -> None:
    set_values(commands.release, "splits", 1, {"split": "holdout"})
    assert "splits.parquet: scene_id full-0001: split is 'holdout', must be one of ['train', 'validation', 'test']" in commands.training()


def test_a_column_of_another_type_is_named(commands: Commands) -> None:
    path = commands.release / "grasps.parquet"
    rows = pq.read_table(path)
    rewrite(path, rows.set_column(rows.column_names.index("grasp_qw"), "grasp_qw", rows["grasp_qw"].cast(pa.string())))
    assert "grasps.parquet: column grasp_qw has type string, must be double" in commands.both()


def test_columns_of_another_width_are_read_as_they_are(small_release: Path, release: Path) -> None:
    """Other writers choose 64-bit numbers, large strings and no dictionaries; the inputs are the same to the bit."""
    for table in KEY_COLUMNS:
        rows = pq.read_table(release / f"{table}.parquet")
        wider = {pa.int32(): pa.int64(), pa.float32(): pa.float64(), pa.dictionary(pa.int16(), pa.string()): pa.large_string()}
        fields = [field.with_type(wider.get(field.type, field.type)) for field in rows.schema]
        plain = [rows[field.name].cast(pa.string()) if pa.types.is_dictionary(field.type) else rows[field.name] for field in rows.schema]
        rewrite(release / f"{table}.parquet", pa.table([c.cast(f.type) for c, f in zip(plain, fields)], schema=pa.schema(fields)))
    mine, theirs = read_inputs(InputReader(release)), read_inputs(InputReader(small_release))
    assert mine.candidate_ids == theirs.candidate_ids
    assert mine.T_grasp_object.tobytes() == theirs.T_grasp_object.tobytes()
    assert all(a.points_m.tobytes() == b.points_m.tobytes() for a, b in zip(mine.clouds, theirs.clouds, strict=True))


@pytest.mark.parametrize("table", ["candidates", "scene_points"])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.999])
def test_a_truncated_table_is_named(commands: Commands, table: str, share: float) -> None:
    cut(commands.release / f"{table}.parquet", share)
    assert re.search(rf"{table}\.parquet: cannot be read as a table \(.+\)$", commands.both())


def test_a_table_with_bad_bytes_inside_is_named(commands: Commands) -> None:
    """The footer is whole, a page is not."""
    path = commands.release / "scene_points.parquet"
    content = bytearray(path.read_bytes())
    content[200:264] = bytes(64)
    path.write_bytes(content)
    assert re.search(r"scene_points\.parquet: cannot be read as a table \(.+\)$", commands.both())


def test_an_id_that_is_no_text_is_named(commands: Commands) -> None:
    """Bytes that are not UTF-8 pass through Parquet."""
    path = commands.release / "candidates.parquet"
    rows = pq.read_table(path)
    ids = [candidate_id.encode() for candidate_id in rows["candidate_id"].to_pylist()]
    broken = pa.array([b"\xff\xfe", *ids[1:]]).cast(pa.string(), safe=False)
    rewrite(path, rows.set_column(rows.column_names.index("candidate_id"), "candidate_id", broken))
    assert re.search(r"candidates\.parquet: cannot be read as a table \(.*UTF8.*\)$", commands.both())


@pytest.mark.parametrize("table", sorted(KEY_COLUMNS))
def test_a_missing_table_is_named(commands: Commands, table: str) -> None:
    (commands.release / f"{table}.parquet").unlink()
    said = commands.training() if table == "splits" else commands.both()
    assert said.endswith(f"{table}.parquet: missing, must be a Parquet table of the release")


def test_a_table_that_is_a_folder_is_named(commands: Commands) -> None:
    (commands.release / "targets.parquet").unlink()
    (commands.release / "targets.parquet").mkdir()
    assert commands.both().endswith("targets.parquet: not a file, must be a Parquet table of the release")


def test_a_missing_release_is_named(commands: Commands, tmp_path: Path) -> None:
    commands.release = tmp_path / "nowhere"
    assert commands.both() == f"error: {tmp_path}/nowhere: missing, must be the folder of a release"
    (tmp_path / "nowhere").write_text("a file")
    assert commands.both() == f"error: {tmp_path}/nowhere: not a folder, must be the folder of a release"


@pytest.mark.parametrize("table", sorted({table for sources in FIVE_INPUTS.values() for table in sources} | {"candidates"}))
def test_a_table_that_its_sidecar_contradicts_is_named(commands: Commands, table: str) -> None:
    edit_json(commands.release / f"{table}.parquet.json", lambda sidecar: sidecar.update(sha256="0" * 64))
    assert re.search(rf"{table}\.parquet: SHA-256 \w+, {table}\.parquet\.json says 000000000000; the table was changed", commands.both())


def test_a_table_that_the_manifest_contradicts_is_named(commands: Commands) -> None:
    write_manifest(commands.release)
    path = commands.release / "targets.parquet"
    rows = pq.read_table(path)
    rewrite(path, rows.take(list(range(len(rows)))[::-1]))
    assert re.search(r"targets\.parquet: SHA-256 \w+, manifest\.json says \w+; the table was changed", commands.both())


def test_a_manifest_that_does_not_list_a_table_is_named(commands: Commands) -> None:
    write_manifest(commands.release)
    edit_json(commands.release / "manifest.json", lambda manifest: manifest["files"].pop("grasps.parquet"))
    assert commands.both().endswith("manifest.json: does not list table grasps, which the ranker reads")


@pytest.mark.parametrize("name", ["manifest.json", "targets.parquet.json"])
def test_a_broken_manifest_or_sidecar_is_named(commands: Commands, name: str) -> None:
    write_manifest(commands.release)
    cut(commands.release / name, 0.5)
    assert f"{name}: cannot be read as JSON" in commands.both()
    (commands.release / name).write_text("[]")
    assert f"{name}: holds a JSON list, must be an object" in commands.both()


@pytest.mark.parametrize("split", ["train", "validation"])
def test_a_split_without_candidates_is_named_by_training(commands: Commands, split: str) -> None:
    """Its scenes are there, but no grasp of theirs was lifted."""
    splits = dict(zip(*(pq.read_table(commands.release / "splits.parquet")[name].to_pylist() for name in ("scene_id", "split"))))
    rows = pq.read_table(commands.release / "candidates.parquet")
    rewrite(
        commands.release / "candidates.parquet", rows.filter(pa.array([splits[scene] != split for scene in rows["scene_id"].to_pylist()]))
    )
    assert commands.training().endswith(f"release: the {split} split has 0 candidates, must have at least 1")


def test_a_release_without_candidates_is_named(commands: Commands) -> None:
    rewrite(commands.release / "candidates.parquet", pq.read_table(commands.release / "candidates.parquet").slice(0, 0))
    assert commands.training().endswith("release: the train split has 0 candidates, must have at least 1")
    assert commands.scoring().endswith("candidates.parquet: no candidates to score, must have at least 1")


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
    before = _contents(tmp_path)
    set_values(commands.release, "targets", 3, {"target_qx": NAN})
    after_damage = _contents(tmp_path)
    commands.scoring(out)
    assert _contents(tmp_path) == after_damage
    assert {path: content for path, content in before.items() if path.parent == tmp_path} == {
        path: content for path, content in after_damage.items() if path.parent == tmp_path
    }


def test_decision_times_of_fewer_than_no_scenes_are_refused(commands: Commands) -> None:
    assert commands.scoring(None, None, "--time", "-1") == "error: --time: -1 scenes, must be at least 0"


@pytest.mark.parametrize("command", ["training", "scoring"])
def test_the_process_itself_ends_with_one_line_and_code_1(release: Path, checkpoint: Path, tmp_path: Path, command: str) -> None:
    set_values(release, "targets", 3, {"target_qx": NAN})
    more = ["--setting", "light"] if command == "training" else ["--checkpoint", str(checkpoint)]
    arguments = ["-m", f"model.{command}", "--release", str(release), "--out", str(tmp_path / "out"), *more]
    ended = subprocess.run([sys.executable, *arguments], capture_output=True, text=True, check=False, cwd=Path(__file__).parents[2])
    assert ended.returncode == 1
    assert re.fullmatch(r"error: \S+targets\.parquet: scene_id full-0000, target_id 3: target_qx is nan, must be finite\n", ended.stderr)
    assert not (tmp_path / "out").exists()


def _contents(folder: Path) -> dict[Path, bytes | None]:
    return {path: path.read_bytes() if path.is_file() else None for path in sorted(folder.rglob("*"))}
