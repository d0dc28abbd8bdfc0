from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from reports.report import Report, ReportError


def test_a_report_is_written_whole(tmp_path: Path) -> None:
    report = Report("bench", "# Bench\n\n![bars](bench-bars.png)\n", {"bench-bars": b"png"}, {"b": 2.0, "a": 1.0})
    assert report.write(tmp_path / "out") == tmp_path / "out" / "bench.md"
    assert {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()} == {
        "bench.md": report.markdown.encode(),
        "bench-bars.png": b"png",
        "bench.json": b'{\n  "a": 1.0,\n  "b": 2.0\n}\n',
    }
    assert json.loads((tmp_path / "out" / "bench.json").read_text()) == report.metrics


def test_a_metric_that_is_no_number_is_refused() -> None:
    with pytest.raises(ReportError, match="metric a is nan"):
        Report("bench", "", {}, {"a": math.nan})


def test_a_figure_that_nobody_sees_is_refused() -> None:
    with pytest.raises(ReportError, match="figure lost is not in the Markdown"):
        Report("bench", "text", {"lost": b""}, {})
