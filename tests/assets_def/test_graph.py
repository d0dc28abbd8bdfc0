"""The asset graph is what the golden file says; partitions map as tiers are made of shards; gates fail on contradictions."""

from __future__ import annotations

import json
from pathlib import Path

import polars as pl
import pytest
from dagster import AssetKey

from assets_def.checks import _GATES, stage_check_specs
from assets_def.definitions import definitions
from assets_def.partitions import parse_ranker_key, ranker_partitions, rankers_of_tier, shard_partitions, tier_partitions
from pipelines.stages import STAGES
from tables.identity import shards_of_tier

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
    assert set(shards_of_tier("pilot")) < set(shard_partitions.get_partition_keys())


def test_ranker_keys_round_trip() -> None:
    for key in rankers_of_tier("full"):
        assert parse_ranker_key(str(key)) == key
        assert str(key) in ranker_partitions.get_partition_keys()
    assert len(rankers_of_tier("full")) == 12


_PAIRS = pl.DataFrame({"candidate_id": ["mini-0000-t0-g00", "mini-0000-t0-g01"]})
_PLANNED = _PAIRS.with_columns(y_plan=pl.Series([True, False]), plan_status=pl.Series(["solved", "no_ik"]))
_EXECUTED = _PAIRS.head(1).with_columns(y_pipe=pl.Series([True]), exec_status=pl.Series(["success"]))
_DENIED = _EXECUTED.with_columns(y_pipe=pl.lit(False))
_UNKNOWN = _EXECUTED.with_columns(y_pipe=pl.lit(None, pl.Boolean))


@pytest.mark.parametrize(
    ("stage", "changes", "message"),
    [
        ("planning_labels", {}, None),
        ("planning_labels", {"planning_labels": _PLANNED.with_columns(y_plan=pl.lit(True))}, "y_plan contradicts plan_status"),
        ("planning_labels", {"planning_labels": _PLANNED.head(1)}, "must agree"),
        ("planning_labels", {"plans": _PAIRS}, "must agree"),
        ("execution_labels", {}, None),
        ("execution_labels", {"execution_labels": _DENIED}, "y_pipe contradicts exec_status"),
        (
            "execution_labels",
            {"execution_labels": _UNKNOWN},
            "y_pipe contradicts exec_status",
        ),
        ("execution_labels", {"execution_labels": _EXECUTED.clear()}, "must agree"),
    ],
)
def test_a_gate_names_what_contradicts(stage: str, changes: dict[str, pl.DataFrame], message: str | None) -> None:
    frames = {"candidate_pairs": _PAIRS, "planning_labels": _PLANNED, "plans": _PAIRS.head(1), "execution_labels": _EXECUTED, **changes}
    errors = _GATES[stage][1](lambda name: frames[name], [])
    assert (errors == []) if message is None else any(message in error for error in errors)


def test_every_stage_has_a_gate() -> None:
    assert all(spec.blocking for stage in STAGES for spec in stage_check_specs(stage))


if __name__ == "__main__":
    GOLDEN.write_text(json.dumps(graph(), indent=1) + "\n")
