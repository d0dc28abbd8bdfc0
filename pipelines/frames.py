"""An Arrow table as a polars frame with plain strings; callers decide what to ask of it."""

from __future__ import annotations

from collections.abc import Sequence

import polars as pl
import pyarrow as pa


def frame_of(table: pa.Table, columns: Sequence[str] | None = None) -> pl.DataFrame:
    """Columns of a table (all by default); dictionary columns become strings.

    As categoricals they would only compare and join with values of the same dictionary, which two tables do not share.
    """
    frame = pl.from_arrow(table if columns is None else table.select(list(columns)))
    assert isinstance(frame, pl.DataFrame)
    return frame.with_columns(pl.col(pl.Categorical).cast(pl.String))


def scene_id_of_item(column: str) -> pl.Expr:
    """The scene id that the ids in a column begin with: of scenes, scenes and grasps, or candidates."""
    return pl.col(column).str.extract(r"^((?:mini|full)-\d{4})").alias("scene_id")
