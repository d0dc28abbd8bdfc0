"""Allocations are balanced over objects, categories and shards, and depend on the id alone."""

from __future__ import annotations

from collections import Counter

import pytest

from pipelines.scenes.allocation import family_allocation, scene_allocation
from tables.identity import scenes_of_shard, shards_of_tier

OBJECTS = [(f"{category}_{k:02d}", category) for category in ("can", "mug", "cuboid") for k in range(1, 11)]


def test_mini_has_twelve_objects_and_each_obstacle_count_four_times() -> None:
    allocations = family_allocation("mini", OBJECTS)
    assert len({allocation.object_id for allocation in allocations}) == 12
    assert Counter(allocation.category for allocation in allocations) == {"can": 4, "mug": 4, "cuboid": 4}
    assert Counter(allocation.n_obstacles for allocation in allocations) == {0: 4, 1: 4, 2: 4}


def test_full_is_balanced_over_objects() -> None:
    allocations = family_allocation("full", OBJECTS)
    per_object = Counter(allocation.object_id for allocation in allocations)
    assert set(per_object.values()) <= {41, 42}
    pairs = Counter((allocation.object_id, allocation.n_obstacles) for allocation in allocations)
    assert len(pairs) == 90
    assert max(pairs.values()) - min(pairs.values()) <= 1


@pytest.mark.parametrize("shard", shards_of_tier("full"))
def test_every_shard_holds_all_categories_and_counts(shard: str) -> None:
    allocations = [scene_allocation(scene_id, OBJECTS) for scene_id in scenes_of_shard(shard)]
    assert min(Counter(allocation.category for allocation in allocations).values()) >= 6
    assert min(Counter(allocation.n_obstacles for allocation in allocations).values()) >= 5


def test_an_empty_catalogue_is_refused() -> None:
    with pytest.raises(ValueError, match="0 objects"):
        scene_allocation("mini-0000", [])


def test_a_small_catalogue_works() -> None:
    assert {allocation.object_id for allocation in family_allocation("mini", OBJECTS[:2])} == {"can_01", "can_02"}
