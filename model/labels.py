"""The two labels of candidates, for supervision and validation only; nothing read here reaches the network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool

from model.errors import InputError
from model.release_tables import read_table_columns, row_error


@dataclass(frozen=True, slots=True)
class Labels:
    """`y_pipe` is False where `y_plan` is False and means nothing there."""

    y_plan: Bool[np.ndarray, "c"]
    y_pipe: Bool[np.ndarray, "c"]

    @property
    def success(self) -> Bool[np.ndarray, "c"]:
        success: Bool[np.ndarray, "c"] = self.y_plan & self.y_pipe
        return success


def read_labels(release_dir: Path, candidate_ids: Sequence[str]) -> Labels:
    """Labels of the named candidates, in their order.

    Raises:
        InputError: the table or a candidate is missing, or a planned candidate has no execution label.
    """
    path = release_dir / "candidates.parquet"
    rows = read_table_columns(release_dir, "candidates", ("candidate_id", "y_plan", "y_pipe"))
    row_of = {candidate_id: k for k, candidate_id in enumerate(rows["candidate_id"].to_pylist())}
    missing = [candidate_id for candidate_id in candidate_ids if candidate_id not in row_of]
    if missing:
        raise InputError(f"{path}: no row {missing[0]}")
    mine = np.array([row_of[candidate_id] for candidate_id in candidate_ids], dtype=np.int64)
    y_plan = rows["y_plan"].to_numpy(zero_copy_only=False).astype(bool)[mine]
    y_pipe = np.array(rows["y_pipe"].to_pylist(), dtype=object)[mine]
    for row, planned, value in zip(mine, y_plan, y_pipe, strict=True):
        if planned and value is None:
            raise row_error(path, rows, int(row), "y_plan is true and y_pipe null, must have both labels")
    return Labels(y_plan, np.array([value is True for value in y_pipe], dtype=bool))
