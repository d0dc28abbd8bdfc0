"""Whatever happens to a table on disk is one line with its path for who reads it, and a reason to make it again for who builds it."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tables.columns import SchemaError, TableSchema, plain, real
from tables.errors import PlaceBenchError
from tables.identity import IdentityError
from tables.schemas import SPLITS
from tables.sidecar import Missing, Sidecar, find_published
from tables.store import StoreError, read_sidecar, read_table, read_tables, sidecar_path, table_from_rows, write_table
from tests.split_rows import split_row
from tests.tables.damage import SIDECAR_DAMAGE, TABLE_DAMAGE, Damage

POINTS = TableSchema("points", "rows for tests", ("id",), (plain("id", "key"), real("x_m", "x", "m")))
MARKS = TableSchema("marks", "the same columns under another name", ("id",), POINTS.columns)
MADE_FROM = {"code": "1", "recipe": "abc"}


def _write(path: Path, of: str = "mini-000", x_m: float = 0.0, schema: TableSchema = POINTS) -> Path:
    write_table(schema, table_from_rows(schema, [{"id": f"{k:03d}", "x_m": x_m + k / 7} for k in range(40)]), path, MADE_FROM, of=of)
    return path


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return _write(tmp_path / "points.parquet")


def _found(path: Path, schema: TableSchema = POINTS, of: str = "mini-000") -> Sidecar | Missing:
    return find_published(schema, path, MADE_FROM, of)


def _refusal(path: Path, schema: TableSchema = POINTS, **how) -> str:
    """The error of `read_table`: nothing but a StoreError, in one line that starts with the path."""
    with pytest.raises(StoreError) as refusal:
        read_table(schema, path, **how)
    assert str(refusal.value).startswith(f"{path}: ")
    assert "\n" not in str(refusal.value)
    return str(refusal.value)


@pytest.mark.parametrize("damage", SIDECAR_DAMAGE.values(), ids=SIDECAR_DAMAGE)
def test_a_damaged_sidecar_is_one_line_for_a_reader_and_a_reason_for_a_builder(damage: Damage, path: Path) -> None:
    damage(path)
    for verify in (False, True):
        assert "sidecar" in _refusal(path, verify=verify)
    with pytest.raises(StoreError, match=r"points\.parquet: sidecar"):
        read_sidecar(path)
    missing = _found(path)
    assert isinstance(missing, Missing)
    assert missing.is_damaged
    assert str(missing).startswith("points of mini-000: sidecar")
    assert "\n" not in str(missing)


@pytest.mark.parametrize("damage", TABLE_DAMAGE.values(), ids=TABLE_DAMAGE)
def test_a_damaged_table_is_one_line_for_a_reader_and_a_reason_for_a_builder(damage: Damage, path: Path) -> None:
    damage(path)
    _refusal(path)
    _refusal(path, verify=True)
    missing = _found(path)
    assert isinstance(missing, Missing)
    assert missing.is_damaged
    assert str(missing).startswith("points of mini-000: ")
    assert "\n" not in str(missing)


@pytest.mark.parametrize("damage", [*SIDECAR_DAMAGE.values(), *TABLE_DAMAGE.values()], ids=[*SIDECAR_DAMAGE, *TABLE_DAMAGE])
def test_writing_again_heals_every_damage(damage: Damage, path: Path) -> None:
    before = read_sidecar(path)
    damage(path)
    _write(path)
    assert _found(path) == read_sidecar(path) == before
    assert read_table(POINTS, path, verify=True).num_rows == 40


def test_what_was_written_is_found(path: Path) -> None:
    assert _found(path) == read_sidecar(path)
    assert read_sidecar(path).of == "mini-000"


def test_what_is_not_there_or_not_finished_is_missing_but_not_damaged(path: Path) -> None:
    sidecar_path(path).unlink()
    assert _found(path) == Missing("points", "mini-000", "has no sidecar, so it was never finished", is_damaged=False)
    path.unlink()
    assert _found(path) == Missing("points", "mini-000", "not there", is_damaged=False)
    assert "not published" in _refusal(path)


def test_a_sidecar_without_its_table_is_damage(path: Path) -> None:
    path.unlink()
    missing = _found(path)
    assert isinstance(missing, Missing)
    assert missing.is_damaged
    assert "not published" in _refusal(path)


def test_a_table_made_from_other_inputs_is_missing_and_says_which(path: Path) -> None:
    missing = find_published(POINTS, path, {"code": "2", "recipe": "abc", "engine.ompl": "2.0"}, "mini-000")
    assert missing == Missing("points", "mini-000", "made from other inputs: code, engine.ompl", is_damaged=False)
    assert isinstance(find_published(POINTS, path, {"code": "1"}, "mini-000"), Missing)


@pytest.mark.parametrize("with_sidecars", [False, True], ids=["files", "files and sidecars"])
@pytest.mark.parametrize("other", [MARKS, SPLITS], ids=["same columns", "other columns"])
def test_two_swapped_tables_are_noticed(with_sidecars: bool, other: TableSchema, path: Path) -> None:
    second = path.with_name(f"{other.name}.parquet")
    if other is MARKS:
        _write(second, x_m=1.0, schema=MARKS)
    else:
        write_table(SPLITS, table_from_rows(SPLITS, [split_row("full-0001", "train")]), second, MADE_FROM, of="mini-000")
    _swap(path, second)
    if with_sidecars:
        _swap(sidecar_path(path), sidecar_path(second))
    for schema, swapped in ((POINTS, path), (other, second)):
        _refusal(swapped, schema, verify=True)
        if with_sidecars or other is SPLITS:
            _refusal(swapped, schema)
        missing = _found(swapped, schema)
        assert isinstance(missing, Missing)
        assert missing.is_damaged


def test_two_swapped_shards_are_noticed(tmp_path: Path) -> None:
    shards = {name: _write(tmp_path / name / "points.parquet", of=name, x_m=k) for k, name in enumerate(("full-000", "full-001"))}
    assert all(isinstance(_found(path, of=name), Sidecar) for name, path in shards.items())
    _swap(tmp_path / "full-000", tmp_path / "full-001")
    for name, path in shards.items():
        stranger = "full-001" if name == "full-000" else "full-000"
        assert _found(path, of=name) == Missing("points", name, f"is of '{stranger}', expected '{name}'", is_damaged=True)
        assert f"is of '{stranger}', expected '{name}'" in _refusal(path, of=name)
        assert read_table(POINTS, path).num_rows == 40
    with pytest.raises(StoreError, match="is of 'full-001', expected 'full-000'"):
        read_tables(POINTS, list(shards.values())[:1], of=["full-000"])


def test_whose_a_table_is_does_not_change_its_content_hash(tmp_path: Path) -> None:
    hashes = {read_sidecar(_write(tmp_path / f"{k}.parquet", of=of)).content_hash for k, of in enumerate(("", "mini-000", "pilot"))}
    assert len(hashes) == 1


def test_a_table_with_rows_cut_away_is_noticed_without_hashing(path: Path, tmp_path: Path) -> None:
    short = tmp_path / "short.parquet"
    write_table(POINTS, table_from_rows(POINTS, [{"id": "000", "x_m": 0.0}]), short)
    shutil.copyfile(short, path)
    assert "has 1 rows, sidecar says 40" in _refusal(path)


def test_a_value_that_the_schema_forbids_is_noticed_though_every_hash_fits(tmp_path: Path) -> None:
    loose = TableSchema("points", "with a looser key", ("id", "x_m"), POINTS.columns)
    path = tmp_path / "points.parquet"
    write_table(loose, table_from_rows(loose, [{"id": "a", "x_m": x_m} for x_m in (0.0, 1.0)]), path)
    assert "1 repeated keys" in _refusal(path, verify=True)


def test_links_that_lead_nowhere_are_damage(path: Path) -> None:
    sidecar_path(path).unlink()
    sidecar_path(path).symlink_to("nowhere")
    missing = _found(path)
    assert isinstance(missing, Missing)
    assert missing.is_damaged
    _refusal(path)
    _write(path)
    assert isinstance(_found(path), Sidecar)


def test_every_error_of_this_room_is_of_the_one_family() -> None:
    for error, builtin in ((SchemaError, ValueError), (StoreError, RuntimeError), (IdentityError, ValueError)):
        assert issubclass(error, PlaceBenchError)
        assert issubclass(error, builtin)


def _swap(a: Path, b: Path) -> None:
    aside = a.with_name("aside")
    for source, target in ((a, aside), (b, a), (aside, b)):
        source.rename(target)
