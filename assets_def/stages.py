"""The chain from scenes to labels, one asset a table, partitioned by shard; the work is pipelines.running.shard_runner's."""

import logging
from collections.abc import Iterator

from dagster import (
    AssetCheckResult,
    AssetExecutionContext,
    AssetsDefinition,
    AssetSpec,
    DataVersion,
    MaterializeResult,
    multi_asset,
)

from assets_def.checks import schema_check, schema_check_spec, stage_check_specs, stage_checks
from assets_def.metadata import table_metadata
from assets_def.partitions import shard_partitions
from assets_def.resources import Benchmark
from pipelines.running.data_root import OBJECT_TABLES
from pipelines.running.shard_runner import Progress, run_stage
from pipelines.stages import STAGES, Stage

PROGRESS = logging.getLogger("placebench.progress")

DESCRIPTIONS = {
    "scenes": "Draws scenes: an object settled at a stable pose, box obstacles in the way, eight targets that hold the object at rest.",
    "scene_points": "Renders two depth views of each initial scene and keeps a typed point cloud: environment, object, obstacle.",
    "grasp_admission": "Tests every pool grasp in every scene by geometry alone and keeps the reason for each rejection.",
    "pick_lift": "Executes each admitted grasp in physics: approach, close, lift, hold; keeps the measured state after the lift.",
    "candidate_pairs": "Pairs every lifted grasp with every target of its scene.",
    "policy_features": "Computes what the endpoint baselines know: IK without collisions, the gripper alone at the place pose.",
    "planning_labels": "Plans transport, descend and retreat for every candidate and says why where there is no plan.",
    "execution_labels": "Executes every plan in physics from the measured post-lift state and validates the final object pose.",
}
GROUPS = {
    "scenes": "scenes",
    "scene_points": "scenes",
    "grasp_admission": "grasps",
    "pick_lift": "grasps",
    "candidate_pairs": "candidates",
    "policy_features": "candidates",
    "planning_labels": "labels",
    "execution_labels": "labels",
}


def _asset_of(stage: Stage) -> AssetsDefinition:
    upstream = [schema.name for schema in stage.inputs] or list(OBJECT_TABLES)
    specs = [
        AssetSpec(
            schema.name,
            deps=upstream,
            description=f"{DESCRIPTIONS[stage.name]}\n\nRows: {schema.meaning}.",
            group_name=GROUPS[stage.name],
            code_version=stage.code_version,
            kinds={"parquet"},
        )
        for schema in stage.outputs
    ]

    @multi_asset(
        name=f"make_{stage.name}",
        specs=specs,
        check_specs=[*(schema_check_spec(schema) for schema in stage.outputs), *stage_check_specs(stage)],
        partitions_def=shard_partitions,
    )
    def make(context: AssetExecutionContext, benchmark: Benchmark) -> Iterator[MaterializeResult | AssetCheckResult]:
        shard = context.partition_key
        inputs = benchmark.shard_inputs(shard)
        report = run_stage(stage, shard, benchmark.root, inputs, benchmark.n_workers, lambda p: _tell(context, p))
        context.log.info(f"{shard}.{stage.name}: {'up to date' if report.is_reused else f'made in {report.wall_s:.1f} s'}")
        for schema in stage.outputs:
            sidecar = report.sidecars[schema.name]
            path = benchmark.root.shard_table(shard, schema.name)
            metadata = table_metadata(schema, path, sidecar) | {
                "reused": report.is_reused,
                "wall_s": report.wall_s,
                "core_s": report.core_s,
                "units": report.n_units,
                "peak_worker_gib": report.peak_gib,
            }
            yield MaterializeResult(schema.name, metadata=metadata, data_version=DataVersion(sidecar.content_hash))
            yield schema_check(schema, path)
        yield from stage_checks(stage, benchmark.root, shard, inputs.allocations)

    return make


def _tell(context: AssetExecutionContext, progress: Progress) -> None:
    """Every unit to whoever draws a progress bar, every tenth of them to the run's log."""
    PROGRESS.debug("unit", extra={"progress": progress})
    tenth = max(1, progress.total // 10)
    if progress.done % tenth == 0 or progress.done == progress.total:
        context.log.info(f"{progress.shard}.{progress.stage}: {progress.done} of {progress.total} units")


stage_assets = [_asset_of(stage) for stage in STAGES]
