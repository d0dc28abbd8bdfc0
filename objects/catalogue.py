"""The catalogue file: what each object is, in metres and kilograms, checked key by key; its geometry is made in solids.

A file holds one `[[object]]` table an object. Keys of every category: `id`, `category`, `name`, `source`, `mass_kg`, and optionally
`friction`, `symmetry`, `com_offset_m`. The rest describe the shape: see the shape classes below, whose fields are the keys. Before the
objects a file may say `allocation`: how they take the scenes, `appended` where it says nothing (see pipelines/scenes/allocation.py).
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from objects.errors import CatalogueError
from tables.identity import IdentityError
from tables.layout import Layout, layout_of
from tables.vocabulary import Allocation, Category, Symmetry

PACKAGED_CATALOGUE = Path(__file__).with_name("catalogue.toml")

# The Panda may carry 3 kg with its hand; 1.2 kg at the fingertips is what its friction grip holds with a margin.
MAX_MASS_KG = 1.2
# Friction of the object's surface; the engine multiplies it by that of the finger or the table.
DEFAULT_FRICTION = 0.8
# Changes when the code that reads and repairs the meshes of users may give another solid for the same file.
MESH_CODE_VERSION = "2"
_ID = re.compile(r"[a-z][a-z0-9_]{0,39}")


@dataclass(frozen=True, slots=True)
class CanShape:
    """A closed cylinder."""

    diameter_m: float
    height_m: float


@dataclass(frozen=True, slots=True)
class MugShape:
    """An open body of revolution, straight or tapered, and a handle in its xz plane.

    `handle_reach_m` is how far the outside of the handle stands off the radius of the brim, `handle_z_m` the height of its middle above
    the middle of the body, `handle_squareness` the exponent of its superellipse: 2 is round like an ear, 4 and more square like a D.
    """

    diameter_m: float
    height_m: float
    wall_m: float
    base_m: float
    handle_reach_m: float
    handle_height_m: float
    handle_thickness_m: float
    handle_width_m: float
    base_diameter_m: float = 0.0
    handle_z_m: float = 0.0
    handle_squareness: float = 4.0


@dataclass(frozen=True, slots=True)
class CuboidShape:
    """A box; `size_m` are its edges along x, y and z."""

    size_m: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class MeshShape:
    """A mesh file that a user brings, made metric by `scale` and, where it has more, simplified to at most `max_faces` triangles."""

    path: Path
    scale: float = 1.0
    max_faces: int | None = None


Shape = CanShape | MugShape | CuboidShape | MeshShape


@dataclass(frozen=True, slots=True)
class ObjectSpec:
    """One catalogue entry; `com_offset_m` moves the centre of mass off the centroid of the solid (a partly filled container)."""

    object_id: str
    category: Category
    name: str
    source: str
    shape: Shape
    mass_kg: float
    friction: float
    symmetry: Symmetry
    com_offset_m: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class CatalogueOrder:
    """What scenes are allocated from: (object id, category) in file order, and how the objects take the scenes."""

    objects: tuple[tuple[str, str], ...]
    allocation: Allocation

    def __post_init__(self) -> None:
        if not self.objects:
            raise CatalogueError("the catalogue has 0 objects, must have at least 1")
        try:
            layout_of(self.allocation, len(self.objects))
        except IdentityError as error:
            raise CatalogueError(f"catalogue: {error}") from error

    @property
    def layout(self) -> Layout:
        """Scenes, shards and tiers of a dataset of this catalogue."""
        return layout_of(self.allocation, len(self.objects))


def load_catalogue(path: Path = PACKAGED_CATALOGUE, allow_outside: bool = False) -> tuple[ObjectSpec, ...]:
    """Entries of a catalogue file, in file order.

    Args:
        allow_outside: whether mesh files may lie outside the folder of the catalogue.

    Raises:
        CatalogueError: the file is missing or not TOML, or an entry has an unknown or missing key or a value out of bounds.
    """
    return _specs(_content(path), path, allow_outside)


def catalogue_order(path: Path) -> CatalogueOrder:
    """What scene allocations of a catalogue file are made from; raises as `load_catalogue`, and where it has too many objects."""
    content = _content(path)
    objects = tuple((spec.object_id, spec.category.value) for spec in _specs(content, path))
    try:
        return CatalogueOrder(objects, Allocation(content.get("allocation", Allocation.APPENDED)))
    except CatalogueError as error:
        raise CatalogueError(f"{path}: {error}") from error


def catalogue_hash(specs: Sequence[ObjectSpec]) -> str:
    """SHA-256 of parsed entries in their order: comments, spacing and the order of keys in the file do not change it.

    A mesh file of the user's enters by its content (and its suffix, which says how to read it), not by its path.
    """
    content = json.dumps([identity_of(spec) for spec in specs], sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()


def identity_of(spec: ObjectSpec) -> dict[str, Any]:
    """An entry as it decides the object; a mesh file counts by what is in it (and its suffix, which says how to read it).

    Files that a mesh file refers to are not looked at. One that cannot be read has an identity, too: building it says what is wrong.
    """
    entry: dict[str, Any] = dataclasses.asdict(spec)
    if isinstance(spec.shape, MeshShape):
        try:
            content = hashlib.sha256(spec.shape.path.read_bytes()).hexdigest()
        except OSError:
            content = "unreadable"
        entry["shape"] |= {"path": f"{content}{spec.shape.path.suffix}", "code": MESH_CODE_VERSION}
    return entry


def _content(path: Path) -> dict[str, Any]:
    """The keys of a catalogue file, those of the objects unchecked."""
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise CatalogueError(f"{path}: cannot be read: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise CatalogueError(f"{path}: not TOML: {error}") from error
    if strange := sorted(content.keys() - {"object", "allocation"}):
        raise CatalogueError(f"{path}: unknown key {strange[0]!r}, expected allocation and [[object]] tables only")
    if "allocation" in content and content["allocation"] not in list(Allocation):
        raise CatalogueError(f"{path}: allocation {content['allocation']!r}, must be one of {[a.value for a in Allocation]}")
    return content


def _specs(content: Mapping[str, Any], path: Path, allow_outside: bool = False) -> tuple[ObjectSpec, ...]:
    entries = content.get("object", [])
    if not isinstance(entries, list) or not entries:
        raise CatalogueError(f"{path}: 0 objects, must be at least 1 [[object]] table")
    specs = tuple(_spec(entry, k, path.parent, allow_outside) for k, entry in enumerate(entries))
    ids = [spec.object_id for spec in specs]
    for object_id in ids:
        if ids.count(object_id) > 1:
            raise CatalogueError(f"{object_id}: id used {ids.count(object_id)} times, must be 1")
    return specs


_COMMON_KEYS = {"id", "category", "name", "source", "mass_kg", "friction", "symmetry", "com_offset_m"}
_SHAPES: Mapping[Category, type[Shape]] = {
    Category.CAN: CanShape,
    Category.MUG: MugShape,
    Category.CUBOID: CuboidShape,
    Category.MESH: MeshShape,
}
_SYMMETRY = {
    Category.CAN: Symmetry.REVOLUTION_Z,
    Category.MUG: Symmetry.NONE,
    Category.CUBOID: Symmetry.BOX,
    Category.MESH: Symmetry.NONE,
}


def _spec(entry: Any, index: int, folder: Path, allow_outside: bool) -> ObjectSpec:
    if not isinstance(entry, Mapping):
        raise CatalogueError(f"object {index + 1}: not a table")
    object_id = entry.get("id", f"object {index + 1}")
    if not isinstance(entry.get("id"), str) or not _ID.fullmatch(object_id):
        raise CatalogueError(f"object {index + 1}: id {entry.get('id')!r}, must match {_ID.pattern}")
    if entry.get("category") not in {c.value for c in Category}:
        raise CatalogueError(f"{object_id}: category {entry.get('category')!r}, must be one of {[c.value for c in Category]}")
    category = Category(entry["category"])
    shape_type = _SHAPES[category]
    shape_keys = {"mesh" if f.name == "path" else f.name for f in fields(shape_type)}
    if strange := sorted(entry.keys() - _COMMON_KEYS - shape_keys):
        raise CatalogueError(f"{object_id}: unknown key {strange[0]!r}, a {category} has {sorted(_COMMON_KEYS | shape_keys)}")
    for key in ("name", "source"):
        if not isinstance(entry.get(key), str) or not entry[key].strip():
            raise CatalogueError(f"{object_id}: {key} {entry.get(key)!r}, must be a text")
    symmetry = entry.get("symmetry", _SYMMETRY[category].value)
    if symmetry not in {s.value for s in Symmetry}:
        raise CatalogueError(f"{object_id}: symmetry {symmetry!r}, must be one of {[s.value for s in Symmetry]}")
    x, y, z = _vector(object_id, entry, "com_offset_m", -0.1, 0.1) if "com_offset_m" in entry else (0.0, 0.0, 0.0)
    if symmetry == Symmetry.REVOLUTION_Z and (x or y):
        raise CatalogueError(f"{object_id}: com_offset_m x, y = {x}, {y}, must be 0 for symmetry {symmetry}")
    return ObjectSpec(
        object_id=object_id,
        category=category,
        name=entry["name"],
        source=entry["source"],
        shape=_shape(object_id, shape_type, entry, folder, allow_outside),
        mass_kg=_number(object_id, entry, "mass_kg", 0.005, MAX_MASS_KG),
        friction=_number(object_id, entry, "friction", 0.1, 1.5, DEFAULT_FRICTION),
        symmetry=Symmetry(symmetry),
        com_offset_m=(x, y, z),
    )


def _shape(object_id: str, shape_type: type[Shape], entry: Mapping[str, Any], folder: Path, allow_outside: bool) -> Shape:
    if shape_type is CanShape:
        return CanShape(*(_number(object_id, entry, key, 0.010, 0.400) for key in ("diameter_m", "height_m")))
    if shape_type is CuboidShape:
        return CuboidShape(_vector(object_id, entry, "size_m", 0.010, 0.400))
    if shape_type is MeshShape:
        if not isinstance(entry.get("mesh"), str):
            raise CatalogueError(f"{object_id}: mesh {entry.get('mesh')!r}, must be a path relative to the catalogue file")
        path = _mesh_path(object_id, entry["mesh"], folder, allow_outside)
        return MeshShape(path, _number(object_id, entry, "scale", 1e-6, 1e3, 1.0), _max_faces(object_id, entry))
    return _mug_shape(object_id, entry)


def _mesh_path(object_id: str, mesh: str, folder: Path, allow_outside: bool) -> Path:
    """Where a mesh file is; a catalogue from elsewhere may not name any file of this machine, by a link neither."""
    try:
        is_inside = (folder / mesh).resolve().is_relative_to(folder.resolve())
    except (OSError, ValueError, RuntimeError) as error:  # a name with a null byte, a link to itself
        raise CatalogueError(f"{object_id}: mesh {mesh!r}, must be a path: {error}") from error
    if not is_inside and not allow_outside:
        raise CatalogueError(f"{object_id}: mesh {mesh!r} lies outside {folder}, must be inside (or allow it: --allow-outside)")
    return folder / mesh


def _max_faces(object_id: str, entry: Mapping[str, Any]) -> int | None:
    if "max_faces" not in entry:
        return None
    value = entry["max_faces"]
    if type(value) is not int or not 100 <= value <= 20_000:
        raise CatalogueError(f"{object_id}: max_faces {value!r}, must be a whole number in [100, 20000]")
    return value


def _mug_shape(object_id: str, entry: Mapping[str, Any]) -> MugShape:
    diameter = _number(object_id, entry, "diameter_m", 0.040, 0.120)
    height = _number(object_id, entry, "height_m", 0.040, 0.200)
    foot = _number(object_id, entry, "base_diameter_m", 0.5 * diameter, diameter, diameter)
    # Thinner than 2 mm, the convex parts degenerate; real thin walls (enamel, steel) are thickened to that.
    wall = _number(object_id, entry, "wall_m", 0.002, foot / 4)
    thickness = _number(object_id, entry, "handle_thickness_m", 0.005, 0.020)
    handle_height = _number(object_id, entry, "handle_height_m", 2.5 * thickness, 0.95 * height)
    room = (height - handle_height) / 2
    return MugShape(
        diameter_m=diameter,
        height_m=height,
        wall_m=wall,
        base_m=_number(object_id, entry, "base_m", 0.002, height / 3),
        handle_reach_m=_number(object_id, entry, "handle_reach_m", 1.5 * thickness, 0.060),
        handle_height_m=handle_height,
        handle_thickness_m=thickness,
        handle_width_m=_number(object_id, entry, "handle_width_m", 0.005, 0.030),
        base_diameter_m=foot,
        handle_z_m=_number(object_id, entry, "handle_z_m", -room, room, 0.0),
        handle_squareness=_number(object_id, entry, "handle_squareness", 2.0, 8.0, 4.0),
    )


def _number(object_id: str, entry: Mapping[str, Any], key: str, low: float, high: float, default: float | None = None) -> float:
    if key not in entry and default is not None:
        return default
    value = entry.get(key)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise CatalogueError(f"{object_id}: {key} {value!r}, must be a number in [{low:.4g}, {high:.4g}]")
    if not math.isfinite(value) or not low - 1e-12 <= value <= high + 1e-12:
        raise CatalogueError(f"{object_id}: {key} {value:.4g}, must be in [{low:.4g}, {high:.4g}]")
    return float(value)


def _vector(object_id: str, entry: Mapping[str, Any], key: str, low: float, high: float) -> tuple[float, float, float]:
    value = entry.get(key)
    if not isinstance(value, list) or len(value) != 3:
        raise CatalogueError(f"{object_id}: {key} {value!r}, must be three numbers in [{low:.4g}, {high:.4g}]")
    x, y, z = (_number(object_id, {f"{key}[{i}]": v}, f"{key}[{i}]", low, high) for i, v in enumerate(value))
    return x, y, z
