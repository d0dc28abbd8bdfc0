"""Which split a scene group belongs to, decided by the id of the scene alone; leakage.py checks whether anything leaked."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, product
from typing import Any

from tables.errors import PlaceBenchError
from tables.identity import IdentityError, order_key, parse_scene_id
from tables.layout import Layout
from tables.vocabulary import Split

UniverseScene = tuple[str, str, int]  # scene id, category, number of obstacles

_Cell = tuple[int, Split]  # number of obstacles, split

_SPLITS = (Split.TRAIN, Split.VALIDATION, Split.TEST)


class SplitError(PlaceBenchError, ValueError):
    """A universe or a parameter that cannot be split; names the scene or field, its value and the bound."""


@dataclass(frozen=True, slots=True)
class SplitParams:
    """Shares of the scene groups."""

    # Candidates of the dataset of the paper: 153,072 / 48,200 / 48,376 of 249,648.
    train_share: float = 153_072 / 249_648
    validation_share: float = 48_200 / 249_648
    # Twelve scenes would otherwise leave a category out of a split, and its report without a row.
    min_scenes_per_category: int = 1

    def __post_init__(self) -> None:
        for name in ("train_share", "validation_share"):
            value = getattr(self, name)
            if not 0.0 < value < 1.0:
                raise SplitError(f"{name} {value!r}, must be in (0, 1)")
        if self.train_share + self.validation_share >= 1.0:
            total = self.train_share + self.validation_share
            raise SplitError(f"train_share + validation_share {total!r}, must be below 1 to leave a test split")
        if self.min_scenes_per_category < 0:
            raise SplitError(f"min_scenes_per_category {self.min_scenes_per_category}, must be at least 0")

    @property
    def shares(self) -> dict[Split, float]:
        """Share of every split; they add up to 1."""
        return {
            Split.TRAIN: self.train_share,
            Split.VALIDATION: self.validation_share,
            Split.TEST: 1.0 - self.train_share - self.validation_share,
        }


def split_rows(
    scene_ids: Sequence[str], universe: Sequence[UniverseScene], layout: Layout, params: SplitParams, seed: int
) -> list[dict[str, Any]]:
    """Rows of `splits` for some scenes of a family.

    The whole family is split, built or not, so that a scene of `pilot` keeps its split in `full`. Within each block (the scenes of
    the pilot or the others, one category) scenes are dealt in the order of their hash, each to the split that is furthest behind its
    share of family and block; the totals of pilot and rest are met exactly. Then scenes of a block that differ in their obstacle
    count change places until no exchange brings the obstacle counts of the splits nearer to their shares.

    Args:
        scene_ids: the scenes wanted.
        universe: (scene id, category, number of obstacles) of every scene of their family, in any order.
        layout: says which scenes are of the pilot.
        params: shares.
        seed: the recipe seed.

    Raises:
        SplitError: a wanted scene that the universe lacks, a scene listed twice, a malformed id, or two families at once.
    """
    universe = _checked(universe)
    split_of = _split_universe(universe, layout, params, seed)
    missing = sorted(set(scene_ids) - split_of.keys())
    if missing:
        raise SplitError(f"{missing[0]}: not in the universe of {len(universe)} scenes ({len(missing)} scenes are not)")
    return [{"scene_id": scene_id, "split": split_of[scene_id].value} for scene_id in sorted(set(scene_ids))]


def shard_split_rows(shard: Sequence[UniverseScene], number: int, params: SplitParams, seed: int) -> list[dict[str, Any]]:
    """Rows of `splits` for the scenes of one shard, dealt by themselves: what other shards there are decides nothing.

    Validation and test take scenes of one obstacle count after the other, of each the one that hashes lowest; the first count is another
    in the next shard, so that the counts of a split even out over three shards.

    Args:
        shard: its scenes.
        number: of the shard in its family.
        params: shares.
        seed: the recipe seed.

    Raises:
        SplitError: a malformed id, a scene listed twice, or two families at once.
    """
    scenes = sorted(_checked(shard), key=lambda scene: order_key(seed, "splits", scene[0]))
    counts = sorted({n_obstacles for _, _, n_obstacles in scenes})
    queues = {n: [scene_id for scene_id, _, of in scenes if of == n] for n in counts}
    split_of, totals, turn = (
        dict.fromkeys((scene_id for scene_id, _, _ in scenes), Split.TRAIN),
        _rounded(len(scenes), params.shares),
        number,
    )
    for split in (Split.VALIDATION, Split.TEST):
        for _ in range(totals[split]):
            while not queues[counts[turn % len(counts)]]:
                turn += 1
            split_of[queues[counts[turn % len(counts)]].pop(0)] = split
            turn += 1
    return [{"scene_id": scene_id, "split": split.value} for scene_id, split in sorted(split_of.items())]


def _checked(universe: Sequence[UniverseScene]) -> list[UniverseScene]:
    try:
        families = {parse_scene_id(scene_id)[0] for scene_id, _, _ in universe}
    except IdentityError as error:
        raise SplitError(f"universe: {error}") from error
    if len(families) > 1:
        raise SplitError(f"universe: scenes of {len(families)} families {sorted(families)}, must be 1")
    repeated = [scene_id for scene_id, n in Counter(scene_id for scene_id, _, _ in universe).items() if n > 1]
    if repeated:
        raise SplitError(f"{min(repeated)}: listed more than once in the universe, must be once")
    return sorted(universe)


def _split_universe(universe: Sequence[UniverseScene], layout: Layout, params: SplitParams, seed: int) -> dict[str, Split]:
    split_of: dict[str, Split] = {}
    by_hash = sorted(universe, key=lambda scene: order_key(seed, "splits", scene[0]))
    try:
        pilot = [scene for scene in by_hash if layout.is_of_pilot(scene[0])]
    except IdentityError as error:
        raise SplitError(f"universe: {error}") from error
    rest = [scene for scene in by_hash if not layout.is_of_pilot(scene[0])]
    before = dict.fromkeys(_SPLITS, 0)
    for n_scenes, part in ((len(pilot), pilot), (len(universe), rest)):
        totals = _rounded(n_scenes, params.shares)
        blocks = [[scene for scene in part if scene[1] == category] for category in sorted({scene[1] for scene in part})]
        split_of |= _dealt(blocks, {split: totals[split] - before[split] for split in _SPLITS}, params)
        _exchange(blocks, split_of, params.shares)
        before = totals
    return split_of


def _dealt(blocks: Sequence[Sequence[UniverseScene]], room: dict[Split, int], params: SplitParams) -> dict[str, Split]:
    """Deal the scenes of each block in order; a split has room for so many, but the minimum of a category outranks that."""
    split_of: dict[str, Split] = {}
    n_family: Counter[Split] = Counter()
    for block in blocks:
        n_block: Counter[Split] = Counter()
        # A category with fewer scenes cannot give every split its minimum and still leave most of them to train.
        minimum = params.min_scenes_per_category if len(block) > len(_SPLITS) * params.min_scenes_per_category else 0
        for n_dealt, (scene_id, _, _) in enumerate(block):
            owed = {split: max(0, minimum - n_block[split]) for split in _SPLITS}
            is_last_chance = len(block) - n_dealt == sum(owed.values())
            allowed = [split for split in _SPLITS if owed[split] or not is_last_chance]
            roomy = [split for split in allowed if n_family[split] < room[split]]

            def behind(split: Split, n_block: Counter[Split] = n_block, n_dealt: int = n_dealt) -> tuple[float, int]:
                share = params.shares[split]
                expected = share * (len(split_of) + 1) + share * (n_dealt + 1)
                return expected - n_family[split] - n_block[split], -_SPLITS.index(split)

            choice = max(roomy or allowed, key=behind)
            n_family[choice] += 1
            n_block[choice] += 1
            split_of[scene_id] = choice
    return split_of


def _exchange(blocks: Sequence[Sequence[UniverseScene]], split_of: dict[str, Split], shares: dict[Split, float]) -> None:
    """Let pairs of scenes of one block change places, the most useful pair first, while that balances the obstacle counts.

    What shrinks is the squared distance of the splits from their shares of every obstacle count, in each block and over all together.
    """
    surplus: dict[tuple[int | None, int, Split], float] = {}  # by block or all, obstacle count, split: scenes more than its share
    for number, block in enumerate(blocks):
        for scene_id, _, n_obstacles in block:
            for level, split in product((number, None), _SPLITS):
                cell = (level, n_obstacles, split)
                surplus[cell] = surplus.get(cell, 0.0) + (split is split_of[scene_id]) - shares[split]

    def moves(number: int, a: _Cell, b: _Cell) -> list[tuple[tuple[int | None, int, Split], int]]:
        return [((level, *cell), by) for level in (number, None) for cell, by in ((a, -1), ((a[0], b[1]), 1), (b, -1), ((b[0], a[1]), 1))]

    while True:
        gains = [
            (sum(surplus[cell] ** 2 - (surplus[cell] + by) ** 2 for cell, by in moves(number, a, b)), number, a, b)
            for number, block in enumerate(blocks)
            for a, b in _exchangeable(block, split_of)
        ]
        gain, number, a, b = max(gains, key=lambda item: item[0], default=(0.0, 0, (0, Split.TRAIN), (0, Split.TRAIN)))
        if gain < 1e-9:
            return
        first = _first_of_cells(blocks[number], split_of)
        split_of[first[a]], split_of[first[b]] = b[1], a[1]
        for cell, by in moves(number, a, b):
            surplus[cell] += by


def _exchangeable(block: Sequence[UniverseScene], split_of: dict[str, Split]) -> list[tuple[_Cell, _Cell]]:
    cells = sorted(_first_of_cells(block, split_of))
    return [(a, b) for a, b in combinations(cells, 2) if a[0] != b[0] and a[1] != b[1]]


def _first_of_cells(block: Sequence[UniverseScene], split_of: dict[str, Split]) -> dict[_Cell, str]:
    """The scene that hashes lowest in every (obstacle count, split) cell of a block that holds one."""
    first: dict[_Cell, str] = {}
    for scene_id, _, n_obstacles in block:
        first.setdefault((n_obstacles, split_of[scene_id]), scene_id)
    return first


def _rounded(n_scenes: int, shares: dict[Split, float]) -> dict[Split, int]:
    """Whole numbers of scenes that add up, by largest remainder; train first on a tie."""
    exact = {split: shares[split] * n_scenes for split in _SPLITS}
    rounded = {split: math.floor(exact[split] + 1e-9) for split in _SPLITS}
    by_remainder = sorted(_SPLITS, key=lambda split: (rounded[split] - exact[split], _SPLITS.index(split)))
    for split in by_remainder[: n_scenes - sum(rounded.values())]:
        rounded[split] += 1
    return rounded
