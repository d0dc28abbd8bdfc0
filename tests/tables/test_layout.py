"""Shards part the scenes of a family and tiers are made of shards, in the benchmark and in catalogues that grow."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tables.identity import IdentityError, scene_id_of
from tables.layout import INTERLEAVED, MAX_APPENDED, Layout, layout_of
from tables.vocabulary import Allocation

layouts = st.integers(1, MAX_APPENDED).map(lambda n: layout_of(Allocation.APPENDED, n)) | st.just(INTERLEAVED)


@given(layouts, st.sampled_from(["mini", "full"]))
def test_shards_part_the_family(layout: Layout, family: str) -> None:
    scenes = layout.scenes_of_tier(family)
    assert scenes == layout.scenes_of_family(family)
    assert len(set(scenes)) == layout.n_scenes_of(family)
    shards = layout.shards_of_tier(family)
    assert all(layout.shard_of_scene(scene_id) == shard for shard in shards[::7] for scene_id in layout.scenes_of_shard(shard))


@given(layouts)
def test_pilot_is_a_part_of_full(layout: Layout) -> None:
    pilot = set(layout.scenes_of_tier("pilot"))
    assert pilot == {scene_id for scene_id in layout.scenes_of_family("full") if layout.is_of_pilot(scene_id)}
    assert not any(layout.is_of_pilot(scene_id) for scene_id in layout.scenes_of_family("mini"))


def test_the_benchmark_is_as_large_as_the_reference_and_its_shards_stay_few() -> None:
    """The reference has 1,235 scenes; two digits would do for a shard."""
    assert INTERLEAVED.n_scenes_of("full") == 1235
    assert len(INTERLEAVED.shards_of_tier("full")) == 65 < 99
    assert INTERLEAVED.shards_of_tier("pilot") == INTERLEAVED.shards_of_tier("full")[:4]
    assert INTERLEAVED.scenes_of_shard("mini-000") == tuple(scene_id_of("mini", k) for k in range(12))
    assert INTERLEAVED.scenes_of_shard("full-064")[-1] == "full-1234"


@pytest.mark.parametrize("shard", ["full-065", "mini-001", "full-1", "pilot-000", ""])
def test_strange_shards_are_refused(shard: str) -> None:
    with pytest.raises(IdentityError, match="is not a shard"):
        INTERLEAVED.scenes_of_shard(shard)


@pytest.mark.parametrize("n_objects", [0, MAX_APPENDED + 1])
def test_a_catalogue_has_no_layout_for_no_objects_or_for_too_many(n_objects: int) -> None:
    with pytest.raises(IdentityError, match=f"{n_objects} objects, must be 1 to {MAX_APPENDED}"):
        layout_of(Allocation.APPENDED, n_objects)
