"""Partition keys and how they map: shards to tiers, tiers to trained rankers."""

from __future__ import annotations

from dataclasses import dataclass

from dagster import StaticPartitionMapping, StaticPartitionsDefinition

from assets_def.resources import layout_of_graph
from model.settings import Variant
from tables.identity import TIERS

SEEDS_OF_TIER = {"mini": (42,), "pilot": (42,), "full": (42, 43, 44)}


@dataclass(frozen=True, slots=True)
class RankerKey:
    """One training run."""

    tier: str
    variant: Variant
    seed: int

    def __str__(self) -> str:
        return f"{self.tier}.{self.variant.value}.{self.seed}"


def rankers_of_tier(tier: str) -> tuple[RankerKey, ...]:
    """Every training run whose predictions a tier's reports read."""
    return tuple(RankerKey(tier, variant, seed) for variant in Variant for seed in SEEDS_OF_TIER[tier])


def parse_ranker_key(key: str) -> RankerKey:
    """The training run a partition key names."""
    tier, variant, seed = key.split(".")
    return RankerKey(tier, Variant(variant), int(seed))


SHARDS_OF_TIER = {tier: layout_of_graph().shards_of_tier(tier) for tier in TIERS}
_SHARDS = (*SHARDS_OF_TIER["mini"], *SHARDS_OF_TIER["full"])

shard_partitions = StaticPartitionsDefinition(list(_SHARDS))
tier_partitions = StaticPartitionsDefinition(list(TIERS))
ranker_partitions = StaticPartitionsDefinition([str(key) for tier in TIERS for key in rankers_of_tier(tier)])

shards_to_tiers = StaticPartitionMapping({s: [t for t in TIERS if s in SHARDS_OF_TIER[t]] for s in _SHARDS})
tiers_to_rankers = StaticPartitionMapping({t: [str(key) for key in rankers_of_tier(t)] for t in TIERS})
rankers_to_tiers = StaticPartitionMapping({str(key): t for t in TIERS for key in rankers_of_tier(t)})
