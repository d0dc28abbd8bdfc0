"""Blocking gates on what was published, re-read from disk: schema and hash of every table, and the law of every stage."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from dagster import AssetCheckResult, AssetCheckSpec

from pipelines.running.data_root import DataRoot
from pipelines.stage import Promise, Stage
from tables.columns import SchemaError, TableSchema
from tables.store import StoreError, read_table


def schema_check_spec(schema: TableSchema) -> AssetCheckSpec:
    """A table on disk is what its sidecar and its schema say."""
    return AssetCheckSpec(
        "schema",
        asset=schema.name,
        blocking=True,
        description="Re-reads the file: SHA-256, types, nulls, closed enums, finite numbers, keys.",
    )


def schema_check(schema: TableSchema, path: Path) -> AssetCheckResult:
    """Result of `schema_check_spec`."""
    try:
        table = read_table(schema, path, verify=True)
    except (SchemaError, StoreError) as error:
        return AssetCheckResult(passed=False, check_name="schema", asset_key=schema.name, metadata={"error": str(error)})
    return AssetCheckResult(passed=True, check_name="schema", asset_key=schema.name, metadata={"rows": table.num_rows})


def law_check_spec(stage: Stage) -> AssetCheckSpec:
    """The law of a stage, on the first of its tables; the same that ran before they were published."""
    reads = [schema.name for schema in (*stage.inputs, *stage.outputs[1:])]
    return AssetCheckSpec("consistent", asset=stage.outputs[0].name, blocking=True, description=stage.law.__doc__, additional_deps=reads)


def law_check(stage: Stage, root: DataRoot, shard: str, promise: Promise) -> AssetCheckResult:
    """Result of `law_check_spec`."""
    try:
        tables = root.read_shard(shard, (*stage.inputs, *stage.outputs))
    except StoreError as error:
        return consistency_result(stage.outputs[0].name, [str(error)])
    return consistency_result(stage.outputs[0].name, stage.law(tables, promise))


def consistency_result(asset: str, errors: Sequence[str]) -> AssetCheckResult:
    """A check that passes without errors and shows the first ten."""
    metadata: dict[str, Any] = {"n_errors": len(errors), "first_errors": "\n".join(errors[:10])}
    return AssetCheckResult(passed=not errors, check_name="consistent", asset_key=asset, metadata=metadata)
