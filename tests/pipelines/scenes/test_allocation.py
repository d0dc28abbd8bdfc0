"""Allocations are balanced over objects, categories and shards, and depend on the id alone."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from objects.catalogue import CatalogueOrder
from objects.errors import CatalogueError
from pipelines.scenes.allocation import family_allocation, scene_allocation
from tables.identity import IdentityError
from tables.layout import INTERLEAVED, MAX_APPENDED
from tables.vocabulary import Allocation

OBJECTS = [(f"{category}_{k:02d}", category) for category in ("can", "mug", "cuboid") for k in range(1, 11)]
SHIPPED = CatalogueOrder(tuple(OBJECTS), Allocation.INTERLEAVED)

catalogues = st.lists(st.tuples(st.uuids().map(str), st.sampled_from(["can", "mug", "cuboid", "mesh"])), min_size=1, max_size=MAX_APPENDED)


def appended(objects: list[tuple[str, str]]) -> CatalogueOrder:
    return CatalogueOrder(tuple(objects), Allocation.APPENDED)


def test_mini_has_twelve_objects_and_each_obstacle_count_four_times() -> None:
    allocations = family_allocation("mini", SHIPPED)
    assert len({allocation.object_id for allocation in allocations}) == 12
    assert Counter(allocation.category for allocation in allocations) == {"can": 4, "mug": 4, "cuboid": 4}
    assert Counter(allocation.n_obstacles for allocation in allocations) == {0: 4, 1: 4, 2: 4}


def test_full_is_balanced_over_objects() -> None:
    allocations = family_allocation("full", SHIPPED)
    per_object = Counter(allocation.object_id for allocation in allocations)
    assert set(per_object.values()) <= {41, 42}
    pairs = Counter((allocation.object_id, allocation.n_obstacles) for allocation in allocations)
    assert len(pairs) == 90
    assert max(pairs.values()) - min(pairs.values()) <= 1


@pytest.mark.parametrize("shard", INTERLEAVED.shards_of_tier("full"))
def test_every_shard_holds_all_categories_and_counts(shard: str) -> None:
    allocations = [scene_allocation(scene_id, SHIPPED) for scene_id in INTERLEAVED.scenes_of_shard(shard)]
    assert min(Counter(allocation.category for allocation in allocations).values()) >= 6
    assert min(Counter(allocation.n_obstacles for allocation in allocations).values()) >= 5


def test_an_empty_catalogue_is_refused() -> None:
    for allocation in Allocation:
        with pytest.raises(CatalogueError, match="0 objects"):
            CatalogueOrder((), allocation)


def test_a_small_catalogue_works() -> None:
    assert {allocation.object_id for allocation in family_allocation("mini", replace(SHIPPED, objects=tuple(OBJECTS[:2])))} == {
        "can_01",
        "can_02",
    }


@given(catalogues, st.integers(1, MAX_APPENDED), st.sampled_from(["mini", "full"]))
def test_appended_objects_change_no_earlier_scene(objects: list[tuple[str, str]], n_before: int, family: str) -> None:
    before, after = (family_allocation(family, appended(some)) for some in (objects[:n_before], objects))
    assert after[: len(before)] == before
    old, new = appended(objects[:n_before]).layout, appended(objects).layout
    assert all(new.scenes_of_shard(shard) == old.scenes_of_shard(shard) for tier in ("mini", "full") for shard in old.shards_of_tier(tier))
    assert new.shards_of_tier("pilot")[: len(old.shards_of_tier("pilot"))] == old.shards_of_tier("pilot")


@given(catalogues)
def test_every_appended_object_has_as_many_scenes_of_each_obstacle_count(objects: list[tuple[str, str]]) -> None:
    order = appended(objects)
    for tier, n_each in (("mini", 2), ("pilot", 7), ("full", 14)):
        allocations = [scene_allocation(scene_id, order) for scene_id in order.layout.scenes_of_tier(tier)]
        counts = Counter((a.object_id, a.n_obstacles) for a in allocations)
        assert counts == {(object_id, n): n_each for object_id, _ in objects for n in range(3)}
        assert {(a.object_id, a.category) for a in allocations} == set(objects)


def test_more_appended_objects_than_ids_are_refused() -> None:
    with pytest.raises(CatalogueError, match=f"{MAX_APPENDED + 1} objects, must be 1 to {MAX_APPENDED} with allocation appended"):
        appended([(f"o_{k}", "mesh") for k in range(MAX_APPENDED + 1)])


@pytest.mark.parametrize(("scene_id", "bound"), [("mini-0012", 12), ("full-1235", 1235)])
def test_a_scene_that_the_benchmark_does_not_have_is_refused(scene_id: str, bound: int) -> None:
    with pytest.raises(IdentityError, match=rf"{scene_id}: scene index \d+, must be in \[0, {bound}\)"):
        scene_allocation(scene_id, SHIPPED)
