"""Table `predictions`: what a ranker says of candidates, in as many bits as tell them apart, and of which release and split."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
from jaxtyping import Float, Float32

from model.settings import SCHEME_OF_PREDICTIONS
from tables.schemas import PREDICTIONS
from tables.store import table_from_columns, write_table
from tables.vocabulary import SplitScheme

# Under these names the metadata of the file say what it is about: candidates are called alike in every version of a release, and a file
# is easily copied without its sidecar.
RELEASE_KEY, SPLIT_KEY = "placebench.release", "placebench.split"

# Of the 23 bits of a mantissa. The others are noise of training, which no file can compress: a table takes 29 % less without them, and of
# 56,754 groups ordered by rankers of `full` none has another first choice (with 13 bits eleven have).
MANTISSA_BITS = 15


def rounded(log_p: Float[np.ndarray, "c"]) -> Float32[np.ndarray, "c"]:
    """The nearest numbers with a mantissa of 15 bits, at most 2^-16 of themselves away; singles, exactly."""
    mantissa, exponent = np.frexp(np.asarray(log_p, dtype=np.float64))
    steps = 2.0 ** (MANTISSA_BITS + 1)  # frexp gives mantissas of [0.5, 1)
    return np.ldexp(np.rint(mantissa * steps) / steps, exponent).astype(np.float32)


def prediction_table(
    variant: str, seed: int, candidate_ids: Sequence[str], log_p_plan: Float[np.ndarray, "c"], log_p_exec: Float[np.ndarray, "c"]
) -> pa.Table:
    """Table `predictions` of one training.

    Args:
        log_p_plan: log P(plan) of each candidate, finite.
        log_p_exec: log P(success | plan).
    """
    n = len(candidate_ids)
    return table_from_columns(
        PREDICTIONS,
        {
            "variant": [variant] * n,
            "seed": np.full(n, seed, dtype=np.int32),
            "candidate_id": list(candidate_ids),
            "log_p_plan": rounded(log_p_plan),
            "log_p_exec": rounded(log_p_exec),
        },
    )


def write_predictions(table: pa.Table, path: Path, scheme: SplitScheme, release_hash: str | None) -> None:
    """Publish predictions that say, in their sidecar and in the file itself, what they are about.

    Args:
        scheme: what their ranker was trained under.
        release_hash: of the release that was scored; None where it has none, and then nothing is said of it.
    """
    made_from, stated = {SCHEME_OF_PREDICTIONS: scheme.value}, {SPLIT_KEY: scheme.value}
    if release_hash is not None:
        made_from["release"] = stated[RELEASE_KEY] = release_hash
    write_table(PREDICTIONS, table, path, made_from, stated=stated)
