"""Blocking gates on what was published, re-read from disk: schema and hash of every table, and the law of every stage."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from dagster import AssetCheckResult, AssetCheckSpec, MetadataValue

from pipelines.running.data_root import DataRoot
from pipelines.stage import Promise, Stage
from tables.columns import TableSchema
from tables.store import StoreError, file_sha256, read_sidecar, read_table

# A file that is missing, changed or broken: SchemaError and what Arrow and JSON say of one are ValueErrors.
_UNREADABLE = (StoreError, ValueError, TypeError, KeyError, OSError)


def schema_check_spec(schema: TableSchema, asset: str = "") -> AssetCheckSpec:
    """A table on disk is what its sidecar and its schema say; `asset` where the asset is not named as the table is."""
    return AssetCheckSpec(
        "schema",
        asset=asset or schema.name,
        blocking=True,
        description="Re-reads the file: SHA-256, types, nulls, closed enums, finite numbers, keys.",
    )


def schema_check(schema: TableSchema, path: Path, asset: str = "") -> AssetCheckResult:
    """Result of `schema_check_spec`, with what was compared as far as it could be read."""
    asset = asset or schema.name
    shown: dict[str, Any] = {"path": MetadataValue.path(str(path))}
    try:
        shown |= {"sha256_recorded": read_sidecar(path).sha256, "sha256_on_disk": file_sha256(path)}
        table = read_table(schema, path, verify=True)
    except _UNREADABLE as error:
        return AssetCheckResult(passed=False, check_name="schema", asset_key=asset, metadata={"error": str(error), **shown})
    shown |= {"rows": table.num_rows, "columns": len(schema.columns), "unique_key": ", ".join(schema.key)}
    return AssetCheckResult(passed=True, check_name="schema", asset_key=asset, metadata=shown)


def law_check_spec(stage: Stage) -> AssetCheckSpec:
    """The law of a stage, on the first of its tables; the same that ran before they were published."""
    reads = [schema.name for schema in (*stage.inputs, *stage.outputs[1:])]
    return AssetCheckSpec("consistent", asset=stage.outputs[0].name, blocking=True, description=stage.law.__doc__, additional_deps=reads)


def law_check(stage: Stage, root: DataRoot, shard: str, promise: Promise) -> AssetCheckResult:
    """Result of `law_check_spec`, with the law's sentences and how many rows of which tables it was asked of."""
    reads = (*stage.inputs, *stage.outputs)
    compared: dict[str, Any] = {"law": inspect.getdoc(stage.law) or ""}

    def errors() -> Sequence[str]:
        tables = root.read_shard(shard, reads)
        compared["rows_compared"] = ", ".join(f"{name} {table.num_rows:,}" for name, table in tables.items())
        return stage.law(tables, promise)

    return consistency_check(stage.outputs[0].name, errors, compared)


def stage_checks(stage: Stage, root: DataRoot, shard: str, promise: Promise) -> Iterator[AssetCheckResult]:
    """Every gate of a stage."""
    for schema in stage.outputs:
        yield schema_check(schema, root.shard_table(shard, schema.name))
    yield law_check(stage, root, shard, promise)


def consistency_check(asset: str, errors: Callable[[], Sequence[str]], compared: Mapping[str, Any] | None = None) -> AssetCheckResult:
    """A check of what is on disk; red too where that cannot even be read.

    Args:
        errors: reads and compares; one sentence for everything that is wrong.
        compared: what the check's page shows of that; looked at after `errors` has run.
    """
    try:
        found = errors()
    except _UNREADABLE as error:
        found = [f"{type(error).__name__}: {error}"]
    return consistency_result(asset, found, compared)


def consistency_result(asset: str, errors: Sequence[str], compared: Mapping[str, Any] | None = None) -> AssetCheckResult:
    """A check that passes without errors and shows the first ten."""
    metadata: dict[str, Any] = {"n_errors": len(errors), "first_errors": "\n".join(errors[:10]) or "none", **(compared or {})}
    return AssetCheckResult(passed=not errors, check_name="consistent", asset_key=asset, metadata=metadata)
