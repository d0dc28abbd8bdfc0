"""Ids round-trip, seeds depend on identity alone."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tables.identity import (
    N_FULL_SHARDS,
    CandidateId,
    IdentityError,
    candidate_id_of,
    n_scenes_of,
    ompl_seed_for,
    order_key,
    parse_candidate_id,
    parse_scene_id,
    rng_for,
    scene_id_of,
    scenes_of_shard,
    shard_of_scene,
    shards_of_tier,
)


@given(st.integers(0, n_scenes_of("full") - 1), st.integers(0, 7), st.integers(0, 63))
def test_candidate_id_round_trip(index: int, target_id: int, grasp_id: int) -> None:
    scene_id = scene_id_of("full", index)
    assert parse_candidate_id(candidate_id_of(scene_id, target_id, grasp_id)) == CandidateId(scene_id, target_id, grasp_id)


@pytest.mark.parametrize(
    "text",
    [
        *("full-0042", "full-42-t3-g17", "full-0042-t3-g7", "tiny-0001-t0-g00", "mini-0012-t0-g00"),
        f"full-{n_scenes_of('full'):04d}-t0-g00",
    ],
)
def test_strange_candidate_ids_are_refused(text: str) -> None:
    with pytest.raises(IdentityError):
        parse_candidate_id(text)


def test_shards_partition_the_family() -> None:
    scenes = [scene_id for shard in shards_of_tier("full") for scene_id in scenes_of_shard(shard)]
    assert len(scenes) == len(set(scenes)) == n_scenes_of("full") == 1235
    assert all(shard_of_scene(scene_id) == shard for shard in shards_of_tier("full") for scene_id in scenes_of_shard(shard))
    assert scenes_of_shard("mini-000") == tuple(scene_id_of("mini", k) for k in range(12))


def test_full_is_as_large_as_the_reference_and_shards_stay_few() -> None:
    """The reference has 1,235 scenes; two digits would do for a shard."""
    assert n_scenes_of("full") >= 1235
    assert len(shards_of_tier("full")) == N_FULL_SHARDS < 99


def test_pilot_is_the_start_of_full() -> None:
    assert shards_of_tier("pilot") == shards_of_tier("full")[:4]


@pytest.mark.parametrize("shard", [f"full-{N_FULL_SHARDS:03d}", "mini-001", "full-1", "pilot-000", ""])
def test_strange_shards_are_refused(shard: str) -> None:
    with pytest.raises(IdentityError, match="is not a shard"):
        scenes_of_shard(shard)


@given(st.integers(0, 2**40), st.text(max_size=12), st.integers(0, 99))
def test_seeds_are_a_function_of_identity(seed: int, stage: str, k: int) -> None:
    assert rng_for(seed, stage, "a", k).random() == rng_for(seed, stage, "a", k).random()
    assert rng_for(seed, stage, "a", k).random() != rng_for(seed, stage, "a", k + 1).random()
    assert 1 <= ompl_seed_for(seed, stage, k) <= 2147483646
    assert 0 <= order_key(seed, stage, k) < 2**63


def test_parts_of_an_identity_do_not_run_together() -> None:
    assert order_key(1, "s", "ab", "c") != order_key(1, "s", "a", "bc")


def test_scene_ids_keep_their_meaning() -> None:
    """A golden draw: changing how seeds are made would change every dataset."""
    assert parse_scene_id("full-0042") == ("full", 42)
    assert rng_for(42, "golden", "full-0042").integers(1_000_000) == 897_912
