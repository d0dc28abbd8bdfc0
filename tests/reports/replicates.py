"""Made-up replicates of a synthetic release: each candidate succeeds with a probability of its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import pyarrow as pa

from pipelines.proofs.replicates import uncertainty_of
from tables import schemas
from tables.identity import rng_for
from tables.store import table_from_rows

Row = dict[str, object]


def replicates_of(
    tables: Mapping[str, pa.Table], probability: Callable[[Row], float] = lambda row: 0.9 if row["y_pipe"] else 0.1, n: int = 5
) -> pa.Table:
    """Table `test_replicates` of the planned candidates of the test split.

    Args:
        probability: of success, from a candidate's row.
    """
    in_test = {row["scene_id"] for row in tables["splits"].to_pylist() if row["split"] == "test"}
    rows = []
    for candidate in tables["candidates"].to_pylist():
        if candidate["scene_id"] in in_test and candidate["y_plan"]:
            name = candidate["candidate_id"]
            draws = rng_for(3, "made-up-replicates", name).random(n) < probability(candidate)
            for replicate, is_success in enumerate(draws.tolist()):
                status = "success" if is_success else "off_target"
                label = {"exec_status": status, "is_success": is_success, "tolerance_margin": 0.1 if is_success else -0.1}
                rows.append({"candidate_id": name, "replicate": replicate, **uncertainty_of(3, name, replicate).row(), **label})
    return table_from_rows(schemas.TEST_REPLICATES, rows)
