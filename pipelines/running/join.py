"""Joins the tables of many shards into the two that users read: `candidates` with both labels, `grasps` with both outcomes."""

from __future__ import annotations

import polars as pl
import pyarrow as pa

from pipelines.frames import frame_of
from tables.columns import TableSchema
from tables.schemas import CANDIDATES, GRASPS
from tables.store import table_from_columns


def join_candidates(candidate_pairs: pa.Table, planning_labels: pa.Table, execution_labels: pa.Table) -> pa.Table:
    """Table `candidates`: every pair with its planning label, and its execution label or nulls where it was not planned."""
    frame = (
        frame_of(candidate_pairs)
        .join(frame_of(planning_labels), on="candidate_id", how="left", validate="1:1")
        .join(frame_of(execution_labels), on="candidate_id", how="left", validate="1:1")
    )
    return _table(CANDIDATES, frame)


def join_grasps(grasp_admission: pa.Table, pick_lift: pa.Table, scenes: pa.Table, grasp_pool: pa.Table) -> pa.Table:
    """Table `grasps`: every pool grasp in every scene with its admission outcome, and its pick-lift outcome where it was tried."""
    frame = (
        frame_of(grasp_admission)
        .join(frame_of(scenes).select("scene_id", "object_id"), on="scene_id", how="left", validate="m:1")
        .join(frame_of(grasp_pool).select("object_id", "grasp_id", "grasp_kind"), on=["object_id", "grasp_id"], how="left", validate="m:1")
        .join(frame_of(pick_lift), on=["scene_id", "grasp_id"], how="left", validate="1:1")
    )
    return _table(GRASPS, frame)


def _table(schema: TableSchema, frame: pl.DataFrame) -> pa.Table:
    joined = frame.to_arrow()
    return table_from_columns(schema, {name: joined[name] for name in schema.names})
