"""Splits beside the paper's, by scene group too: unseen objects, an unseen category, more obstacles; leakage.py checks what they promise.

`object`: a size class is the smaller or the larger half of a category by the volume of the box around an object, so 30 objects in three
categories make six classes of five. Of each class one object is for test and another for validation, by a hash of its id, and three are
for training: 18, 6 and 6 objects, near enough the paper's shares of 61, 19 and 19 %, so that a result differs from that of the paper's
split by what is new and not by how much there is to learn from. Six of each of three size classes of ten would leave twelve objects for
training and validation. Volumes are of the solid that the catalogue describes, which is what table `objects` has in `size_x_m` and on.
In an appended catalogue, where classes would change with every object, each five objects in file order are a class instead.

`category_<name>`: all scenes of one category are for test; three rotations.

`layout`: all scenes with two obstacles are for test, so a ranker meets more than it has seen. Regions of targets are not held out: the
eight targets of a scene lie all over the table, and a scene group is never split.

Scenes that `category_<name>` and `layout` do not hold out are for validation where the paper's split has them for validation, and else
for training: what was balanced there stays balanced. A scene keeps its split in every tier, which may leave a part of a small tier empty;
`empty_parts` says where, and `not_applying` which schemes a catalogue has no use for.

In an appended catalogue the paper's split deals the scenes of every shard, which are of one object, by themselves, so that no scene changes
its split, under any scheme, when another object joins.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from objects.catalogue import catalogue_order, load_catalogue
from objects.solids import solid_of
from pipelines.values import SceneAllocation
from splits.scene_groups import SplitError, SplitParams, UniverseScene, shard_split_rows, split_rows
from tables.identity import number_of_shard, order_key
from tables.layout import Layout
from tables.schemas import SPLITS
from tables.store import table_from_rows
from tables.vocabulary import Allocation, Category, Split, SplitScheme

HELD_OUT_CATEGORY = {
    SplitScheme.CATEGORY_CAN: Category.CAN,
    SplitScheme.CATEGORY_MUG: Category.MUG,
    SplitScheme.CATEGORY_CUBOID: Category.CUBOID,
}
HELD_OUT_N_OBSTACLES = 2

SizedObject = tuple[str, float]  # category, volume of the box around it in m3

# A class with fewer objects than there are splits would train on none.
_MIN_CLASS = len(Split)
APPENDED_CLASS = 5  # as many as in the classes of the benchmark


def split_table(scene_ids: Sequence[str], universe: Sequence[SceneAllocation], catalogue: Path, params: SplitParams, seed: int) -> pa.Table:
    """Table `splits` of some scenes of a family: the paper's split by `split_rows` or `shard_split_rows`, the others by `scheme_rows`.

    Args:
        scene_ids: the scenes wanted.
        universe: allocations of every scene of their family, in any order, of objects of the catalogue.
        catalogue: its file.
        params: shares of the paper's split.
        seed: the recipe seed.

    Raises:
        SplitError: as `split_rows` and `scheme_rows` do.
        CatalogueError: the catalogue is not what it should be.
    """
    order = catalogue_order(catalogue)
    scenes = [(a.scene_id, a.category, a.n_obstacles) for a in universe]
    if order.allocation is Allocation.INTERLEAVED:
        by_scene = split_rows(scene_ids, scenes, order.layout, params, seed)
    else:
        by_scene = _rows_by_shard(scene_ids, scenes, order.layout, params, seed)
    return table_from_rows(SPLITS, scheme_rows(by_scene, universe, parts_of_catalogue(catalogue, seed)))


def _rows_by_shard(
    scene_ids: Sequence[str], universe: Sequence[UniverseScene], layout: Layout, params: SplitParams, seed: int
) -> list[dict[str, Any]]:
    shards: dict[str, list[UniverseScene]] = {}
    for scene in universe:
        shards.setdefault(layout.shard_of_scene(scene[0]), []).append(scene)
    rows = [row for shard, own in shards.items() for row in shard_split_rows(own, number_of_shard(shard), params, seed)]
    by_scene = {row["scene_id"]: row for row in rows}
    missing = sorted(set(scene_ids) - by_scene.keys())
    if missing:
        raise SplitError(f"{missing[0]}: not in the universe of {len(universe)} scenes ({len(missing)} scenes are not)")
    return [by_scene[scene_id] for scene_id in sorted(set(scene_ids))]


def parts_of_catalogue(catalogue: Path, seed: int) -> dict[str, Split]:
    """The split of every object of a catalogue under scheme `object`."""
    order = catalogue_order(catalogue)
    if order.allocation is Allocation.APPENDED:
        return appended_parts([object_id for object_id, _ in order.objects], seed)
    return object_parts(catalogue_sizes(catalogue), seed)


def scheme_rows(
    by_scene: Sequence[Mapping[str, Any]], universe: Sequence[SceneAllocation], part_of: Mapping[str, Split]
) -> list[dict[str, Any]]:
    """Rows of `splits` with every scheme.

    Args:
        by_scene: rows of the scenes with `scene_id` and the paper's `split`.
        universe: allocations of at least these scenes.
        part_of: the split of every object under scheme `object`.

    Raises:
        SplitError: a scene without an allocation or an object without a part.
    """
    allocation_of = {allocation.scene_id: allocation for allocation in universe}
    rows = []
    for row in by_scene:
        allocation = allocation_of.get(row["scene_id"])
        if allocation is None:
            raise SplitError(f"{row['scene_id']}: has no allocation, must be one of {len(allocation_of)} scenes")
        if allocation.object_id not in part_of:
            raise SplitError(f"{row['scene_id']}: object {allocation.object_id} has no part, must be one of {len(part_of)} objects")
        split = Split(row["split"])
        seen = Split.VALIDATION if split is Split.VALIDATION else Split.TRAIN
        own = {
            SplitScheme.SCENE: split,
            SplitScheme.OBJECT: part_of[allocation.object_id],
            **{scheme: Split.TEST if allocation.category == held_out else seen for scheme, held_out in HELD_OUT_CATEGORY.items()},
            SplitScheme.LAYOUT: Split.TEST if allocation.n_obstacles == HELD_OUT_N_OBSTACLES else seen,
        }
        rows.append({"scene_id": row["scene_id"], **{scheme.column: part.value for scheme, part in own.items()}})
    return rows


def object_parts(sizes: Mapping[str, SizedObject], seed: int) -> dict[str, Split]:
    """The split of every object under scheme `object`: in each size class the first by hash is test, the second validation.

    A class of fewer than three objects is for training.

    Args:
        sizes: category and size of every object by id, of those too that no scene has: classes are of the whole catalogue.
        seed: the recipe seed.
    """
    part_of = dict.fromkeys(sizes, Split.TRAIN)
    for members in size_classes(sizes).values():
        if len(members) >= _MIN_CLASS:
            first, second, *_ = sorted(members, key=lambda object_id: order_key(seed, "object_split", object_id))
            part_of |= {first: Split.TEST, second: Split.VALIDATION}
    return part_of


def appended_parts(object_ids: Sequence[str], seed: int) -> dict[str, Split]:
    """The split of every object of an appended catalogue under scheme `object`.

    Of each five in file order, the first three are one for test, one for validation and one for training, by a hash of their number; the
    others are for training. So three objects are enough, and none changes its part when others join.
    """
    part_of = {}
    for k, object_id in enumerate(object_ids):
        number, place = divmod(k, APPENDED_CLASS)
        test, validation, _ = sorted(range(_MIN_CLASS), key=lambda p: order_key(seed, "appended_object_split", number, p))
        part_of[object_id] = {test: Split.TEST, validation: Split.VALIDATION}.get(place, Split.TRAIN)
    return part_of


def size_classes(sizes: Mapping[str, SizedObject]) -> dict[tuple[str, str], tuple[str, ...]]:
    """Objects by (category, `smaller` or `larger`), smallest first: halves of a category by volume, the middle one with the smaller.

    Volumes count in whole cubic millimetres, and equal ones go by id, so that rounding of the last bit decides nothing.
    """
    classes: dict[tuple[str, str], tuple[str, ...]] = {}
    for category in sorted({category for category, _ in sizes.values()}):
        own = sorted((round(volume * 1e9), object_id) for object_id, (of, volume) in sizes.items() if of == category)
        n_smaller = (len(own) + 1) // 2
        for name, members in (("smaller", own[:n_smaller]), ("larger", own[n_smaller:])):
            classes[category, name] = tuple(object_id for _, object_id in members)
    return classes


@cache
def catalogue_sizes(catalogue: Path) -> dict[str, SizedObject]:
    """Category and box volume of every object of a catalogue file by id."""
    return {spec.object_id: (spec.category.value, float(np.prod(solid_of(spec).mesh.extents))) for spec in load_catalogue(catalogue)}


def not_applying(categories: Mapping[str, str]) -> dict[SplitScheme, str]:
    """The schemes that a catalogue has no use for, and why; their columns are there all the same.

    Args:
        categories: category of every object by id.
    """
    found, reasons = set(categories.values()), {}
    if len(categories) < _MIN_CLASS:
        reasons[SplitScheme.OBJECT] = f"{len(categories)} objects in the catalogue, fewer than {_MIN_CLASS}"
    for scheme, held_out in HELD_OUT_CATEGORY.items():
        if held_out not in found:
            reasons[scheme] = f"no {held_out.value} in the catalogue"
        elif len(found) == 1:
            reasons[scheme] = f"nothing but {held_out.value} in the catalogue"
    return reasons


def empty_parts(splits: pa.Table) -> list[tuple[SplitScheme, Split]]:
    """Each scheme's splits that have no scene in this table."""
    return [(scheme, split) for scheme in SplitScheme for split in Split if split.value not in splits[scheme.column].unique().to_pylist()]
