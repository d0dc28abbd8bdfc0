"""What a user sees of a published table or figure in the Dagster UI."""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import polars as pl
import pyarrow as pa
from dagster import MetadataValue, TableColumn, TableColumnConstraints, TableSchema

from tables.columns import Column
from tables.columns import TableSchema as Schema
from tables.store import Sidecar, read_table

PREVIEW_ROWS = 6
PREVIEW_COLUMNS = 8


def table_metadata(schema: Schema, path: Path, sidecar: Sidecar) -> dict[str, Any]:
    """Rows, hash, columns with units and meaning, counts and rates of each status, and the first rows as Markdown."""
    frame = pl.from_arrow(read_table(schema, path))
    assert isinstance(frame, pl.DataFrame)
    counts = {c.name: status_counts(frame, c.name) for c in schema.columns if c.name.endswith("_status")}
    return {
        "dagster/row_count": sidecar.rows,
        "dagster/column_schema": TableSchema([_shown_column(column) for column in schema.columns]),
        "path": MetadataValue.path(str(path)),
        "content_hash": sidecar.content_hash,
        "bytes": path.stat().st_size,
        "preview": MetadataValue.md(markdown_table(frame.head(PREVIEW_ROWS)[:, :PREVIEW_COLUMNS])),
        **{name: MetadataValue.md(_counts_as_markdown(count)) for name, count in counts.items()},
        **outcome_numbers(schema, frame),
    }


def outcome_numbers(schema: Schema, frame: pl.DataFrame) -> dict[str, int | float]:
    """Numbers that the UI plots over partitions: `n_<status>` and `rate_<status>` of every status, `rate_<flag>` of every flag.

    A rate is a share of the rows that are not null, and left out where there are none. A status that two columns of a table may hold
    goes by its column's name too: `n_stored_solved` and `n_audited_solved`.
    """
    enums = [column for column in schema.columns if column.name.endswith("_status")]
    n_columns = Counter(value for column in enums for value in column.values)
    numbers: dict[str, int | float] = {}
    for column in enums:
        counts = dict(frame[column.name].drop_nulls().cast(pl.String).value_counts().iter_rows())
        total = sum(counts.values())
        for value in column.values:
            name = value if n_columns[value] == 1 else f"{column.name.removesuffix('_status')}_{value}"
            numbers[f"n_{name}"] = counts.get(value, 0)
            if total:
                numbers[f"rate_{name}"] = counts.get(value, 0) / total
    for column in schema.columns:
        if column.dtype == pa.bool_() and frame[column.name].drop_nulls().len():
            numbers[f"rate_{column.name}"] = float(frame[column.name].drop_nulls().mean())  # type: ignore[arg-type]
    return numbers


def type_in_words(column: Column) -> str:
    """The type of a column as people say it; the Arrow type stands in the data card."""
    if column.values:
        return "category"
    dtype = column.dtype
    is_list = pa.types.is_list(dtype)
    value = dtype.value_type if is_list or pa.types.is_dictionary(dtype) else dtype
    tests = {"text": pa.types.is_string, "yes or no": pa.types.is_boolean, "integer": pa.types.is_integer, "number": pa.types.is_floating}
    word = next(word for word, is_so in tests.items() if is_so(value))
    return f"list of {word}s" if is_list else word


def status_counts(frame: pl.DataFrame, column: str) -> dict[str, int]:
    """How often each value occurs, most frequent first; null is counted as `not run`."""
    values = frame.select(pl.col(column).cast(pl.String).fill_null("not run"))
    return dict(values[column].value_counts(sort=True).iter_rows())


def markdown_table(frame: pl.DataFrame) -> str:
    """A small frame as a Markdown table."""
    head = ["| " + " | ".join(frame.columns) + " |", "|" + " --- |" * frame.width]
    return "\n".join([*head, *("| " + " | ".join(_cell(value) for value in row) + " |" for row in frame.iter_rows())])


def inline_figure(png: bytes) -> Any:
    """A PNG shown in the UI itself."""
    return MetadataValue.md(f"![figure](data:image/png;base64,{base64.b64encode(png).decode()})")


def _shown_column(column: Column) -> TableColumn:
    meaning = f"{column.meaning}{f' [{column.unit}]' if column.unit else ''}"
    may_be = [f"one of {', '.join(column.values)}"] if column.values else []
    return TableColumn(column.name, type_in_words(column), meaning, TableColumnConstraints(nullable=column.nullable, other=may_be))


def _counts_as_markdown(counts: Mapping[str, int]) -> str:
    total = max(1, sum(counts.values()))
    rows = [f"| {name} | {n} | {100 * n / total:.1f} % |" for name, n in counts.items()]
    return "\n".join(["| status | rows | share |", "| --- | --- | --- |", *rows])


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    text = str(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
