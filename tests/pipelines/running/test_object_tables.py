"""What changed is built, what did not is kept, and the tables never tell which was which."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import trimesh

from pipelines.recipe import Recipe
from pipelines.running.data_root import DataRoot
from pipelines.running.object_tables import are_objects_current
from pipelines.scenes.points import CameraParams
from tables.schemas import OBJECT_TABLES
from tests.objects.test_catalogue import BOX, write
from tests.pipelines.running.object_builds import BRICK, RECIPE, THREE, TIN, from_nothing, hashes, make, rows_of


def test_an_unchanged_catalogue_builds_nothing_in_whatever_order(root: DataRoot, built: list[str]) -> None:
    before = {path: path.read_bytes() for path in root.path.rglob("*") if path.is_file()}
    for entries in (THREE, THREE[::-1]):
        assert make(root, *entries)[1] == ["objects: up to date"]
    assert built == []
    assert {path: path.read_bytes() for path in root.path.rglob("*") if path.is_file()} == before


def test_a_changed_entry_builds_that_object_alone(root: DataRoot, built: list[str], tmp_path: Path) -> None:
    before, changed = rows_of(root, "box", "tin"), {**BRICK, "mass_kg": "0.31"}
    sidecars, lines = make(root, BOX, changed, TIN)
    assert built == ["brick"]
    assert rows_of(root, "box", "tin") == before
    assert rows_of(root, "brick")["objects"][0]["mass_kg"] == 0.31
    assert lines[0] == "objects: 2 of 3 unchanged"
    assert lines[1].startswith("objects: brick in ")
    assert lines[1].endswith(" s (1 of 1)")
    assert len(lines) == 2
    assert hashes(sidecars) == from_nothing(tmp_path / "whole", BOX, changed, TIN)


def test_an_appended_object_builds_alone_and_leaves_the_others_as_they_are(root: DataRoot, built: list[str], tmp_path: Path) -> None:
    before, own = rows_of(root, "box", "brick", "tin"), {**BOX, "id": '"aaa"', "size_m": "[0.03, 0.06, 0.11]"}
    sidecars, _ = make(root, *THREE, own)
    assert built == ["aaa"]
    assert rows_of(root, "box", "brick", "tin") == before
    assert hashes(sidecars) == from_nothing(tmp_path / "whole", *THREE, own)
    alone = DataRoot(tmp_path / "alone")
    make(alone, own)
    assert rows_of(alone, "aaa") == rows_of(root, "aaa"), "an object depends on the catalogue around it"


def test_a_removed_object_builds_nothing_and_neither_does_its_return(root: DataRoot, built: list[str], tmp_path: Path) -> None:
    first = hashes(make(root, *THREE)[0])
    sidecars, lines = make(root, BOX, TIN)
    assert lines == ["objects: 2 of 2 unchanged"]
    assert rows_of(root, "brick") == {name: [] for name in OBJECT_TABLES}
    assert hashes(make(root, *THREE)[0]) == first
    assert built == []
    assert hashes(sidecars) == from_nothing(tmp_path / "whole", BOX, TIN)


def test_parameters_and_seed_build_all_and_other_sections_none(root: DataRoot, built: list[str]) -> None:
    make(root, *THREE, recipe=replace(RECIPE, camera=CameraParams(fov_deg=40.0)))
    assert built == []
    make(root, *THREE, recipe=replace(RECIPE, seed=43))
    assert built == ["box", "brick", "tin"]
    pool = replace(RECIPE.objects.grasp_pool, friction=0.35)
    make(root, *THREE, recipe=replace(RECIPE, objects=replace(RECIPE.objects, grasp_pool=pool)))
    assert built == ["box", "brick", "tin"] * 2


def test_whether_there_is_anything_to_build_is_known_before(root: DataRoot, built: list[str]) -> None:
    def is_current(*entries: dict[str, str], recipe: Recipe = RECIPE) -> bool:
        return are_objects_current(root, recipe, write(root.path.parent, *entries))

    assert is_current(*THREE)
    assert not is_current(*THREE, recipe=replace(RECIPE, seed=43))
    assert not is_current(BOX, {**BRICK, "mass_kg": "0.31"}, TIN)
    assert not is_current(BOX, TIN)
    root.object_table("objects").write_bytes(b"")
    assert not is_current(*THREE)
    make(root, *THREE)
    assert is_current(*THREE)
    assert built == []


def test_a_mesh_file_that_changed_is_noticed(tmp_path: Path, built: list[str]) -> None:
    own = {"id": '"own"', "category": '"mesh"', "name": '"n"', "source": '"s"', "mass_kg": "0.1", "mesh": '"own.stl"'}
    root = DataRoot(tmp_path / "data")
    for size_m in (0.05, 0.05, 0.06):
        trimesh.creation.box(extents=(0.04, 0.05, size_m)).export(tmp_path / "own.stl")
        make(root, BOX, own)
    assert built == ["box", "own", "own"]


def test_neither_workers_nor_order_of_the_entries_matter(tmp_path: Path) -> None:
    found = []
    for k, (entries, n_workers) in enumerate([(THREE, 0), (THREE, 1), (THREE, 2), (THREE[::-1], 2)]):
        (tmp_path / str(k)).mkdir()
        sidecars, lines = make(DataRoot(tmp_path / str(k) / "data"), *entries, n_workers=n_workers)
        assert sorted(line.split()[1] for line in lines) == ["box", "brick", "tin"]
        found.append(hashes(sidecars))
    assert all(hash_ == found[0] for hash_ in found)
