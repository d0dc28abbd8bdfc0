"""The whole asset graph: `dagster dev -m assets_def.definitions` and `dagster asset materialize -m assets_def.definitions` load this.

There is no IO manager, because an asset's value never passes through Dagster: many worker processes write a table's scenes one by one, a
killed run resumes with what they left, and `tables.store` publishes the table with its hash, none of which one load and one dump a
partition can do; what an asset depends on is declared by name, and each reads it from `DataRoot`.
"""

from __future__ import annotations

from dagster import Definitions, in_process_executor

from assets_def.curve_assets import curve_assets
from assets_def.jobs import jobs
from assets_def.object_assets import object_assets
from assets_def.ownership import owned
from assets_def.proof_assets import proof_assets
from assets_def.ranker_assets import ranker_assets
from assets_def.release_assets import release_assets
from assets_def.report_assets import report_assets
from assets_def.resources import Benchmark
from assets_def.site_assets import sample_films, site
from assets_def.stages import stage_assets
from assets_def.trees_assets import trees_assets

_ASSETS = tuple(
    owned(assets)
    for assets in (
        object_assets,
        *stage_assets,
        *release_assets,
        *ranker_assets,
        *trees_assets,
        *curve_assets,
        *proof_assets,
        *report_assets,
        sample_films,
        site,
    )
)


def definitions_of(benchmark: Benchmark) -> Definitions:
    """The graph over the folders and the recipe of a benchmark."""
    # In process: the parallelism is inside an asset, over scenes; a process a step would cost 20 s a shard.
    return Definitions(assets=_ASSETS, jobs=jobs, resources={"benchmark": benchmark}, executor=in_process_executor)


definitions = definitions_of(Benchmark())
