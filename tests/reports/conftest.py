"""One synthetic release, as tables, with predictions of four variants, for the tests of reports."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from reports.ablation import VARIANTS
from tables import schemas
from tables.identity import rng_for
from tables.store import read_table, table_from_columns
from tests.model.synthetic_release import RELEASE_SCHEMAS, write_synthetic_release

_NOISE = {"direct": 2.0, "no_object_relative": 4.0, "no_target_hypothesis": 1.6, "full": 1.5}
_STAGE = {"planning": "planning_labels", "execution": "execution_labels"}


@pytest.fixture(scope="session")
def release_tables(tmp_path_factory: pytest.TempPathFactory) -> dict[str, pa.Table]:
    """Sixty scenes of `full`, twelve of them test and twelve validation, with about 4,000 candidates; do not change in place."""
    directory = write_synthetic_release(tmp_path_factory.mktemp("synthetic"), n_scenes=60, seed=1, n_points=8)
    tables = {schema.name: read_table(schema, Path(directory) / f"{schema.name}.parquet") for schema in RELEASE_SCHEMAS}
    timings = tables["timings"]
    stages = [_STAGE.get(stage, stage) for stage in timings["stage"].to_pylist()]
    tables["timings"] = table_from_columns(schemas.TIMINGS, {"stage": stages, "item_id": timings["item_id"], "core_ms": timings["core_ms"]})
    return tables


@pytest.fixture(scope="session")
def predictions(release_tables: dict[str, pa.Table]) -> pa.Table:
    """Labels with noise, two seeds a variant: the more noise, the worse the variant."""
    candidates = release_tables["candidates"]
    y_plan = np.array(candidates["y_plan"].to_pylist())
    y_pipe = np.array([bool(value) for value in candidates["y_pipe"].to_pylist()])
    columns: dict[str, list[object]] = {name: [] for name in schemas.PREDICTIONS.names}
    for variant in VARIANTS:
        for seed in (42, 43):
            rng = rng_for(seed, "synthetic-predictions", variant)
            log_p = [-np.logaddexp(0.0, -(4.0 * y - 2.0 + rng.normal(0.0, _NOISE[variant], len(y)))) for y in (y_plan, y_pipe)]
            columns["variant"] += [variant] * len(y_plan)
            columns["seed"] += [seed] * len(y_plan)
            columns["candidate_id"] += candidates["candidate_id"].to_pylist()
            columns["log_p_plan"] += log_p[0].tolist()
            columns["log_p_exec"] += log_p[1].tolist()
    return table_from_columns(schemas.PREDICTIONS, columns)


def scores_of(predictions: pa.Table, variant: str, seed: int) -> dict[str, float]:
    """Scores of one ranker by candidate, added without polars."""
    rows = [row for row in predictions.to_pylist() if (row["variant"], row["seed"]) == (variant, seed)]
    return {row["candidate_id"]: float(np.float32(row["log_p_plan"]) + np.float32(row["log_p_exec"])) for row in rows}
