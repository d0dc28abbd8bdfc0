"""Publishes a table of a tier: file, materialization and schema check, the same for release, ranker and reports."""

from collections.abc import Iterator

import pyarrow as pa
from dagster import AssetCheckResult, DataVersion, MaterializeResult

from assets_def.checks import schema_check
from assets_def.metadata import table_metadata
from assets_def.resources import Benchmark
from tables.columns import TableSchema
from tables.store import write_table


def publish_tier_table(
    benchmark: Benchmark, tier: str, schema: TableSchema, table: pa.Table
) -> Iterator[MaterializeResult | AssetCheckResult]:
    """Write the table, then yield its materialization and the result of its `schema_check_spec`."""
    path = benchmark.root.tier_table(tier, schema.name)
    sidecar = write_table(schema, table, path)
    yield MaterializeResult(schema.name, metadata=table_metadata(schema, path, sidecar), data_version=DataVersion(sidecar.content_hash))
    yield schema_check(schema, path)
