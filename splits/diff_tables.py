"""Two versions of one table, row by row: keys that are in one of them only, values that differ, and how; what that means is diff.py's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import polars as pl
import pyarrow as pa

from pipelines.frames import frame_of
from splits.errors import ReleaseError, shown
from tables.schemas import ALL_SCHEMAS

_B = "\x1fb"  # ends the names of B's columns beside A's; no column of a table ends so


@dataclass(frozen=True, slots=True)
class ColumnChange:
    """Values of one column that differ in rows of the same key.

    Attributes:
        rows: how many differ; a null differs from every value.
        largest: of reals, the largest absolute change in `unit`, over rows where both are there, and as long where they are lists; None
            where there are none.
        flips: of a closed set of values or a flag, (from, to, rows) for each change that occurs, the most frequent first.
    """

    name: str
    rows: int
    unit: str = ""
    largest: float | None = None
    flips: tuple[tuple[str, str, int], ...] = ()


@dataclass(frozen=True, slots=True)
class RowDiff:
    """Two tables of one key compared; `first_*` are keys, "" where there is no such row."""

    added: int
    removed: int
    changed: int
    first_added: str = ""
    first_removed: str = ""
    first_changed: str = ""
    columns: tuple[ColumnChange, ...] = ()
    new_columns: tuple[str, ...] = ()
    lost_columns: tuple[str, ...] = ()
    retyped_columns: tuple[str, ...] = ()  # "name: type in A, type in B"; their values are not compared


def compare_tables(name: str, a: pa.Table, b: pa.Table) -> RowDiff:
    """Two versions of a table that this code knows, row by row by its key.

    Raises:
        ReleaseError: a key column that is missing, or a key that repeats.
    """
    key = list(ALL_SCHEMAS[name].key)
    types_a, types_b = ({field.name: field.type for field in table.schema} for table in (a, b))
    shared = [column for column in types_a if column in types_b]
    retyped = [column for column in shared if types_a[column] != types_b[column]]
    compared = [column for column in shared if column not in retyped and column not in key]
    as_text = [pl.col(column).cast(pl.String) for column in key if column in retyped]
    old, new = (_keyed(name, table, key, compared).with_columns(as_text) for table in (a, b))
    if old.select(key).equals(new.select(key)):
        added = removed = old.head(0)
        both = pl.concat([old, new.drop(key).rename(lambda column: column + _B)], how="horizontal")
    else:
        added, removed = new.join(old, on=key, how="anti"), old.join(new, on=key, how="anti")
        both = old.join(new, on=key, suffix=_B)
    differs = [pl.col(column).ne_missing(pl.col(column + _B)) for column in compared]
    changed = both.filter(pl.any_horizontal(differs)) if compared else both.head(0)
    columns = (_column_change(name, changed, column) for column in compared)
    return RowDiff(
        added.height,
        removed.height,
        changed.height,
        _first(added, key),
        _first(removed, key),
        _first(changed, key),
        tuple(column for column in columns if column.rows),
        tuple(column for column in types_b if column not in types_a),
        tuple(column for column in types_a if column not in types_b),
        tuple(f"{column}: {types_a[column]} in A, {types_b[column]} in B" for column in retyped),
    )


def _keyed(name: str, table: pa.Table, key: Sequence[str], columns: Sequence[str]) -> pl.DataFrame:
    missing = [column for column in key if column not in table.column_names]
    if missing:
        raise ReleaseError(f"{name}: key column {shown(missing[0])} is missing, must be one of {table.column_names}")
    frame = frame_of(table, [*key, *columns])
    n_repeated = frame.height - frame.select(key).n_unique()
    if n_repeated:
        raise ReleaseError(f"{name}: {n_repeated} repeated keys {tuple(key)}, must be 0")
    return frame


def _column_change(table: str, changed: pl.DataFrame, column: str) -> ColumnChange:
    own = changed.select(pl.col(column), pl.col(column + _B)).filter(pl.col(column).ne_missing(pl.col(column + _B)))
    # Of another schema a column may be unknown to this code.
    known = next((known for known in ALL_SCHEMAS[table].columns if known.name == column), None)
    dtype, largest = own.schema[column], None
    flips: tuple[tuple[str, str, int], ...] = ()
    if isinstance(dtype, pl.List) and dtype.inner.is_float():
        largest = _largest(own.filter(pl.col(column).list.len() == pl.col(column + _B).list.len()).explode(column, column + _B))
    elif dtype.is_float():
        largest = _largest(own)
    if dtype == pl.Boolean or (known is not None and known.values):
        counts = own.group_by(column, column + _B).len().sort(["len", column, column + _B], descending=[True, False, False])
        flips = tuple((_named(old), _named(new), n) for old, new, n in counts.iter_rows())
    return ColumnChange(column, own.height, known.unit if known else "", largest, flips)


def _largest(pair: pl.DataFrame) -> float | None:
    """The largest distance of the two columns; None where there is none."""
    distance = pair.select((pl.first() - pl.last()).abs()).to_series().max()
    assert distance is None or isinstance(distance, float)
    return distance


def _named(value: object) -> str:
    return "null" if value is None else str(value).lower() if isinstance(value, bool) else str(value)


def _first(frame: pl.DataFrame, key: Sequence[str]) -> str:
    """The key that comes first, "" where there is none."""
    if frame.is_empty():
        return ""
    return ", ".join(map(str, frame.select(key).bottom_k(1, by=key).row(0)))
