"""The card says how often labels flip, counted here by hand; without attempts it says where to look."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import polars as pl
import pyarrow as pa
import pytest

from pipelines.frames import frame_of
from splits.confidence import NEAR_MARGIN, SLIPPING_M, confidence_section
from splits.errors import ReleaseError
from splits.manifest import files_of_table, read_manifest
from splits.release import verify_release, write_release
from tables.identity import rng_for
from tables.schemas import ATTEMPTS, CANDIDATES
from tables.store import table_from_rows
from tables.vocabulary import Perturbation
from tests.model.synthetic_release import TOLERANCES
from tests.splits.damage import PROVENANCE

Row = dict[str, Any]


@pytest.fixture(scope="module")
def candidates(release_tables: dict[str, pa.Table]) -> pa.Table:
    """Those of the release, with slips of every size."""
    rows, rng = release_tables["candidates"].to_pylist(), rng_for(1, "made-up-slips")
    return table_from_rows(CANDIDATES, [row | {"transport_slip_m": 10.0 ** rng.uniform(-5, -1) if row["y_plan"] else None} for row in rows])


@pytest.fixture(scope="module")
def executed(candidates: pa.Table) -> list[Row]:
    return [row for row in candidates.to_pylist() if row["y_plan"]]


@pytest.fixture(scope="module")
def attempts(executed: list[Row]) -> pa.Table:
    """Half of the executed candidates under every perturbation and in a fresh process; a third of the outcomes are turned round."""
    rng, rows = rng_for(1, "made-up-attempts"), []
    for stored in executed[::2]:
        for kind in Perturbation:
            flips = bool(rng.random() < 1 / 3)
            status = ("success" if not stored["y_pipe"] else "off_target") if flips else stored["exec_status"]
            rows.append(
                {"candidate_id": stored["candidate_id"], "perturbation": kind.value, "repeat": 0, "plan_status": "solved"}
                | {"exec_status": status, "final_position_error_m": 0.0, "final_rotation_error_rad": 0.0}
                | {"plan_matches": True, "exec_matches": not flips, "is_identical": not flips}
            )
    return table_from_rows(ATTEMPTS, rows)


def _cells(section: str, label: str) -> list[str]:
    (line,) = [line for line in section.splitlines() if line.startswith(f"| {label} |")]
    return [cell.strip() for cell in line.strip("|").split("|")]


@pytest.mark.parametrize(
    ("label", "column", "low", "high"),
    [
        *(("0 to 0.05", "tolerance_margin", 0.0, 0.05), ("0.25 to 0.5", "tolerance_margin", 0.25, 0.5)),
        *(("from 1", "tolerance_margin", 1.0, 1e9), ("0 to 0.1 mm", "transport_slip_m", 0.0, 1e-4)),
        *(("1 to 5 mm", "transport_slip_m", 1e-3, 5e-3), ("from 20 mm", "transport_slip_m", 0.02, 1e9)),
    ],
)
def test_flips_are_those_counted_by_hand(
    candidates: pa.Table, executed: list[Row], attempts: pa.Table, label: str, column: str, low: float, high: float
) -> None:
    section = confidence_section(frame_of(candidates), frame_of(attempts))
    own = {row["candidate_id"]: row for row in executed if low <= abs(row[column]) < high}
    _, n, success, n_attempts, steps, friction, lever, flips = _cells(section, label)
    assert n.partition(" ")[0] == f"{len(own)}"
    assert success == (f"{100 * sum(row['y_pipe'] for row in own.values()) / len(own):.1f} %" if own else "–")
    tried = [row for row in attempts.to_pylist() if row["candidate_id"] in own and row["perturbation"] != "fresh_process"]
    assert n_attempts == f"{len(tried):,}"
    flipped = [row["perturbation"] for row in tried if (row["exec_status"] == "success") != own[row["candidate_id"]]["y_pipe"]]
    for cell, words in ((steps, ("half", "hold")), (friction, ("friction",)), (lever, ("pad",)), (flips, ("",))):
        of_kind = [row for row in tried if row["perturbation"].startswith(words)]
        n_flipped = sum(kind.startswith(words) for kind in flipped)
        assert cell == (f"{n_flipped}/{len(of_kind)} ({100 * n_flipped / len(of_kind):.1f} %)" if of_kind else "–")


def test_every_executed_candidate_is_in_one_bin_of_each_table(candidates: pa.Table, executed: list[Row]) -> None:
    section = confidence_section(frame_of(candidates), None)
    blocks = [block for block in section.split("\n\n") if block.startswith("|")]
    assert len(blocks) == 2
    for block in blocks:
        counts = [int(line.split("|")[2].split("(")[0].replace(",", "")) for line in block.splitlines()[2:]]
        assert sum(counts) == len(executed)
    assert "This release holds no `attempts`" in section
    assert "repeatability report" in section
    assert "flip," not in section.split("```")[-1]


def test_the_line_of_polars_keeps_what_the_card_says(candidates: pa.Table, executed: list[Row], attempts: pa.Table) -> None:
    frame = frame_of(candidates)
    section = confidence_section(frame, frame_of(attempts))
    (code,) = re.findall(r"```python\n(.*?)```", section, re.DOTALL)
    names: dict[str, Any] = {"pl": pl, "candidates": frame}
    exec(code, names)
    sure = [row for row in executed if abs(row["tolerance_margin"]) >= NEAR_MARGIN and row["transport_slip_m"] < SLIPPING_M]
    n_without = frame.height - len(executed)
    assert names["confident"].height == n_without + len(sure) > n_without
    for name, is_success in (("successes", True), ("failures", False)):
        n_sure, n_all = (sum(row["y_pipe"] is is_success for row in rows) for rows in (sure, executed))
        assert f"{100 * n_sure / n_all:.1f} % of {name}" in section


def test_attempts_are_part_of_a_release_and_of_its_card_but_not_of_its_hash(
    release: Path, release_tables: dict[str, pa.Table], attempts: pa.Table, tmp_path: Path
) -> None:
    manifest = write_release(release_tables | {"attempts": attempts}, tmp_path, "pilot", "0.1.0", PROVENANCE, TOLERANCES)
    assert verify_release(tmp_path) == manifest
    assert manifest.release_hash == read_manifest(release).release_hash
    assert "attempts" in manifest.tables
    card = (tmp_path / "README.md").read_text()
    assert confidence_section(frame_of(release_tables["candidates"]), frame_of(attempts)) in card
    assert "This release holds no `attempts`" in (release / "README.md").read_text()
    rows = attempts.to_pylist()
    rows[0]["candidate_id"] = "full-0999-t0-g00"
    with pytest.raises(ReleaseError, match="attempts: full-0999-t0-g00 is no candidate"):
        write_release(release_tables | {"attempts": table_from_rows(ATTEMPTS, rows)}, tmp_path, "pilot", "0.1.0", PROVENANCE, TOLERANCES)


def test_the_card_states_sizes(release: Path) -> None:
    card = (release / "README.md").read_text()
    for name in ("candidates", "scene_points", "timings"):
        n_bytes = sum((release / file).stat().st_size for file in files_of_table(name))
        assert re.search(rf"^\| `{name}` \| .* \| {n_bytes / 1e3:,.1f} \|$", card, re.MULTILINE)
    assert "| `python -m splits.rebuild DIR points` |" in card
    assert re.search(r"^\| `timings` \| [\d.,]+ \| nothing \|$", card, re.MULTILINE)
