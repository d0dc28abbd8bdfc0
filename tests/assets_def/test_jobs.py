"""Named jobs cover the graph, each as it is partitioned; assets have an owner and tags."""

from __future__ import annotations

import pytest
from dagster import AssetKey, AssetSelection, DagsterInvalidDefinitionError, Definitions, JobDefinition, define_asset_job

from assets_def.definitions import definitions
from assets_def.jobs import job_of, jobs
from assets_def.partitions import ranker_partitions, shard_partitions, tier_partitions
from pipelines.stages import STAGES
from tables.layout import INTERLEAVED

PARTITIONS = {
    "objects": None,
    "mini": shard_partitions,
    "pilot": shard_partitions,
    "full": shard_partitions,
    "release": tier_partitions,
    "rankers": ranker_partitions,
    "reports": tier_partitions,
}


def job(name: str) -> JobDefinition:
    return definitions.resolve_job_def(name)


def test_every_job_is_partitioned_as_its_assets_are() -> None:
    assert {job.name for job in jobs} == set(PARTITIONS)
    for name, partitions in PARTITIONS.items():
        assert job(name).partitions_def == partitions, name


def test_the_jobs_cover_the_graph() -> None:
    selected = {name: job(name).asset_layer.executable_asset_keys for name in PARTITIONS}
    graph = definitions.resolve_asset_graph()
    assert set().union(*selected.values()) == graph.executable_asset_keys
    made_in_shards = {schema.name for stage in STAGES for schema in stage.outputs}
    assert {key.to_user_string() for key in selected["mini"]} > made_in_shards
    assert selected["mini"] == selected["pilot"] == selected["full"]
    shared = [selected["release"] & selected["reports"], selected["rankers"] & selected["reports"], selected["mini"] & selected["release"]]
    assert shared == [set(), set(), set()]


def test_a_description_says_what_to_launch_with() -> None:
    for tier in ("mini", "pilot", "full"):
        description = job(tier).description or ""
        assert INTERLEAVED.shards_of_tier(tier)[0] in description
        assert INTERLEAVED.shards_of_tier(tier)[-1] in description
    assert "mini.full.42" in (job("rankers").description or "")
    assert "mini.full.42" in ranker_partitions.get_partition_keys()


def test_mini_knows_its_partition() -> None:
    assert job("mini").run_tags == {"dagster/partition": "mini-000"}
    assert all("dagster/partition" not in job(name).run_tags for name in PARTITIONS if name != "mini")


def test_dagster_still_refuses_a_job_over_two_partitions_definitions() -> None:
    """What assets_def/jobs.py explains; when this fails, one job a tier has become possible."""
    whole = Definitions(assets=definitions.assets, resources=definitions.resources, jobs=[define_asset_job("whole", AssetSelection.all())])
    with pytest.raises(DagsterInvalidDefinitionError) as refused:
        whole.resolve_job_def("whole")
    assert "must have the same partitions definitions" in f"{refused.value} {refused.value.__cause__}"


def test_every_asset_has_owner_and_tags() -> None:
    graph = definitions.resolve_asset_graph()
    by_partitions = {None: "nothing", shard_partitions: "shard", tier_partitions: "tier", ranker_partitions: "ranker"}
    for node in graph.asset_nodes:
        assert node.owners == ["team:placebench"], node.key
        assert node.tags["placebench/partitioned_by"] == by_partitions[node.partitions_def], node.key
        assert node.tags["placebench/step"], node.key
    scenes = AssetSelection.tag("placebench/step", "make_scenes").resolve(graph)
    assert {key.to_user_string() for key in scenes} == {"scenes", "scene_attempts", "obstacles", "targets"}


@pytest.mark.parametrize(
    ("asset", "partition", "name"),
    [
        ("grasp_pool", None, "objects"),
        ("scenes", "mini-000", "mini"),
        ("execution_labels", INTERLEAVED.shards_of_tier("pilot")[-1], "pilot"),
        ("execution_labels", INTERLEAVED.shards_of_tier("full")[-1], "full"),
        ("splits", "mini", "release"),
        ("ranker", "mini.full.42", "rankers"),
        ("predictions", "full", "reports"),
        ("site", "full", "reports"),
    ],
)
def test_a_build_s_runs_are_of_named_jobs(asset: str, partition: str | None, name: str) -> None:
    assert job_of(definitions, [AssetKey(asset)], partition) == name


def test_there_is_no_job_over_everything() -> None:
    with pytest.raises(KeyError, match=r"no job makes all of \['ranker', 'scenes'\]"):
        job_of(definitions, [AssetKey("scenes"), AssetKey("ranker")], "mini-000")
