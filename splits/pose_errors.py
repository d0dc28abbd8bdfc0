"""Rows whose pose is no pose because its quaternion does not have length 1; whether a pose makes sense is not looked at here."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pyarrow as pa

from pipelines.frames import frame_of
from tables.poses import pose_columns
from tables.schemas import ALL_SCHEMAS

# The sum of four squares of doubles, rounded; a shorter or longer one was edited.
_ROUNDING = 1e-9


def find_pose_errors(tables: Mapping[str, pa.Table]) -> list[str]:
    """One sentence for every pose of a table that is not a unit quaternion somewhere: how often, and the first row by key.

    Args:
        tables: any tables of the benchmark, by name.
    """
    errors = []
    for name, table in sorted(tables.items()):
        schema = ALL_SCHEMAS[name]
        for prefix in [column.removesuffix("_qw") for column in schema.names if column.endswith("_qw")]:
            frame = frame_of(table, [*schema.key, *pose_columns(prefix)[3:]])
            frame = frame.drop_nulls(list(pose_columns(prefix)[3:])).sort(*schema.key)
            with np.errstate(over="ignore"):  # infinite is as wrong as 2
                lengths = np.linalg.norm(frame.select(pose_columns(prefix)[3:]).to_numpy(), axis=1)
            wrong = np.flatnonzero(np.abs(lengths - 1.0) > _ROUNDING)
            if len(wrong):
                row = frame.row(int(wrong[0]), named=True)
                where = ", ".join(f"{key} {row[key]}" for key in schema.key)
                length = f"{lengths[wrong[0]]:.6g}"
                errors.append(f"{name}: {prefix} of {where} has a quaternion of length {length}, must be 1 ({len(wrong)} rows are wrong)")
    return errors
