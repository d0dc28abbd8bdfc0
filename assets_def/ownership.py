"""Who answers for an asset and what it is sorted by in the UI, the same for all and derived from each."""

from __future__ import annotations

from dagster import AssetsDefinition, AssetSpec, PartitionsDefinition

from assets_def.partitions import ranker_partitions, shard_partitions, tier_partitions

OWNERS = ["team:placebench"]
_PARTITIONED_BY: dict[PartitionsDefinition[str] | None, str] = {
    None: "nothing",
    shard_partitions: "shard",
    tier_partitions: "tier",
    ranker_partitions: "ranker",
}


def owned(assets: AssetsDefinition) -> AssetsDefinition:
    """The assets with owner and tags: what they are partitioned by, and which step of the chain makes them."""
    return assets.map_asset_specs(
        lambda spec: spec.replace_attributes(owners=OWNERS, tags={**spec.tags, **_tags(spec, assets.node_def.name)})
    )


def _tags(spec: AssetSpec, step: str) -> dict[str, str]:
    return {"placebench/partitioned_by": _PARTITIONED_BY[spec.partitions_def], "placebench/step": step}
