"""Tables with a few values changed, for tests that break one rule at a time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pyarrow as pa

from tables.columns import TableSchema
from tables.store import table_from_rows

Row = dict[str, Any]


def changed(schema: TableSchema, table: pa.Table, which: Callable[[Row], bool], **values: Any) -> pa.Table:
    """The table with new values in its first row for which `which` holds."""
    rows = table.to_pylist()
    row = next(row for row in rows if which(row))
    row.update(values)
    return table_from_rows(schema, rows)
