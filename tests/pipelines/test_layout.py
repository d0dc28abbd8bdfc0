"""Layouts are balanced over objects, categories and shards, and depend on the id alone."""

from __future__ import annotations

from collections import Counter

import pytest

from pipelines.layout import family_layout, scene_layout
from tables.identity import scenes_of_shard, shards_of_tier

OBJECTS = [(f"{category}_{k:02d}", category) for category in ("can", "mug", "cuboid") for k in range(1, 11)]


def test_mini_has_twelve_objects_and_each_obstacle_count_four_times() -> None:
    layouts = family_layout("mini", OBJECTS)
    assert len({layout.object_id for layout in layouts}) == 12
    assert Counter(layout.category for layout in layouts) == {"can": 4, "mug": 4, "cuboid": 4}
    assert Counter(layout.n_obstacles for layout in layouts) == {0: 4, 1: 4, 2: 4}


def test_full_is_balanced_over_objects() -> None:
    layouts = family_layout("full", OBJECTS)
    per_object = Counter(layout.object_id for layout in layouts)
    assert set(per_object.values()) <= {41, 42}
    pairs = Counter((layout.object_id, layout.n_obstacles) for layout in layouts)
    assert len(pairs) == 90
    assert max(pairs.values()) - min(pairs.values()) <= 1


@pytest.mark.parametrize("shard", shards_of_tier("full"))
def test_every_shard_holds_all_categories_and_counts(shard: str) -> None:
    layouts = [scene_layout(scene_id, OBJECTS) for scene_id in scenes_of_shard(shard)]
    assert min(Counter(layout.category for layout in layouts).values()) >= 6
    assert min(Counter(layout.n_obstacles for layout in layouts).values()) >= 5


def test_an_empty_catalogue_is_refused() -> None:
    with pytest.raises(ValueError, match="0 objects"):
        scene_layout("mini-0000", [])


def test_a_small_catalogue_works() -> None:
    assert {layout.object_id for layout in family_layout("mini", OBJECTS[:2])} == {"can_01", "can_02"}
