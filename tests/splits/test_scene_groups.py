from __future__ import annotations

import hashlib
from collections import Counter

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from objects.catalogue import CatalogueOrder
from pipelines.scenes.allocation import family_allocation
from splits.scene_groups import SplitError, SplitParams, UniverseScene, split_rows
from tables.layout import INTERLEAVED
from tables.vocabulary import Allocation

OBJECTS = [(f"{category}_{k:02d}", category) for category in ("can", "mug", "cuboid") for k in range(1, 11)]
CATALOGUE = CatalogueOrder(tuple(OBJECTS), Allocation.INTERLEAVED)
SPLITS = ("train", "validation", "test")


def universe_of(family: str) -> list[UniverseScene]:
    return [(allocation.scene_id, allocation.category, allocation.n_obstacles) for allocation in family_allocation(family, CATALOGUE)]


def splits_of(universe: list[UniverseScene], seed: int = 42, params: SplitParams | None = None) -> dict[str, str]:
    rows = split_rows([scene_id for scene_id, _, _ in universe], universe, INTERLEAVED, params or SplitParams(), seed)
    return {row["scene_id"]: row["split"] for row in rows}


FULL = universe_of("full")
PILOT_IDS = INTERLEAVED.scenes_of_tier("pilot")


@st.composite
def universes(draw: st.DrawFn) -> list[UniverseScene]:
    """Scenes of `full` with any categories and obstacle counts, gaps allowed, both in the pilot and outside it."""
    indices = draw(st.lists(st.integers(0, 160), unique=True, min_size=1, max_size=60))
    kinds = st.tuples(st.sampled_from(["can", "mug", "cuboid", "mesh"]), st.integers(0, 2))
    return [(f"full-{index:04d}", *draw(kinds)) for index in indices]


def test_full_is_split_as_the_reference_and_balanced() -> None:
    split_of = splits_of(FULL)
    # 1,235 scenes times the shares of the reference's candidates are 757.2 / 238.4 / 239.3.
    assert Counter(split_of.values()) == {"train": 757, "validation": 239, "test": 239}
    shares = {split.value: share for split, share in SplitParams().shares.items()}
    for is_pilot in (True, False):
        part = [scene for scene in FULL if (scene[0] in PILOT_IDS) == is_pilot]
        for margin in (lambda s: (), lambda s: s[1], lambda s: s[2], lambda s: (s[1], s[2])):
            sizes = Counter(margin(scene) for scene in part)
            cells = Counter((margin(scene), split_of[scene[0]]) for scene in part)
            for name, size in sizes.items():
                for split in SPLITS:
                    # Whole scenes cannot come nearer than 1 to every share at once.
                    assert abs(cells[name, split] - shares[split] * size) < 1.0 + 1e-9, (is_pilot, name, split)


@pytest.mark.parametrize("seed", [0, 1, 42])
def test_mini_has_every_category_and_obstacle_count_in_every_split(seed: int) -> None:
    universe = universe_of("mini")
    split_of = splits_of(universe, seed)
    assert Counter(split_of.values()) == {"train": 6, "validation": 3, "test": 3}
    for split in SPLITS:
        own = [scene for scene in universe if split_of[scene[0]] == split]
        assert {category for _, category, _ in own} == {"can", "mug", "cuboid"}
        assert {n_obstacles for _, _, n_obstacles in own} == {0, 1, 2}


def test_a_scene_keeps_its_split_in_every_tier() -> None:
    rows = split_rows(PILOT_IDS, FULL, INTERLEAVED, SplitParams(), 42)
    assert len(rows) == 76
    in_full = splits_of(FULL)
    assert all(row["split"] == in_full[row["scene_id"]] for row in rows)


def test_released_splits_never_move() -> None:
    """The second letters of the splits of all scenes in order, frozen: a change would move data across splits of a published release."""
    for family, frozen in (("full", "992afccc5e528c59"), ("mini", "dc65cee9d3b888e6")):
        assert _frozen(splits_of(universe_of(family))) == frozen, family


@pytest.mark.parametrize("n_scenes", [len(PILOT_IDS), 1000, len(FULL)])
def test_the_splits_of_the_pilot_do_not_depend_on_the_size_of_full(n_scenes: int) -> None:
    split_of = splits_of(FULL[:n_scenes])
    assert _frozen({scene_id: split_of[scene_id] for scene_id in PILOT_IDS}) == "a9473a5d7d8a1dd2"


def _frozen(split_of: dict[str, str]) -> str:
    letters = "".join(split[1] for _, split in sorted(split_of.items()))
    return hashlib.sha256(letters.encode()).hexdigest()[:16]


@given(universes(), st.randoms(use_true_random=False), st.integers(0, 5))
@settings(max_examples=40, deadline=None)
def test_the_order_of_the_universe_and_of_the_request_does_not_matter(universe: list[UniverseScene], random: object, seed: int) -> None:
    shuffled = list(universe)
    random.shuffle(shuffled)  # type: ignore[attr-defined]
    assert splits_of(universe, seed) == splits_of(shuffled, seed)
    some = [scene_id for scene_id, _, _ in shuffled[: len(shuffled) // 2]]
    whole = splits_of(universe, seed)
    assert split_rows(some, universe, INTERLEAVED, SplitParams(), seed) == [{"scene_id": s, "split": whole[s]} for s in sorted(some)]


@given(universes(), st.integers(0, 5))
@settings(max_examples=60, deadline=None)
def test_every_scene_has_one_split_and_totals_are_rounded_shares(universe: list[UniverseScene], seed: int) -> None:
    params = SplitParams(min_scenes_per_category=0)
    split_of = splits_of(universe, seed, params)
    assert sorted(split_of) == sorted(scene_id for scene_id, _, _ in universe)
    counts = Counter(split_of.values())
    for split, share in params.shares.items():
        assert abs(counts[split.value] - share * len(universe)) < 1.0 + 1e-9


@given(universes(), st.integers(0, 5))
@settings(max_examples=60, deadline=None)
def test_a_category_with_enough_scenes_is_in_every_split(universe: list[UniverseScene], seed: int) -> None:
    split_of = splits_of(universe, seed)
    blocks = Counter((scene_id in PILOT_IDS, category) for scene_id, category, _ in universe)
    for (is_pilot, category), n_scenes in blocks.items():
        if n_scenes > 3:
            found = {split_of[s] for s, c, _ in universe if c == category and (s in PILOT_IDS) == is_pilot}
            assert found == set(SPLITS)


def test_another_seed_gives_another_split() -> None:
    assert splits_of(FULL, 1) != splits_of(FULL, 2)


@pytest.mark.parametrize(
    ("wanted", "universe", "message"),
    [
        (["full-0001"], [("full-0000", "can", 0)], "full-0001: not in the universe of 1 scenes"),
        (["full-0000"], [("full-0000", "can", 0), ("full-0000", "can", 0)], "full-0000: listed more than once"),
        (["full-0000"], [("full-0000", "can", 0), ("mini-0000", "can", 0)], "2 families"),
        (["full-9999"], [("full-9999", "can", 0)], "scene index 9999"),
    ],
)
def test_a_universe_that_cannot_be_split_is_refused(wanted: list[str], universe: list[UniverseScene], message: str) -> None:
    with pytest.raises(SplitError, match=message):
        split_rows(wanted, universe, INTERLEAVED, SplitParams(), 42)


@pytest.mark.parametrize(
    "values",
    [{"train_share": 0.0}, {"validation_share": 1.2}, {"train_share": 0.7, "validation_share": 0.3}, {"min_scenes_per_category": -1}],
)
def test_shares_out_of_bounds_are_refused(values: dict[str, float]) -> None:
    with pytest.raises(SplitError, match=next(iter(values))):
        SplitParams(**values)  # type: ignore[arg-type]
