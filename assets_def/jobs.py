"""Named jobs: what is launched together, and what to launch it with.

A run has one partition key. So Dagster (1.13) refuses a job over assets with two partitions definitions ("Selected assets must have the
same partitions definitions"), and refuses to restrict a job to some of the partitions of its assets; assets without partitions may join
any job. The graph has three: shards, tiers and rankers. A whole tier from the UI is therefore four launches in this order: its own job
(`mini`, `pilot` or `full`), `release`, `rankers`, `reports`; `python -m assets_def.build TIER` goes through the same assets by itself.
"""

from __future__ import annotations

from collections.abc import Collection

from dagster import AssetKey, AssetSelection, Definitions, define_asset_job

from assets_def.partitions import SHARDS_OF_TIER
from pipelines.stages import STAGES

OBJECTS = AssetSelection.groups("objects")
OBJECTS_AND_SHARDS = AssetSelection.groups("objects", *dict.fromkeys(stage.group for stage in STAGES))
RELEASE = AssetSelection.groups("release")
RANKERS = AssetSelection.assets("ranker")
REPORTS = AssetSelection.groups("reports") | AssetSelection.assets(
    "predictions", "decision_times", "candidate_geometry", "tree_predictions", "tree_decision_times", "learning_curve"
)

_SHARDS_OF = SHARDS_OF_TIER
# Any other partition may be chosen; without a choice a run of `mini` is of its only shard.
_MINI = {"dagster/partition": _SHARDS_OF["mini"][0]} if len(_SHARDS_OF["mini"]) == 1 else None

jobs = [
    define_asset_job("objects", selection=OBJECTS, description="Meshes, parts, resting poses and grasp pools of the catalogue."),
    *(
        define_asset_job(
            tier,
            selection=OBJECTS_AND_SHARDS,
            description=f"Objects, and every table of the shards of tier {tier}. Launch with "
            + (f"partition {shards[0]}, which it takes by itself." if len(shards) == 1 else f"partitions {shards[0]} to {shards[-1]}."),
            run_tags=_MINI if tier == "mini" else None,
        )
        for tier, shards in _SHARDS_OF.items()
    ),
    define_asset_job(
        "release",
        selection=RELEASE,
        description="Joins, splits and publishes a tier. Launch with a partition mini, pilot or full, after its shards; again after"
        " `reports`, the release holds the repeats of its labels too.",
    ),
    define_asset_job(
        "rankers",
        selection=RANKERS,
        description="Trains rankers. Launch with the partitions of a tier (mini.full.42, mini.direct.42, ...), after its release.",
    ),
    define_asset_job(
        "reports",
        selection=REPORTS,
        description="Predictions, trees, learning curve, repeats, replicates, audits and every report of a tier. Launch with a partition"
        " mini, pilot or full, after its release and its rankers; without rankers only what reads predictions fails.",
    ),
]


def job_of(definitions: Definitions, keys: Collection[AssetKey], partition: str | None) -> str:
    """Name of the first job that makes some assets: of shards that of the smallest tier with the shard.

    Raises:
        KeyError: no job makes all of them.
    """
    for job in jobs:
        is_of_another_tier = job.name in _SHARDS_OF and partition not in _SHARDS_OF[job.name]
        if not is_of_another_tier and set(keys) <= set(definitions.resolve_job_def(job.name).asset_layer.executable_asset_keys):
            return job.name
    raise KeyError(f"no job makes all of {sorted(key.to_user_string() for key in keys)}")
