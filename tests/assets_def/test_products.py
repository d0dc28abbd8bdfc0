"""Products are made once, kept while their inputs and files stay the same, and made again after any change or damage."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest

from assets_def.inputs import hash_over_shards, source_version
from assets_def.products import FilesProduct, TableProduct
from assets_def.resources import REPOSITORY, Benchmark
from tables.schemas import SCENES, SPLITS
from tables.store import read_sidecar, sidecar_path, table_from_rows, write_table
from tests.split_rows import split_row

ROWS = table_from_rows(SPLITS, [split_row("mini-0000", "train"), split_row("mini-0001", "test")])
MADE_FROM = {"code": "1", "table.scenes": "abc"}


def never() -> Any:
    raise AssertionError("made again, although nothing changed")


def table_product(folder: Path, made_from: dict[str, str] = MADE_FROM) -> TableProduct:
    return TableProduct(SPLITS, folder / "splits.parquet", made_from, "mini")


def files_product(folder: Path, made_from: dict[str, str] = MADE_FROM) -> FilesProduct:
    return FilesProduct(folder / "report.made_from.json", made_from)


def write_files(folder: Path) -> Callable[[], tuple[list[Path], dict[str, Any]]]:
    def make() -> tuple[list[Path], dict[str, Any]]:
        (folder / "report.md").write_text("text")
        (folder / "report.png").write_bytes(b"picture")
        return [folder / "report.png", folder / "report.md"], {"n": 3}

    return make


def test_a_table_is_made_once_and_says_what_from(tmp_path: Path) -> None:
    product = table_product(tmp_path)
    assert not product.is_current()
    (made,) = product.publish(lambda: ROWS)
    assert read_sidecar(product.path).made_from == MADE_FROM
    (kept,) = product.publish(never)
    assert (made.metadata or {})["reused"] is False
    assert (kept.metadata or {})["reused"] is True
    assert made.data_version == kept.data_version is not None
    assert made.asset_key == kept.asset_key


@pytest.mark.parametrize(
    "damage",
    [
        lambda path: path.write_bytes(path.read_bytes()[:-1]),
        lambda path: path.unlink(),
        lambda path: sidecar_path(path).unlink(),
        lambda path: sidecar_path(path).write_text("{"),
        lambda path: sidecar_path(path).write_text(json.dumps({"table": "splits"})),
        lambda path: sidecar_path(path).write_text(sidecar_path(path).read_text().replace('"schema_version": "', '"schema_version": "0')),
    ],
    ids=["shorter", "no table", "no sidecar", "no JSON", "no sidecar's fields", "another schema"],
)
def test_a_damaged_table_is_made_again(tmp_path: Path, damage: Callable[[Path], None]) -> None:
    product = table_product(tmp_path)
    list(product.publish(lambda: ROWS))
    before = read_sidecar(product.path)
    damage(product.path)
    assert not product.is_current()
    (made,) = product.publish(lambda: ROWS)
    assert (made.metadata or {})["reused"] is False
    assert read_sidecar(product.path) == before


@pytest.mark.parametrize("made_from", [{"code": "2", "table.scenes": "abc"}, {"code": "1"}, MADE_FROM | {"more": "x"}])
def test_other_inputs_make_table_and_files_again(tmp_path: Path, made_from: dict[str, str]) -> None:
    list(table_product(tmp_path).publish(lambda: ROWS))
    files_product(tmp_path).publish(write_files(tmp_path))
    assert not table_product(tmp_path, made_from).is_current()
    assert not files_product(tmp_path, made_from).is_current()
    record, is_reused = files_product(tmp_path, made_from).publish(write_files(tmp_path))
    assert not is_reused
    assert record.made_from == made_from


def test_files_are_made_once_and_their_record_is_relative(tmp_path: Path) -> None:
    product = files_product(tmp_path)
    record, is_reused = product.publish(write_files(tmp_path))
    assert not is_reused
    assert sorted(record.files) == ["report.md", "report.png"]
    assert product.publish(never) == (record, True)
    moved = tmp_path.rename(tmp_path.with_name(f"{tmp_path.name}-moved"))
    assert files_product(moved).publish(never) == (record, True)


@pytest.mark.parametrize(
    "damage",
    [
        lambda folder: (folder / "report.png").write_bytes(b"another"),
        lambda folder: (folder / "report.md").unlink(),
        lambda folder: (folder / "report.made_from.json").unlink(),
        lambda folder: (folder / "report.made_from.json").write_text("{"),
        lambda folder: (folder / "report.made_from.json").write_text("{}"),
    ],
    ids=["changed", "no file", "no record", "no JSON", "empty"],
)
def test_damaged_files_are_made_again(tmp_path: Path, damage: Callable[[Path], None]) -> None:
    product = files_product(tmp_path)
    before, _ = product.publish(write_files(tmp_path))
    damage(tmp_path)
    assert product.publish(write_files(tmp_path)) == (before, False)


def test_an_interrupted_making_leaves_no_record_of_the_old_files(tmp_path: Path) -> None:
    files_product(tmp_path).publish(write_files(tmp_path))
    with pytest.raises(AssertionError):
        files_product(tmp_path, {"code": "2"}).publish(never)
    assert files_product(tmp_path).current() is None


def test_the_content_hash_of_files_is_of_names_and_bytes(tmp_path: Path) -> None:
    before, _ = files_product(tmp_path).publish(write_files(tmp_path))
    (tmp_path / "report.png").write_bytes(b"another")
    changed, _ = files_product(tmp_path).publish(lambda: ([tmp_path / "report.md", tmp_path / "report.png"], {}))
    assert before.content_hash != changed.content_hash
    assert files_product(tmp_path).publish(never)[0].content_hash == changed.content_hash


def test_the_hash_over_shards_is_of_every_shard_s_content(tmp_path: Path) -> None:
    benchmark = Benchmark(data_dir=str(tmp_path))
    for shard in ("full-000", "full-001", "full-002", "full-003"):
        write_table(SCENES, _scene(shard), benchmark.root.shard_table(shard, "scenes"))
    before = hash_over_shards(benchmark, "pilot", "scenes")
    write_table(SCENES, _scene("full-002"), benchmark.root.shard_table("full-002", "scenes"), {"code": "another"})
    assert hash_over_shards(benchmark, "pilot", "scenes") == before, "the same values, made otherwise"
    write_table(SCENES, _scene("full-002", n_attempts=2), benchmark.root.shard_table("full-002", "scenes"))
    assert hash_over_shards(benchmark, "pilot", "scenes") != before


def _scene(shard: str, n_attempts: int = 1) -> pa.Table:
    row = {
        "scene_id": f"{shard[:4]}-0{shard[5:]}",
        "scene_index": int(shard[5:]),
        "object_id": "can_01",
        "category": "can",
        "n_obstacles": 0,
    }
    pose = {name: 0.0 for name in SCENES.names if name.startswith("object_") and name != "object_id"}
    return table_from_rows(SCENES, [row | pose | {"n_obstacles": 0, "stable_pose_id": 0, "n_attempts": n_attempts}])


def test_the_version_of_sources_changes_with_a_word(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert source_version("reports") != source_version("reports", "splits/markdown.py")
    monkeypatch.setattr("assets_def.inputs.REPOSITORY", tmp_path)
    (tmp_path / "reports").mkdir()
    (tmp_path / "reports" / "a.py").write_text('"""One word."""\n')
    before = source_version("reports")
    (tmp_path / "reports" / "notes.md").write_text("no code")
    assert source_version("reports") == before
    (tmp_path / "reports" / "a.py").write_text('"""Two words."""\n')
    assert source_version("reports") != before
    assert tmp_path != REPOSITORY
