"""Somebody's predictions as they come: a Parquet file with a number a candidate, checked before anything is made of it.

What they are worth is evaluate.py's. Every file that is not what it should be ends in one line that names it and the first wrong id.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Bool, Float

from model.predictions import RELEASE_KEY, SPLIT_KEY
from model.settings import SCHEME_OF_PREDICTIONS
from reports.report import ReportError
from tables.store import read_sidecar, sidecar_path
from tables.vocabulary import Split, SplitScheme

ID = "candidate_id"
SCORE: tuple[str, ...] = ("score",)
LOG_P: tuple[str, ...] = ("log_p_plan", "log_p_exec")
P: tuple[str, ...] = ("p_plan", "p_exec")
_SHORTEST_HASH = 8


@dataclass(frozen=True, slots=True, eq=False)
class Submission:
    """Checked predictions.

    Attributes:
        frame: `candidate_id`, `score`, and `p_plan`, `p_exec` where probabilities were given; sorted by id.
        ordered_by: what `score` is, in the words of a reader.
        splits: the splits that are predicted as a whole; test is among them.
    """

    path: Path
    frame: pl.DataFrame
    ordered_by: str
    splits: frozenset[str]

    @property
    def has_probabilities(self) -> bool:
        """Whether plan and execution have a probability each."""
        return "p_plan" in self.frame.columns


def read_submission(path: Path, candidates: pl.DataFrame, release_hash: str, scheme: SplitScheme) -> Submission:
    """Read and check a file of predictions.

    Args:
        path: Parquet with `candidate_id` and `score`, or `log_p_plan` and `log_p_exec`, or `p_plan` and `p_exec`. With `score` beside
            probabilities the score orders. Other columns do not matter.
        candidates: every candidate of the release, columns `candidate_id` and `split`.
        release_hash: what the predictions must be about, if they say it.
        scheme: what their ranker must have been trained under, if they say it.

    Raises:
        ReportError: names the file, the first candidate that is wrong, how many are, and the bound.
        StoreError: a sidecar that cannot be read.
    """
    schema = _schema(path)
    _check_origin(path, schema, release_hash, scheme)
    kinds = _kinds(path, schema)
    table = _columns(path, schema, kinds)
    ids = table[ID].to_pylist()
    _check_ids(path, ids, set(candidates[ID]))
    splits = _predicted_splits(path, set(ids), candidates)
    values = {name: table[name].to_numpy() for kind in kinds for name in kind}
    for name, column in values.items():
        _check_numbers(path, name, column, ids)
    is_single = all(pa.types.is_float32(schema.field(name).type) for name in LOG_P) if LOG_P in kinds else False
    frame = pl.DataFrame({ID: ids, "score": _score(values, is_single)})
    if LOG_P in kinds:
        frame = frame.with_columns(**{name: pl.Series(np.exp(values[f"log_{name}"])) for name in P})
    elif P in kinds:
        frame = frame.with_columns(**{name: pl.Series(values[name]) for name in P})
    ordered_by = "`score`" if SCORE in kinds else "`log_p_plan + log_p_exec`" if LOG_P in kinds else "`p_plan * p_exec`"
    return Submission(path, frame.sort(ID), ordered_by, splits)


def _schema(path: Path) -> pa.Schema:
    if not path.is_file():
        raise ReportError(f"{path}: no such file")
    try:
        return pq.read_schema(path)
    except (pa.ArrowException, OSError) as error:
        raise ReportError(f"{path}: cannot be read as Parquet: {' '.join(str(error).split())}") from error


def _check_origin(path: Path, schema: pa.Schema, release_hash: str, scheme: SplitScheme) -> None:
    """See that neither the file's metadata nor a sidecar names another release or another split."""
    stated = {key.decode(errors="replace"): value.decode(errors="replace") for key, value in (schema.metadata or {}).items()}
    releases, schemes = [stated.get(RELEASE_KEY)], [stated.get(SPLIT_KEY)]
    if sidecar_path(path).exists():
        made_from = read_sidecar(path).made_from
        releases.append(made_from.get("release"))
        schemes.append(made_from.get(SCHEME_OF_PREDICTIONS))
    for release in releases:
        if release is not None and not (len(release) >= _SHORTEST_HASH and release_hash.startswith(release)):
            raise ReportError(f"{path}: about release {release[:12]}, must be about {release_hash[:12]}")
    for trained in schemes:
        if trained not in (None, scheme.value):
            raise ReportError(f"{path}: of a ranker that was trained under split {trained!r}, must be {scheme.value!r} as --split says")


def _kinds(path: Path, schema: pa.Schema) -> list[tuple[str, ...]]:
    """Which columns say what orders, and how probable success is."""
    names = schema.names
    if ID not in names:
        raise ReportError(f"{path}: no column {ID!r} among {names}")
    repeated = [name for name in (ID, *SCORE, *LOG_P, *P) if names.count(name) > 1]
    if repeated:
        raise ReportError(f"{path}: column {repeated[0]!r} is there {names.count(repeated[0])} times, must be once")
    kinds = [kind for kind in (SCORE, LOG_P, P) if set(kind) <= set(names)]
    for kind in (LOG_P, P):
        half = [name for name in kind if name in names]
        if len(half) == 1:
            (lacking,) = set(kind) - set(half)
            raise ReportError(f"{path}: column {half[0]!r} without {lacking!r}, must have both or neither")
    if not kinds:
        raise ReportError(f"{path}: columns {names}, must have 'score', or 'log_p_plan' and 'log_p_exec', or 'p_plan' and 'p_exec'")
    if LOG_P in kinds and P in kinds:
        raise ReportError(f"{path}: both {list(LOG_P)} and {list(P)}, must have one of them")
    return kinds


def _columns(path: Path, schema: pa.Schema, kinds: list[tuple[str, ...]]) -> pa.Table:
    """The columns that count, ids as strings and numbers as float64."""
    names = [name for kind in kinds for name in kind]
    dtype = schema.field(ID).type
    if not _is_text(dtype.value_type if pa.types.is_dictionary(dtype) else dtype):
        raise ReportError(f"{path}: column {ID!r} is of type {dtype}, must be string")
    for name in names:
        own = schema.field(name).type
        if not (pa.types.is_floating(own) or pa.types.is_integer(own)):
            raise ReportError(f"{path}: column {name!r} is of type {own}, must be a number")
    try:
        read = pq.read_table(path, columns=[ID, *names], partitioning=None)
        table = pa.table({ID: read[ID].cast(pa.string()), **{name: read[name].cast(pa.float64(), safe=False) for name in names}})
    except (pa.ArrowException, OSError) as error:
        raise ReportError(f"{path}: cannot be read as Parquet: {' '.join(str(error).split())}") from error
    if not table.num_rows:
        raise ReportError(f"{path}: 0 rows, must have one a candidate")
    if table[ID].null_count:
        raise ReportError(f"{path}: column {ID!r} has {table[ID].null_count} nulls, must be 0")
    for name in names:
        is_null = table[name].is_null().to_numpy()
        _refuse(path, is_null, table[ID].to_pylist(), f"column {name!r}", "null", "are null, must be 0")
    return table


def _is_text(dtype: pa.DataType) -> bool:
    return bool(pa.types.is_string(dtype) or pa.types.is_large_string(dtype) or pa.types.is_string_view(dtype))


def _check_ids(path: Path, ids: list[str], known: set[str]) -> None:
    repeated = np.zeros(len(ids), dtype=bool)
    seen: set[str] = set()
    for k, name in enumerate(ids):
        repeated[k] = name in seen
        seen.add(name)
    if repeated.any():
        first = min(name for name, again in zip(ids, repeated, strict=True) if again)
        raise ReportError(f"{path}: {first} is there {ids.count(first)} times, must be once ({int(repeated.sum())} rows too many)")
    foreign = sorted(seen - known)
    if foreign:
        raise ReportError(f"{path}: {foreign[0]!r} is no candidate of the release ({len(foreign)} ids are not, must be 0)")


def _predicted_splits(path: Path, ids: set[str], candidates: pl.DataFrame) -> frozenset[str]:
    """The splits that are wholly predicted; test must be, validation may be left out as a whole, train is not looked at."""
    whole = set()
    for split in (Split.TEST.value, Split.VALIDATION.value):
        own = set(candidates.filter(pl.col("split") == split)[ID])
        lacking = sorted(own - ids)
        if lacking and (split == Split.TEST.value or len(lacking) < len(own)):
            raise ReportError(
                f"{path}: {lacking[0]} of the {split} split has no row ({len(lacking):,} of {len(own):,} have none, must be 0)"
            )
        if own and not lacking:
            whole.add(split)
    return frozenset(whole)


def _check_numbers(path: Path, name: str, values: Float[np.ndarray, "n"], ids: list[str]) -> None:
    column = f"column {name!r}"
    _refuse(path, np.isnan(values), ids, column, "NaN", "are NaN, must be 0")
    _refuse(path, np.isinf(values), ids, column, "infinite", "are infinite, must be 0")
    if name in LOG_P:
        _refuse(path, values > 0.0, ids, column, values, "are above 0, the logarithm of probability 1")
    elif name in P:
        _refuse(path, (values < 0.0) | (values > 1.0), ids, column, values, "are outside [0, 1]")


def _refuse(
    path: Path, is_wrong: Bool[np.ndarray, "n"], ids: list[str], column: str, found: str | Float[np.ndarray, "n"], what: str
) -> None:
    """Raise ReportError for the wrong row with the lowest id, if there is one."""
    wrong = np.flatnonzero(is_wrong)
    if len(wrong):
        first = min(wrong, key=lambda k: ids[k])
        value = found if isinstance(found, str) else f"{found[first]:.6g}"
        raise ReportError(f"{path}: {column} is {value} at {ids[first]} ({len(wrong)} values {what})")


def _score(values: Mapping[str, Float[np.ndarray, "n"]], is_single: bool) -> Float[np.ndarray, "n"]:
    """What orders: the score as given, else the probability of success or its logarithm.

    Logarithms of 32 bits are added in 32 bits, as our own are: what is tied to whoever made them is tied here.
    """
    if "score" in values:
        return values["score"]
    if "log_p_plan" not in values:
        return np.asarray(values["p_plan"] * values["p_exec"])
    dtype = np.float32 if is_single else np.float64
    return np.asarray(np.add(values["log_p_plan"], values["log_p_exec"], dtype=dtype, casting="same_kind"), dtype=np.float64)
