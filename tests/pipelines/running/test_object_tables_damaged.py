"""Builds that fail, are killed or are damaged later: what is whole is kept, what is not is made again, one line each."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from objects.build import ObjectParams
from objects.catalogue import ObjectSpec
from objects.errors import CatalogueError, ObjectError
from pipelines.running import object_store, object_tables
from pipelines.running.data_root import DataRoot
from pipelines.running.object_tables import ObjectTablesError
from tables.schemas import ALL_SCHEMAS, OBJECT_TABLES
from tables.store import StoreError, read_table, sidecar_path
from tests.objects.test_catalogue import BOX
from tests.pipelines.running.object_builds import BRICK, CRATE, THREE, TIN, hashes, make, rows_of


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def change(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(bytes(content))


def empty(path: Path) -> None:
    path.write_bytes(b"")


def other_json(path: Path) -> None:
    path.write_text('["not", "a", "sidecar"]')


def binary(path: Path) -> None:
    path.write_bytes(b"\xff\xfe\x00")


DAMAGES: tuple[tuple[str, Callable[[Path], None]], ...] = (
    ("grasp_pool.parquet", cut),
    ("grasp_pool.parquet", change),
    ("objects.parquet", empty),
    ("object_meshes.parquet", Path.unlink),
    ("stable_poses.parquet.json", Path.unlink),
    ("stable_poses.parquet.json", cut),
    ("objects.parquet.json", empty),
    ("object_parts.parquet.json", other_json),
    ("object_parts.parquet.json", binary),
)


@pytest.mark.parametrize(("name", "damage"), DAMAGES, ids=[f"{damage.__name__} {name}" for name, damage in DAMAGES])
def test_damaged_remains_of_an_object_are_built_again_with_one_line(
    name: str, damage: Callable[[Path], None], root: DataRoot, built: list[str], stored: Path
) -> None:
    damage(root.built_object("brick", "objects").with_name(name))
    sidecars, lines = make(root, *THREE)
    assert lines == ["objects: up to date"], "what is published is whole"
    root.object_table("objects").unlink()
    sidecar_path(root.object_table("objects")).unlink()
    sidecars, lines = make(root, *THREE)
    assert built == ["brick"]
    assert [line for line in lines if "brick damaged or half written, made again: " in line] == lines[1:2]
    assert "published tables damaged or half written" in lines[0]
    assert lines[2] == "objects: 2 of 3 unchanged"
    assert lines[3].startswith("objects: brick in ")
    assert len(lines) == 4
    assert {name: read_table(ALL_SCHEMAS[name], DataRoot(stored).object_table(name), verify=True) for name in OBJECT_TABLES} == {
        name: read_table(ALL_SCHEMAS[name], root.object_table(name), verify=True) for name in sidecars
    }


@pytest.mark.parametrize(("name", "damage"), DAMAGES, ids=[f"{damage.__name__} {name}" for name, damage in DAMAGES])
def test_a_damaged_published_table_is_written_again_and_nothing_is_built(
    name: str, damage: Callable[[Path], None], root: DataRoot, built: list[str]
) -> None:
    first = hashes(make(root, *THREE)[0])
    damage(root.object_table("objects").with_name(name))
    sidecars, lines = make(root, *THREE)
    assert len(lines) == 2
    assert "published tables damaged or half written, made again: " in lines[0]
    assert lines[1] == "objects: 3 of 3 unchanged"
    assert built == []
    assert hashes(sidecars) == first
    assert make(root, *THREE)[1] == ["objects: up to date"]


def test_the_tables_of_another_object_or_another_table_are_not_taken_for_its_own(root: DataRoot, built: list[str]) -> None:
    first = hashes(make(root, *THREE)[0])
    for path in root.path.glob("objects/*.parquet*"):
        path.unlink()
    folder = root.built_object("brick", "objects").parent
    shutil.rmtree(folder)
    shutil.copytree(root.built_object("box", "objects").parent, folder)
    meshes, parts = root.built_object("tin", "object_meshes"), root.built_object("tin", "object_parts")
    shutil.copy(meshes, parts)
    shutil.copy(sidecar_path(meshes), sidecar_path(parts))
    sidecars, lines = make(root, *THREE)
    assert hashes(sidecars) == first
    assert built == ["brick", "tin"]
    assert "tin damaged or half written" in lines[0]


def test_all_objects_that_fail_are_named_and_the_others_kept(tmp_path: Path, built: list[str]) -> None:
    root, wider = DataRoot(tmp_path / "data"), {**CRATE, "id": '"wider"', "size_m": "[0.2, 0.2, 0.2]"}
    with pytest.raises(ObjectTablesError, match=r"2 of 4 objects failed, must be 0; the others are kept") as failure:
        make(root, CRATE, BOX, wider, TIN)
    assert "crate: GraspError: crate: smallest graspable width 0.1000 m, must be at most 0.0750" in str(failure.value)
    assert "wider: GraspError: wider: smallest graspable width 0.2000 m, must be at most 0.0750" in str(failure.value)
    assert isinstance(failure.value, ObjectError)
    assert not root.object_table("objects").exists()
    narrow = {**CRATE, "size_m": "[0.05, 0.1, 0.1]"}
    _, lines = make(root, narrow, BOX, TIN)
    assert built == ["crate", "box", "wider", "tin", "crate"]
    assert lines[0] == "objects: 2 of 3 unchanged"


def test_a_failed_change_keeps_the_last_tables_and_the_last_build(root: DataRoot, built: list[str]) -> None:
    first = hashes(make(root, *THREE)[0])
    with pytest.raises(ObjectTablesError, match="1 of 3 objects failed"):
        make(root, {**BOX, "size_m": "[0.1, 0.1, 0.1]"}, BRICK, TIN)
    with pytest.raises(CatalogueError, match="box: mass_kg"):
        make(root, {**BOX, "mass_kg": "9"}, BRICK, TIN)
    assert make(root, *THREE)[1] == ["objects: up to date"]
    assert hashes(make(root, *THREE)[0]) == first
    assert built == ["box"]


def test_rows_that_no_table_allows_fail_their_object_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = object_tables.build_object

    def upside_down(spec: ObjectSpec, params: ObjectParams, seed: int):
        tables = real(spec, params, seed)
        if spec.object_id == "brick":
            tables.grasp_pool[3]["jaw_width_m"] = float("nan")
        return tables

    root = DataRoot(tmp_path / "data")
    with monkeypatch.context() as patch:
        patch.setattr(object_tables, "build_object", upside_down)
        with pytest.raises(ObjectTablesError, match=r"1 of 3 objects failed.*\n?.*brick: SchemaError: grasp_pool.jaw_width_m"):
            make(root, *THREE)
    assert make(root, *THREE)[1][0] == "objects: 2 of 3 unchanged"


_KILLED = """
import os, signal, sys
from pathlib import Path
from pipelines.running import object_store
from pipelines.running.data_root import DataRoot
from pipelines.running.object_tables import make_object_tables
from tables.schemas import OBJECT_TABLES
from tests.objects.test_catalogue import write
from tests.pipelines.running.object_builds import RECIPE, THREE

def die(): os.kill(os.getpid(), signal.SIGKILL)
def log(line):
    if sys.argv[2] == "after an object" and line.endswith("(2 of 3)"): die()
real, calls = object_store.write_table, []
def write_table(*arguments):
    calls.append(1)
    if sys.argv[2] == "inside an object" and len(calls) == 2 * len(OBJECT_TABLES) + 3: die()
    return real(*arguments)
object_store.write_table = write_table
make_object_tables(DataRoot(Path(sys.argv[1])), RECIPE, write(Path(sys.argv[1]).parent, *THREE), 0, log)
"""


@pytest.mark.parametrize("when", ["after an object", "inside an object"])
def test_a_killed_build_keeps_the_finished_objects(when: str, tmp_path: Path, built: list[str], stored: Path) -> None:
    repository = Path(__file__).parents[3]
    child = subprocess.run(
        [sys.executable, "-c", _KILLED, str(tmp_path / "data"), when], cwd=repository, env={**os.environ, "PYTHONPATH": str(repository)}
    )
    assert child.returncode == -signal.SIGKILL
    root = DataRoot(tmp_path / "data")
    with pytest.raises(StoreError):
        root.read_objects()
    sidecars, lines = make(root, *THREE)
    assert built == ["tin"]
    assert any("tin damaged or half written" in line for line in lines) is (when == "inside an object")
    assert hashes(sidecars) == hashes(make(DataRoot(stored), *THREE)[0])


@pytest.mark.parametrize("goes_on", [True, False])
def test_a_build_stopped_while_an_object_is_replaced_leaves_no_mixture(
    goes_on: bool, root: DataRoot, built: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    changed, real = {**BRICK, "mass_kg": "0.31"}, object_store.write_table

    def interrupted(schema, *arguments):
        if schema.name == "object_parts":
            raise KeyboardInterrupt
        return real(schema, *arguments)

    with monkeypatch.context() as patch:
        patch.setattr(object_store, "write_table", interrupted)
        with pytest.raises(KeyboardInterrupt):
            make(root, BOX, changed, TIN)
    # On with the changed entry, or back to the one as it was: neither finds all five of its tables.
    root.object_table("objects").unlink()
    _, lines = make(root, BOX, changed if goes_on else BRICK, TIN)
    assert built == ["brick", "brick"]
    assert rows_of(root, "brick")["objects"][0]["mass_kg"] == (0.31 if goes_on else 0.3)
    assert any("brick damaged or half written" in line for line in lines) is goes_on
    assert lines[-1].startswith("objects: brick in ")
