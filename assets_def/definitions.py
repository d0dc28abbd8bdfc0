"""The whole asset graph: `dagster dev -m assets_def.definitions` and `dagster asset materialize -m assets_def.definitions` load this."""

from __future__ import annotations

from dagster import Definitions, in_process_executor

from assets_def.object_assets import object_assets
from assets_def.ranker_assets import ranker_assets
from assets_def.release_assets import release_assets
from assets_def.report_assets import report_assets
from assets_def.resources import Benchmark
from assets_def.stages import stage_assets

# In process: the parallelism is inside an asset, over scenes; a process a step would cost 20 s a shard.
definitions = Definitions(
    assets=[object_assets, *stage_assets, *release_assets, *ranker_assets, *report_assets],
    resources={"benchmark": Benchmark()},
    executor=in_process_executor,
)
