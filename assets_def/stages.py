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

from assets_def.checks import law_check_spec, schema_check_spec, stage_checks
from assets_def.metadata import table_metadata
from assets_def.partitions import shard_partitions
from assets_def.resources import Benchmark
from pipelines.running.shard_runner import Progress, run_stage
from pipelines.stage import Stage
from pipelines.stages import STAGES

PROGRESS = logging.getLogger("placebench.progress")


def _asset_of(stage: Stage) -> AssetsDefinition:
    upstream = [*(schema.name for schema in stage.inputs), *stage.objects]
    specs = [
        AssetSpec(
            schema.name,
            deps=upstream,
            description=f"{stage.description}\n\nRows: {schema.meaning}.",
            group_name=stage.group,
            code_version=stage.code_version,
            kinds={"parquet"},
        )
        for schema in stage.outputs
    ]

    @multi_asset(
        name=f"make_{stage.name}",
        specs=specs,
        check_specs=[*(schema_check_spec(schema) for schema in stage.outputs), law_check_spec(stage)],
        partitions_def=shard_partitions,
    )
    def make(context: AssetExecutionContext, benchmark: Benchmark) -> Iterator[MaterializeResult[None] | AssetCheckResult]:
        shard = context.partition_key
        inputs = benchmark.shard_inputs(shard)
        report = run_stage(stage, shard, benchmark.root, inputs, benchmark.n_workers, lambda p: _tell(context, p), context.log.warning)
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
        yield from stage_checks(stage, benchmark.root, shard, inputs.promise)

    return make


def _tell(context: AssetExecutionContext, progress: Progress) -> None:
    """Every unit to whoever draws a progress bar, every tenth of them to the run's log."""
    PROGRESS.debug("unit", extra={"progress": progress})
    tenth = max(1, progress.total // 10)
    if progress.done % tenth == 0 or progress.done == progress.total:
        context.log.info(f"{progress.shard}.{progress.stage}: {progress.done} of {progress.total} units")


stage_assets = [_asset_of(stage) for stage in STAGES]
