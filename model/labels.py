"""The two labels of candidates, for supervision and validation only; nothing read here reaches the network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Bool

from model.inputs import InputError


@dataclass(frozen=True, slots=True)
class Labels:
    """`y_pipe` is False where `y_plan` is False and means nothing there."""

    y_plan: Bool[np.ndarray, "c"]
    y_pipe: Bool[np.ndarray, "c"]

    @property
    def success(self) -> Bool[np.ndarray, "c"]:
        return self.y_plan & self.y_pipe


def read_labels(release_dir: Path, candidate_ids: Sequence[str]) -> Labels:
    """Labels of the named candidates, in their order.

    Raises:
        InputError: the table or a candidate is missing, or a planned candidate has no execution label.
    """
    path = release_dir / "candidates.parquet"
    if not path.exists():
        raise InputError(f"{path}: missing")
    rows = pq.read_table(path, columns=["candidate_id", "y_plan", "y_pipe"])
    row_of = {candidate_id: k for k, candidate_id in enumerate(rows["candidate_id"].cast(pa.string()).to_pylist())}
    missing = [candidate_id for candidate_id in candidate_ids if candidate_id not in row_of]
    if missing:
        raise InputError(f"{path}: no row {missing[0]}")
    mine = np.array([row_of[candidate_id] for candidate_id in candidate_ids], dtype=np.int64)
    y_plan = rows["y_plan"].to_numpy(zero_copy_only=False).astype(bool)[mine]
    y_pipe = np.array(rows["y_pipe"].to_pylist(), dtype=object)[mine]
    for candidate_id, planned, value in zip(candidate_ids, y_plan, y_pipe, strict=True):
        if planned and value is None:
            raise InputError(f"{path}: {candidate_id} has y_plan true and y_pipe null, must have both labels")
    return Labels(y_plan, np.array([value is True for value in y_pipe], dtype=bool))
