"""What a report is: Markdown, figures and numbers of one name, published together; what it says is decided in the module of each report."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from tables.errors import PlaceBenchError
from tables.store import write_bytes_atomically, write_text_atomically


class ReportError(PlaceBenchError, ValueError):
    """A table that a report cannot be made of; names the table or id, the value and the bound."""


@dataclass(frozen=True, slots=True)
class Report:
    """A finished report.

    `figures` holds PNG bytes by file stem; the Markdown refers to them as `<stem>.png`. `metrics` holds the numbers that others compare.
    """

    name: str
    markdown: str
    figures: Mapping[str, bytes] = field(default_factory=dict)
    metrics: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        strange = sorted(name for name, value in self.metrics.items() if not math.isfinite(value))
        if strange:
            raise ReportError(f"{self.name}: metric {strange[0]} is {self.metrics[strange[0]]}, must be finite")
        unshown = sorted(stem for stem in self.figures if f"({stem}.png)" not in self.markdown)
        if unshown:
            raise ReportError(f"{self.name}: figure {unshown[0]} is not in the Markdown")

    def write(self, directory: Path) -> Path:
        """Write `<name>.json`, the PNGs and, last, `<name>.md`; returns the path of the Markdown."""
        for stem, png in sorted(self.figures.items()):
            write_bytes_atomically(directory / f"{stem}.png", png)
        write_text_atomically(directory / f"{self.name}.json", json.dumps(dict(self.metrics), indent=2, sort_keys=True) + "\n")
        path = directory / f"{self.name}.md"
        write_text_atomically(path, self.markdown)
        return path
