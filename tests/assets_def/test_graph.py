"""The asset graph is what the golden file says; partitions map as tiers are made of shards; gates fail on contradictions."""

from __future__ import annotations

import json
from pathlib import Path

from dagster import AssetKey

from assets_def.definitions import definitions
from assets_def.partitions import parse_ranker_key, ranker_partitions, rankers_of_tier, shard_partitions, tier_partitions
from pipelines.stages import STAGES
from tables.layout import INTERLEAVED

GOLDEN = Path(__file__).resolve().parent.parent / "golden" / "asset_graph.json"


def graph() -> dict[str, list[str]]:
    """Upstream assets of every asset, sorted: `python -m tests.assets_def.test_graph` rewrites the golden file with it."""
    nodes = sorted(definitions.resolve_asset_graph().asset_nodes, key=lambda node: node.key.to_user_string())
    return {node.key.to_user_string(): sorted(parent.to_user_string() for parent in node.parent_keys) for node in nodes}


def test_the_graph_is_the_golden_one() -> None:
    assert graph() == json.loads(GOLDEN.read_text())


def test_every_asset_explains_itself_and_sits_in_a_group() -> None:
    for node in definitions.resolve_asset_graph().asset_nodes:
        assert node.description, node.key
        assert len(node.description) > 30, node.key
        assert node.group_name != "default", node.key


def test_every_gate_blocks() -> None:
    graph = definitions.resolve_asset_graph()
    keys = graph.asset_check_keys
    assert {key.asset_key for key in keys} >= {AssetKey(schema.name) for stage in STAGES for schema in stage.outputs}
    assert all(graph.get(key).blocking for key in keys)


def test_partitions_are_few_enough_for_staleness_tracking() -> None:
    assert len(shard_partitions.get_partition_keys()) == 66 < 100
    assert tier_partitions.get_partition_keys() == ["mini", "pilot", "full"]
    assert set(INTERLEAVED.shards_of_tier("pilot")) < set(shard_partitions.get_partition_keys())


def test_ranker_keys_round_trip() -> None:
    for key in rankers_of_tier("full"):
        assert parse_ranker_key(str(key)) == key
        assert str(key) in ranker_partitions.get_partition_keys()
    assert len(rankers_of_tier("full")) == 18


if __name__ == "__main__":
    GOLDEN.write_text(json.dumps(graph(), indent=1) + "\n")
