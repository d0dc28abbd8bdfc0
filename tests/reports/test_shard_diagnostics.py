"""Shares by shard are counts of the tables; a shard that stands out is flagged by the stated rule, and no other."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest

from reports.report import ReportError
from reports.shard_diagnostics import MEASURES, MIN_SHARDS, SHARD_TABLES, Z_LIMIT, robust_z, shard_diagnostics_report, shard_frame
from tables.identity import candidate_id_of
from tables.layout import INTERLEAVED
from tables.schemas import ALL_SCHEMAS

COLUMNS = {
    "scenes": ("scene_id",),
    "targets": ("scene_id", "target_id"),
    "pick_lift": ("scene_id", "lift_status"),
    "candidate_pairs": ("candidate_id", "scene_id", "target_id"),
    "planning_labels": ("candidate_id", "y_plan"),
    "execution_labels": ("candidate_id", "y_pipe"),
}


def tables_of(n_lifted: dict[str, list[int]], n_tried: int = 4, n_targets: int = 2) -> dict[str, pa.Table]:
    """Tables of some shards with so many lifted grasps in each of their first scenes.

    Candidates of target 0 are planned, and the first of each group succeeds.
    """
    rows: dict[str, list[tuple[object, ...]]] = {name: [] for name in SHARD_TABLES}
    for shard, counts in n_lifted.items():
        for scene_id, n in zip(INTERLEAVED.scenes_of_shard(shard), counts, strict=False):
            rows["scenes"].append((scene_id,))
            rows["targets"] += [(scene_id, target) for target in range(n_targets)]
            rows["pick_lift"] += [(scene_id, "lifted" if grasp < n else "slipped") for grasp in range(n_tried)]
            for target in range(n_targets):
                for grasp in range(n):
                    name = candidate_id_of(scene_id, target, grasp)
                    rows["candidate_pairs"].append((name, scene_id, target))
                    rows["planning_labels"].append((name, target == 0))
                    if target == 0:
                        rows["execution_labels"].append((name, grasp == 0))
    return {
        name: pa.table(
            {c: pa.array([row[k] for row in rows[name]], type=_plain(name, c)) for k, c in enumerate(columns)},
        )
        for name, columns in COLUMNS.items()
    }


def _plain(table: str, column: str) -> pa.DataType:
    dtype = ALL_SCHEMAS[table].arrow.field(column).type
    return pa.string() if pa.types.is_dictionary(dtype) else dtype


def test_shares_are_counts_of_the_tables() -> None:
    frame = shard_frame(tables_of({"full-000": [4, 2, 0], "full-001": [1]}), INTERLEAVED)
    first, second = frame.to_dicts()
    assert (first["shard"], first["n_scenes"], second["shard"], second["n_scenes"]) == ("full-000", 3, "full-001", 1)
    assert first["lifted"] == pytest.approx(6 / 12)
    assert first["candidates_per_scene"] == pytest.approx(12 / 3)
    assert first["planned"] == pytest.approx(0.5)
    assert first["succeeded"] == pytest.approx(2 / 6)
    assert first["coverage"] == pytest.approx(2 / 6), "six groups, a scene without candidates among them"
    assert second["coverage"] == pytest.approx(1 / 2)


def test_a_shard_without_candidates_has_no_shares_and_no_coverage() -> None:
    tables = tables_of({"full-000": [2], "full-001": [0]})
    empty = shard_frame(tables, INTERLEAVED).to_dicts()[1]
    assert (empty["planned"], empty["succeeded"], empty["candidates_per_scene"], empty["coverage"]) == (None, None, 0.0, 0.0)
    assert "– (+0.0)" in shard_diagnostics_report(tables, tier="pilot", layout=INTERLEAVED).markdown


def test_the_robust_z_is_the_formula_of_the_rule() -> None:
    values = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 100.0]
    median = 5.0
    mad = float(np.median(np.abs(np.array(values) - median)))
    assert robust_z(values) == pytest.approx(0.6745 * (np.array(values) - median) / mad)
    assert (np.abs(robust_z(values)) > Z_LIMIT).tolist() == [False] * 8 + [True]


def test_one_shard_among_equals_is_found_although_its_mad_is_zero() -> None:
    z = robust_z([0.5] * 19 + [0.1])
    assert z[-1] == pytest.approx(-0.4 / (1.2533 * 0.02))
    assert np.count_nonzero(np.abs(z) > Z_LIMIT) == 1


def test_equal_values_unknown_values_and_few_values_have_no_z() -> None:
    assert robust_z([0.5] * MIN_SHARDS).tolist() == [0.0] * MIN_SHARDS
    assert robust_z([0.1, 100.0, 0.1, 0.1]).tolist() == [0.0] * 4
    unknown = robust_z([None, *(float(k) for k in range(MIN_SHARDS)), 100.0])
    assert unknown[0] == 0.0
    assert unknown[-1] > Z_LIMIT
    assert robust_z([None] * 20).tolist() == [0.0] * 20


def test_a_shard_that_stands_out_is_flagged_and_counted() -> None:
    yields = {f"full-{k:03d}": [2 + (k + j) % 2 for j in range(6)] for k in range(12)}
    sound = shard_diagnostics_report(tables_of(yields), tier="full", layout=INTERLEAVED)
    assert sound.metrics["n_flagged"] == 0
    assert "None of 12." in sound.markdown
    assert "**" not in sound.markdown.split("## Every shard")[1]
    odd = shard_diagnostics_report(tables_of(yields | {"full-007": [0] * 6}), tier="full", layout=INTERLEAVED)
    assert odd.metrics["n_flagged"] == 1
    assert odd.metrics["n_shards"] == 12
    flagged = odd.markdown.split("## Shards that stand out")[1].split("## Every shard")[0]
    assert flagged.count("`full-007`") == flagged.count("`full-") == 3, "lifted, candidates a scene, coverage"
    (line,) = [line for line in odd.markdown.splitlines() if line.startswith("| `full-007` | 6 |")]
    assert line.count("**") == 2 * 3


def test_the_rule_and_the_numbers_are_stated() -> None:
    report = shard_diagnostics_report(tables_of({f"full-{k:03d}": [1, 3] for k in range(4)}), tier="pilot", layout=INTERLEAVED)
    assert "0.6745" in report.markdown
    assert f"|z| > {Z_LIMIT}" in report.markdown
    assert "Too few to say: 4, at least 8 are needed." in report.markdown
    for name in MEASURES:
        assert report.metrics[f"{name}.min"] == report.metrics[f"{name}.median"] == report.metrics[f"{name}.max"]
    assert report.metrics["candidates_per_scene.median"] == 4.0


def test_rows_in_any_order_give_the_same_report() -> None:
    tables = tables_of({f"full-{k:03d}": [k % 4, 1, 3] for k in range(9)})
    backwards = {name: table.take(list(range(table.num_rows))[::-1]) for name, table in tables.items()}
    assert shard_diagnostics_report(backwards, tier="full", layout=INTERLEAVED) == shard_diagnostics_report(
        tables, tier="full", layout=INTERLEAVED
    )


def test_missing_tables_and_scenes_are_refused() -> None:
    tables = tables_of({"full-000": [1]})
    with pytest.raises(ReportError, match="pick_lift: missing"):
        shard_frame({name: table for name, table in tables.items() if name != "pick_lift"}, INTERLEAVED)
    with pytest.raises(ReportError, match="scenes: 0 rows, must be at least 1"):
        shard_frame(tables | {"scenes": tables["scenes"].slice(0, 0)}, INTERLEAVED)
