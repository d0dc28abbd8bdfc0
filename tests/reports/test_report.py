from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from reports.report import Report, ReportError


def test_a_report_is_written_whole(tmp_path: Path) -> None:
    rows = [{"policy": "a, b", "n": 3, "s1": 0.1}, {"policy": "c", "n": 4, "s1": None}]
    metrics = {"b": 2.0, "a": 1.0, "a_low": 0.5, "a_high": 1.5}
    report = Report(
        "bench", "# Bench\n\n![bars](bench-bars.png)\n", {"bench-bars": b"png"}, metrics, {"bench-points": rows, "bench-no": []}
    )
    assert report.write(tmp_path / "out") == tmp_path / "out" / "bench.md"
    assert {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()} == {
        "bench.md": report.markdown.encode(),
        "bench-bars.png": b"png",
        "bench.json": b'{\n  "a": 1.0,\n  "a_high": 1.5,\n  "a_low": 0.5,\n  "b": 2.0\n}\n',
        "bench.csv": b"metric,value,low,high\na,1.0,0.5,1.5\nb,2.0,,\n",
        "bench-points.csv": b'policy,n,s1\n"a, b",3,0.1\nc,4,\n',
    }
    assert json.loads((tmp_path / "out" / "bench.json").read_text()) == report.metrics


def test_a_metric_that_is_no_number_is_refused() -> None:
    with pytest.raises(ReportError, match="metric a is nan"):
        Report("bench", "", {}, {"a": math.nan})


def test_a_figure_that_nobody_sees_is_refused() -> None:
    with pytest.raises(ReportError, match="figure lost is not in the Markdown"):
        Report("bench", "text", {"lost": b""}, {})


def test_tables_of_uneven_rows_and_in_the_place_of_metrics_are_refused() -> None:
    with pytest.raises(ReportError, match=r"points: row 1 has columns \['b'\], must have \['a'\]"):
        Report("bench", "", tables={"points": [{"a": 1}, {"b": 1}]})
    with pytest.raises(ReportError, match="has the name of the file of metrics"):
        Report("bench", "", tables={"bench": [{"a": 1}]})
