"""The columns that a checkpoint records are those that its training read, and a record that is not the contract turns the check red."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from model import inputs
from model.checkpoint import input_errors, load_checkpoint
from model.errors import CheckpointError, InputError
from model.inputs import FIVE_INPUTS, FORBIDDEN_COLUMNS, KEY_COLUMNS, InputReader
from model.release_tables import read_table_columns
from model.settings import RankerSettings
from model.training import train
from tests.model.damage import edit_json, rewrite

_LABELS = ["y_plan", "y_pipe"]


def test_a_trained_checkpoint_records_the_contract(checkpoint: Path) -> None:
    assert input_errors(checkpoint) == []
    recorded = _record(checkpoint)
    named = {(table, column) for sources in (*FIVE_INPUTS.values(), KEY_COLUMNS) for table, names in sources.items() for column in names}
    assert {(table, column) for table, columns in recorded.items() for column in columns} == named


def test_training_needs_what_is_recorded_and_the_labels_and_nothing_else(
    small_release: Path, checkpoint: Path, tiny: RankerSettings, tmp_path: Path
) -> None:
    """A release stripped to the recorded columns trains the same weights to the bit; without any one of them there is no training."""
    recorded = _record(checkpoint)
    stripped = tmp_path / "stripped"
    stripped.mkdir()
    for table, columns in recorded.items():
        labels = _LABELS if table == "candidates" else []
        pq.write_table(pq.read_table(small_release / f"{table}.parquet", columns=[*columns, *labels]), stripped / f"{table}.parquet")
    train(stripped, "full", 7, tiny, tmp_path / "ranker")
    assert (tmp_path / "ranker" / "ranker.safetensors").read_bytes() == (checkpoint / "ranker.safetensors").read_bytes()
    for table, columns in recorded.items():
        whole = pq.read_table(stripped / f"{table}.parquet")
        for column in columns:
            rewrite(stripped / f"{table}.parquet", whole.drop_columns([column]))
            with pytest.raises(InputError, match=rf"{table}\.parquet: column {column} is missing"):
                train(stripped, "full", 7, tiny, tmp_path / "ranker")
        rewrite(stripped / f"{table}.parquet", whole)


@pytest.mark.parametrize(
    ("table", "column"),
    [
        ("grasps", "lift_slip_m"),
        ("grasps", "inhand_x_m"),
        ("candidates", "y_plan"),
        ("candidates", "final_qw"),
        ("plans", "via_q_rad"),
    ],
)
def test_a_planted_forbidden_column_is_named(copy: Path, table: str, column: str) -> None:
    assert column in FORBIDDEN_COLUMNS
    edit_json(copy / "ranker.json", lambda described: described["input_columns"].setdefault(table, []).append(column))
    assert input_errors(copy) == [f"{table}.{column}: known only after pick-lift, planning or execution, must not be a model input"]


@pytest.mark.parametrize(
    ("table", "column"), [("objects", "mass_kg"), ("targets", "resting"), ("policy_features", "ik_feasible"), ("no_table", "no_column")]
)
def test_a_planted_unknown_column_is_named(copy: Path, table: str, column: str) -> None:
    edit_json(copy / "ranker.json", lambda described: described["input_columns"].setdefault(table, []).append(column))
    (error,) = input_errors(copy)
    assert error.startswith(f"{table}.{column}: not one of the five inputs")


def test_each_dropped_column_and_each_dropped_table_is_named(checkpoint: Path, copy: Path) -> None:
    described = json.loads((checkpoint / "ranker.json").read_text())
    for table, columns in described["input_columns"].items():
        for column in columns:
            left = {**described["input_columns"], table: [name for name in columns if name != column]}
            (copy / "ranker.json").write_text(json.dumps({**described, "input_columns": left}))
            assert input_errors(copy) == [f"{table}.{column}: not read, must be: the contract names it"]
        left = {name: columns for name, columns in described["input_columns"].items() if name != table}
        (copy / "ranker.json").write_text(json.dumps({**described, "input_columns": left}))
        assert [error.split(":")[0] for error in input_errors(copy)] == [f"{table}.{column}" for column in columns]


def test_a_checkpoint_without_a_record_is_named(copy: Path) -> None:
    edit_json(copy / "ranker.json", lambda described: described.pop("input_columns"))
    (error,) = input_errors(copy)
    assert "ranker.json: input_columns is missing or empty" in error


@pytest.mark.parametrize(
    ("record", "message"),
    [
        ({}, "missing or empty"),
        ([], "missing or empty"),
        (None, "missing or empty"),
        (["x_m"], "must map"),
        ({"targets": "qw"}, "must map"),
    ],
)
def test_a_record_that_is_none_is_named(copy: Path, record: Any, message: str) -> None:
    edit_json(copy / "ranker.json", lambda described: described.update(input_columns=record))
    (error,) = input_errors(copy)
    assert message in error


def test_a_folder_without_a_checkpoint_is_named(tmp_path: Path) -> None:
    (error,) = input_errors(tmp_path)
    assert "ranker.json: missing" in error


def test_the_record_is_of_the_reading_and_not_of_the_contract(
    small_release: Path, tiny: RankerSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A door that lets a column too many through, and one that forgets to read one, show in what they leave behind."""
    with monkeypatch.context() as patched:
        let_through(patched, "grasps", "lift_slip_m")
        train(small_release, "full", 7, tiny, tmp_path / "leaking")
    assert input_errors(tmp_path / "leaking") == [
        "grasps.lift_slip_m: known only after pick-lift, planning or execution, must not be a model input"
    ]
    with monkeypatch.context() as patched:
        patched.setitem(inputs.__dict__, "KEY_COLUMNS", {**KEY_COLUMNS, "scene_points": ("scene_id",)})
        train(small_release, "full", 7, tiny, tmp_path / "forgetful")
    assert input_errors(tmp_path / "forgetful") == ["scene_points.point: not read, must be: the contract names it"]


def let_through(patched: pytest.MonkeyPatch, table: str, column: str) -> None:
    """Make the door read one more column of a table, unchecked: the fault that the record is there for."""
    monitored = InputReader.columns

    def columns(self: InputReader, name: str, asked: Sequence[str]) -> pa.Table:
        return monitored(self, name, (*asked, column) if name == table else asked)

    patched.setattr(inputs, "check_columns", lambda table, columns, scheme: None)
    patched.setattr(InputReader, "columns", columns)


def test_an_edited_record_is_not_scored_with(copy: Path) -> None:
    edit_json(copy / "ranker.json", lambda described: described["input_columns"]["grasps"].append("lift_slip_m"))
    with pytest.raises(CheckpointError, match=r"ranker\.json: SHA-256 .* changed after training"):
        load_checkpoint(copy)


def test_the_record_names_columns_that_the_file_gave(small_release: Path) -> None:
    reader = InputReader(small_release)
    assert reader.selected == {}
    rows = reader.columns("targets", ("target_id", "scene_id"))
    assert reader.selected == {"targets": ["scene_id", "target_id"]}
    assert rows.equals(read_table_columns(small_release, "targets", ("target_id", "scene_id")))


def _record(checkpoint: Path) -> dict[str, list[str]]:
    record: dict[str, list[str]] = json.loads((checkpoint / "ranker.json").read_text())["input_columns"]
    return record
