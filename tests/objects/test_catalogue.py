"""The catalogue file: what is accepted, and that every refusal names the object, the value and its bound."""

from __future__ import annotations

from pathlib import Path

import pytest

from objects.catalogue import CanShape, CuboidShape, MeshShape, MugShape, catalogue_hash, load_catalogue
from objects.errors import CatalogueError, ObjectError
from tables.vocabulary import Category, Symmetry

CAN = {
    "id": '"tin"',
    "category": '"can"',
    "name": '"a tin"',
    "source": '"a shop"',
    "mass_kg": "0.3",
    "diameter_m": "0.066",
    "height_m": "0.1",
}
MUG = {
    **CAN, "id": '"cup"', "category": '"mug"', "wall_m": "0.004", "base_m": "0.006", "handle_reach_m": "0.03", "handle_height_m": "0.06",
    "handle_thickness_m": "0.01", "handle_width_m": "0.012",
}  # fmt: skip
BOX = {"id": '"box"', "category": '"cuboid"', "name": '"a box"', "source": '"a shop"', "mass_kg": "0.3", "size_m": "[0.05, 0.06, 0.07]"}


def write(tmp_path: Path, *entries: dict[str, str]) -> Path:
    path = tmp_path / "catalogue.toml"
    path.write_text("\n".join("[[object]]\n" + "\n".join(f"{key} = {value}" for key, value in entry.items()) for entry in entries))
    return path


def test_packaged_catalogue_holds_ten_objects_of_each_category_in_order() -> None:
    specs = load_catalogue()
    assert [s.object_id for s in specs] == [f"{c}_{k:02d}" for c in ("can", "mug", "cuboid") for k in range(1, 11)]
    assert [type(s.shape) for s in specs] == [CanShape] * 10 + [MugShape] * 10 + [CuboidShape] * 10
    assert all(s.object_id.startswith(s.category.value) for s in specs)
    assert len({(s.shape, s.mass_kg) for s in specs}) == 30, "two objects are the same object"


def test_every_packaged_object_names_its_source_and_can_be_carried() -> None:
    for spec in load_catalogue():
        assert spec.source.startswith(("YCB", "Typical")), spec.object_id
        assert 0.02 < spec.mass_kg <= 1.2, spec.object_id
        assert 0.3 <= spec.friction <= 1.0, spec.object_id


def test_defaults_follow_the_category(tmp_path: Path) -> None:
    can, mug, box = load_catalogue(write(tmp_path, CAN, MUG, BOX))
    assert (can.symmetry, mug.symmetry, box.symmetry) == (Symmetry.REVOLUTION_Z, Symmetry.NONE, Symmetry.BOX)
    assert can.friction == 0.8
    assert can.com_offset_m == (0.0, 0.0, 0.0)
    assert isinstance(mug.shape, MugShape)
    assert mug.shape.base_diameter_m == mug.shape.diameter_m
    assert isinstance(box.shape, CuboidShape)
    assert box.shape.size_m == (0.05, 0.06, 0.07)


def test_mesh_path_is_relative_to_the_catalogue_file(tmp_path: Path) -> None:
    entry = {
        "id": '"own"',
        "category": '"mesh"',
        "name": '"n"',
        "source": '"s"',
        "mass_kg": "0.1",
        "mesh": '"files/own.obj"',
        "scale": "0.001",
    }
    (spec,) = load_catalogue(write(tmp_path, entry))
    assert spec.shape == MeshShape(tmp_path / "files/own.obj", 0.001)
    assert spec.category is Category.MESH


@pytest.mark.parametrize(
    ("entry", "changes", "said"),
    [
        (CAN, {"colour": '"red"'}, ("tin", "colour")),
        (CAN, {"size_m": "[1, 1, 1]"}, ("tin", "size_m")),
        (CAN, {"diameter_m": "66"}, ("tin", "diameter_m", "66", "0.4")),
        (CAN, {"height_m": '"tall"'}, ("tin", "height_m", "tall")),
        (CAN, {"height_m": "true"}, ("tin", "height_m", "True")),
        (CAN, {"height_m": "nan"}, ("tin", "height_m", "nan")),
        (CAN, {"mass_kg": "3.0"}, ("tin", "mass_kg", "3", "1.2")),
        (CAN, {"friction": "0.0"}, ("tin", "friction", "0.1")),
        (CAN, {"symmetry": '"round"'}, ("tin", "round", "revolution_z")),
        (CAN, {"com_offset_m": "[0.01, 0.0, 0.0]"}, ("tin", "com_offset_m", "0.01", "revolution_z")),
        (CAN, {"source": '""'}, ("tin", "source")),
        (CAN, {"category": '"bottle"'}, ("tin", "bottle", "cuboid")),
        (CAN, {"id": '"No Spaces"'}, ("No Spaces",)),
        (MUG, {"wall_m": "0.001"}, ("cup", "wall_m", "0.001", "0.002")),
        (MUG, {"handle_height_m": "0.2"}, ("cup", "handle_height_m", "0.2", "0.095")),
        (MUG, {"handle_z_m": "0.05"}, ("cup", "handle_z_m", "0.05", "0.02")),
        (BOX, {"size_m": "[0.05, 0.06]"}, ("box", "size_m", "[0.05, 0.06]")),
        (BOX, {"size_m": "[0.05, 0.06, 0.7]"}, ("box", "size_m[2]", "0.7", "0.4")),
    ],
)
def test_a_bad_value_is_refused_with_object_value_and_bound(
    tmp_path: Path, entry: dict[str, str], changes: dict[str, str], said: tuple[str, ...]
) -> None:
    with pytest.raises(CatalogueError) as error:
        load_catalogue(write(tmp_path, {**entry, **changes}))
    for word in said:
        assert word in str(error.value)


@pytest.mark.parametrize("key", ["category", "name", "mass_kg", "diameter_m"])
def test_a_missing_key_is_refused_by_name(tmp_path: Path, key: str) -> None:
    with pytest.raises(CatalogueError, match=key):
        load_catalogue(write(tmp_path, {k: v for k, v in CAN.items() if k != key}))


def test_a_repeated_id_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CatalogueError, match="tin: id used 2 times"):
        load_catalogue(write(tmp_path, CAN, CAN))


@pytest.mark.parametrize(("text", "said"), [("[[object]\n", "not TOML"), ("", "0 objects"), ("[scene]\nx = 1\n", "scene")])
def test_a_file_that_is_no_catalogue_is_refused(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "catalogue.toml"
    path.write_text(text)
    with pytest.raises(CatalogueError, match=said):
        load_catalogue(path)


def test_a_missing_file_is_refused_within_the_exception_family(tmp_path: Path) -> None:
    with pytest.raises(ObjectError, match=r"nowhere\.toml"):
        load_catalogue(tmp_path / "nowhere.toml")


def test_the_hash_of_a_catalogue_knows_what_was_parsed_and_nothing_else(tmp_path: Path) -> None:
    first = catalogue_hash(load_catalogue(write(tmp_path, CAN, BOX)))
    path = write(tmp_path, dict(reversed(CAN.items())), BOX)
    path.write_text("# a comment\n" + path.read_text().replace("mass_kg = 0.3", "mass_kg   = 0.30"))
    assert catalogue_hash(load_catalogue(path)) == first
    others = [
        (BOX, CAN),
        (CAN,),
        ({**CAN, "mass_kg": "0.31"}, BOX),
        ({**CAN, "name": '"another tin"'}, BOX),
        (CAN, {**BOX, "friction": "0.7"}),
    ]
    hashes = {catalogue_hash(load_catalogue(write(tmp_path, *entries))) for entries in others}
    assert len(hashes | {first}) == 1 + len(others)
    assert all(len(value) == 64 for value in hashes)


MESH = {"id": '"own"', "category": '"mesh"', "name": '"n"', "source": '"s"', "mass_kg": "0.1"}


@pytest.mark.parametrize("mesh", ["../own.stl", "/etc/own.stl", "files/../../own.stl", "link/own.stl"])
def test_a_mesh_file_outside_the_folder_is_refused_unless_allowed(tmp_path: Path, mesh: str) -> None:
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "link").symlink_to(tmp_path)
    path = write(folder, {**MESH, "mesh": f'"{mesh}"'})
    with pytest.raises(CatalogueError) as error:
        load_catalogue(path)
    assert str(error.value) == f"own: mesh {mesh!r} lies outside {folder}, must be inside (or allow it: --allow-outside)"
    (spec,) = load_catalogue(path, allow_outside=True)
    assert spec.shape == MeshShape(folder / mesh)


def test_a_link_that_stays_in_the_folder_is_a_path_like_any_other(tmp_path: Path) -> None:
    (tmp_path / "own.stl").symlink_to(tmp_path / "files" / "own.stl")
    (spec,) = load_catalogue(write(tmp_path, {**MESH, "mesh": '"own.stl"'}))
    assert spec.shape == MeshShape(tmp_path / "own.stl")


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"mesh": '"a\\u0000b.stl"'}, "own: mesh 'a\\x00b.stl', must be a path: embedded null byte"),
        ({"mesh": '"loop"'}, "own: mesh 'loop', must be a path: Symlink loop"),
        ({"mesh": "3"}, "own: mesh 3, must be a path relative to the catalogue file"),
        ({"mesh": '"own.stl"', "max_faces": "50"}, "own: max_faces 50, must be a whole number in [100, 20000]"),
        ({"mesh": '"own.stl"', "max_faces": "500.5"}, "own: max_faces 500.5, must be a whole number in [100, 20000]"),
        ({"mesh": '"own.stl"', "scale": "0.0"}, "own: scale 0, must be in [1e-06, 1000]"),
    ],
)
def test_a_bad_mesh_entry_is_refused_in_one_line(tmp_path: Path, changes: dict[str, str], said: str) -> None:
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with pytest.raises(CatalogueError) as error:
        load_catalogue(write(tmp_path, {**MESH, **changes}))
    assert str(error.value).startswith(said)
    assert "\n" not in str(error.value)


def test_the_hash_of_a_catalogue_knows_a_mesh_file_by_its_content(tmp_path: Path) -> None:
    path = write(tmp_path, {**MESH, "mesh": '"own.stl"'})
    missing = catalogue_hash(load_catalogue(path))
    (tmp_path / "own.stl").write_bytes(b"one")
    first = catalogue_hash(load_catalogue(path))
    (tmp_path / "own.stl").write_bytes(b"two")
    assert len({missing, first, catalogue_hash(load_catalogue(path))}) == 3
    (tmp_path / "other.stl").write_bytes(b"one")
    assert catalogue_hash(load_catalogue(write(tmp_path, {**MESH, "mesh": '"other.stl"'}))) == first


def test_the_hash_of_the_packaged_catalogue_is_the_one_that_releases_name() -> None:
    assert catalogue_hash(load_catalogue()) == "297f3815dc416f5a77c2a99dabc41e34af5cd095ae118178a95adcbce65f9e3f"
