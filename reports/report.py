"""What a report is: Markdown, figures and numbers of one name, published together; what it says is decided in the module of each report."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from tables.errors import PlaceBenchError
from tables.store import write_bytes_atomically


class ReportError(PlaceBenchError, ValueError):
    """A table that a report cannot be made of; names the table or id, the value and the bound."""


@dataclass(frozen=True, slots=True)
class Report:
    """A finished report.

    Attributes:
        figures: PNG bytes by file stem; the Markdown refers to them as `<stem>.png`.
        metrics: the numbers that others compare, by name; an interval of `x` is in `x_low` and `x_high`.
        tables: rows by file stem, of what is plotted or counted and is no single number; rows of a table have the same columns.
    """

    name: str
    markdown: str
    figures: Mapping[str, bytes] = field(default_factory=dict)
    metrics: Mapping[str, float] = field(default_factory=dict)
    tables: Mapping[str, Sequence[Mapping[str, object]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        strange = sorted(name for name, value in self.metrics.items() if not math.isfinite(value))
        if strange:
            raise ReportError(f"{self.name}: metric {strange[0]} is {self.metrics[strange[0]]}, must be finite")
        unshown = sorted(stem for stem in self.figures if f"({stem}.png)" not in self.markdown)
        if unshown:
            raise ReportError(f"{self.name}: figure {unshown[0]} is not in the Markdown")
        if self.name in self.tables:
            raise ReportError(f"{self.name}: table {self.name} has the name of the file of metrics, must have another")
        for stem, rows in self.tables.items():
            uneven = [k for k, row in enumerate(rows) if list(row) != list(rows[0])]
            if uneven:
                raise ReportError(f"{stem}: row {uneven[0]} has columns {list(rows[uneven[0]])}, must have {list(rows[0])}")

    def files(self) -> dict[str, bytes]:
        """What is written, by file name: PNGs, `<name>.json` and `.csv` of the metrics, a CSV a table and, last, `<name>.md`."""
        files = {f"{stem}.png": png for stem, png in sorted(self.figures.items())}
        files |= {f"{stem}.csv": csv_of(rows) for stem, rows in sorted(self.tables.items()) if rows}
        if self.metrics:
            files[f"{self.name}.csv"] = csv_of(with_intervals(self.metrics))
        files[f"{self.name}.json"] = (json.dumps(dict(self.metrics), indent=2, sort_keys=True) + "\n").encode()
        return files | {f"{self.name}.md": self.markdown.encode()}

    def write(self, directory: Path) -> Path:
        """Write the files; returns the path of the Markdown."""
        for name, content in self.files().items():
            write_bytes_atomically(directory / name, content)
        return directory / f"{self.name}.md"


def with_intervals(metrics: Mapping[str, float]) -> list[dict[str, object]]:
    """A row a number, its interval in columns of its own: `metric`, `value`, `low`, `high`."""
    ends = {f"{name}{end}" for name in metrics for end in ("_low", "_high")}
    return [
        {"metric": name, "value": metrics[name], "low": metrics.get(f"{name}_low"), "high": metrics.get(f"{name}_high")}
        for name in sorted(metrics.keys() - ends)
    ]


def csv_of(rows: Sequence[Mapping[str, object]]) -> bytes:
    """Rows as CSV with a header; None is an empty cell, numbers have all their digits."""
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return buffer.getvalue().encode()
