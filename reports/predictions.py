"""Predictions of rankers as reports read them: of the split asked for, and with a score; what orders by it is in policies.py."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import polars as pl
import pyarrow as pa

from model.settings import SCHEME_OF_PREDICTIONS
from pipelines.frames import frame_of
from reports.report import ReportError
from tables.schemas import PREDICTIONS
from tables.store import join_tables, read_sidecar, read_table
from tables.vocabulary import SplitScheme


def read_predictions(paths: Sequence[Path], scheme: SplitScheme) -> pa.Table | None:
    """Predictions of one or several files as one table; None without files.

    Raises:
        ReportError: predictions of rankers that were trained under another scheme.
        StoreError: a file that is missing, changed or no table of predictions.
    """
    for path in paths:
        check_scheme(path, read_sidecar(path).made_from, scheme)
    return join_tables(PREDICTIONS, [read_table(PREDICTIONS, path, verify=True) for path in paths]) if paths else None


def check_scheme(path: Path, made_from: Mapping[str, str], scheme: SplitScheme) -> None:
    """Refuse predictions of rankers that were trained under another split than the one asked for: perhaps on its test scenes.

    Args:
        path: of the predictions.
        made_from: what their sidecar says of their making; where it does not name a split, the paper's is meant.
        scheme: the split asked for.

    Raises:
        ReportError: names the file, its split and the one asked for.
    """
    trained = made_from.get(SCHEME_OF_PREDICTIONS, SplitScheme.SCENE.value)
    if trained != scheme.value:
        raise ReportError(f"{path}: of rankers that were trained under split {trained!r}, must be {scheme.value!r}, the split asked for")


def with_score(predictions: pl.DataFrame) -> pl.DataFrame:
    """Predictions with `score`, the log probability of success; all three as 64-bit numbers, so that nothing after is rounded again.

    The sum is one of 32-bit numbers, as the ranker's own and that of whoever adds the stored columns: what is tied there is tied here.
    """
    parts = [pl.col(name).cast(pl.Float32) for name in ("log_p_plan", "log_p_exec")]
    return predictions.with_columns((parts[0] + parts[1]).alias("score")).with_columns(pl.col(pl.Float32).cast(pl.Float64))


def seeds_of_variants(predictions: pa.Table) -> dict[str, list[int]]:
    """Training seeds by variant, both sorted."""
    seeds: dict[str, list[int]] = {}
    for variant, seed in frame_of(predictions, ["variant", "seed"]).unique().sort("variant", "seed").iter_rows():
        seeds.setdefault(variant, []).append(seed)
    return seeds
