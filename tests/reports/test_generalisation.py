"""What a ranker loses on what it was not trained on is counted on the scenes of both test splits, group by group."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pyarrow as pa
import pytest

from reports.generalisation import generalisation_report
from reports.report import ReportError
from tables import schemas
from tables.identity import order_key
from tables.store import table_from_rows
from tables.vocabulary import SplitScheme
from tests.reports.conftest import scores_of

Tables = dict[str, pa.Table]
SCENE, OBJECT, LAYOUT = SplitScheme.SCENE, SplitScheme.OBJECT, SplitScheme.LAYOUT


def as_local(predictions: pa.Table, variant: str) -> pa.Table:
    """The predictions of a synthetic variant, seed 42, as those of the local ranker."""
    rows = [row | {"variant": "local"} for row in predictions.to_pylist() if (row["variant"], row["seed"]) == (variant, 42)]
    return table_from_rows(schemas.PREDICTIONS, rows)


def s1(tables: Tables, scores: Mapping[str, Any], scene_ids: set[str]) -> float:
    """Share of covered targets whose best-scored candidate succeeds, by plain dictionaries."""
    groups: dict[tuple[str, int], list[tuple[Any, bool]]] = {}
    for row in tables["candidates"].to_pylist():
        if row["scene_id"] in scene_ids:
            groups.setdefault((row["scene_id"], row["target_id"]), []).append(
                (scores[row["candidate_id"]], bool(row["y_plan"] and row["y_pipe"]))
            )
    covered = [own for own in groups.values() if any(success for _, success in own)]
    return sum(max(own)[1] for own in covered) / len(covered)


def overlapping(tables: Tables) -> tuple[Tables, dict[SplitScheme, set[str]]]:
    """A release whose test splits of two schemes share twenty of their forty scenes; the rest of each trains."""
    scenes = sorted(tables["splits"]["scene_id"].to_pylist())
    tests = {SCENE: set(scenes[:40]), LAYOUT: set(scenes[20:])}
    rows = [
        row | {scheme.column: "test" if row["scene_id"] in own else "train" for scheme, own in tests.items()}
        for row in tables["splits"].to_pylist()
    ]
    return {**tables, "splits": table_from_rows(schemas.SPLITS, rows)}, tests


def test_the_loss_is_counted_on_the_scenes_of_both_tests(release_tables: Tables, predictions: pa.Table) -> None:
    known, held_out = as_local(predictions, "full"), as_local(predictions, "no_object_relative")
    tables, tests = overlapping(release_tables)
    report = generalisation_report(tables, {SCENE: known, LAYOUT: held_out}, tier="full", seed=42)
    scores = [scores_of(own, "local", 42) for own in (known, held_out)]
    assert report.metrics["test.fixed.local.scene.s1"] == pytest.approx(s1(tables, scores[0], tests[SCENE]))
    assert report.metrics["test.fixed.local.layout.s1"] == pytest.approx(s1(tables, scores[1], tests[LAYOUT]))
    before, after = (s1(tables, own, tests[SCENE] & tests[LAYOUT]) for own in scores)
    assert before > after, "the one has more noise"
    name = "test.fixed.local.layout.s1_minus_trained_on_others"
    assert report.metrics[name] == pytest.approx(after - before)
    assert report.metrics[f"{name}_low"] < report.metrics[name] < report.metrics[f"{name}_high"]
    assert "| `layout` | Local ranker | 20 |" in report.markdown
    # How much there was to learn from, and how often, on either side.
    assert [report.metrics[f"train.{scheme.value}.n_scenes"] for scheme in (SCENE, LAYOUT)] == [20, 20]
    assert "| `layout` | two obstacles | 20 | +0 | 1 | – |" in report.markdown


def test_what_was_not_trained_on_any_is_held_against_the_planner(release_tables: Tables, predictions: pa.Table) -> None:
    known, held_out = as_local(predictions, "full"), as_local(predictions, "no_object_relative")
    tables, tests = overlapping(release_tables)
    metrics = generalisation_report(tables, {SCENE: known, LAYOUT: held_out}, tier="full", seed=42).metrics
    # The shortest plan first, equal ones by hash, what has none last: the largest is tried first.
    planner = {
        row["candidate_id"]: (-(row["plan_duration_s"] or float("inf")), -order_key(42, "policy_order", row["candidate_id"]))
        for row in release_tables["candidates"].to_pylist()
    }
    scores = scores_of(held_out, "local", 42)
    for name, own in (("s1_both_tests", tests[SCENE] & tests[LAYOUT]), ("s1", tests[LAYOUT])):
        ranker_s1, planner_s1 = s1(tables, scores, own), s1(tables, planner, own)
        assert metrics[f"test.fixed.full_planner.layout.{name}"] == pytest.approx(planner_s1)
        gain = f"test.fixed.local.layout.{name}_minus_full_planner"
        assert metrics[gain] == pytest.approx(ranker_s1 - planner_s1)
        assert metrics[f"{gain}_low"] < metrics[gain] < metrics[f"{gain}_high"]


def test_too_few_scenes_have_no_interval(release_tables: Tables, predictions: pa.Table) -> None:
    rows = [row | {"split_layout": "test" if row["split"] == "test" else "train"} for row in release_tables["splits"].to_pylist()]
    few = [row | {"split_layout": "train"} if k % 2 else row for k, row in enumerate(rows)]
    tables, same = {**release_tables, "splits": table_from_rows(schemas.SPLITS, few)}, as_local(predictions, "full")
    report = generalisation_report(tables, {SCENE: same, LAYOUT: same}, tier="full", seed=42)
    assert not [name for name in report.metrics if "minus" in name]
    assert "| – | – | – |" in report.markdown
    assert [line for line in report.markdown.splitlines() if line.startswith("| `layout` | Local ranker") and line.endswith("| – | – |")]


def test_rankers_that_say_the_same_lose_nothing(release_tables: Tables, predictions: pa.Table) -> None:
    everywhere = {**release_tables, "splits": all_in_test(release_tables["splits"])}
    same = as_local(predictions, "full")
    metrics = generalisation_report(everywhere, {SCENE: same, OBJECT: same}, tier="full", seed=42).metrics
    for task in ("joint", "fixed"):
        name = f"test.{task}.local.object.s1_minus_trained_on_others"
        assert [metrics[name], metrics[f"{name}_low"], metrics[f"{name}_high"]] == [0.0, 0.0, 0.0]
        assert metrics[f"test.{task}.local.object.s1"] == metrics[f"test.{task}.local.scene.s1"]


def all_in_test(splits: pa.Table) -> pa.Table:
    columns = {scheme.column: "test" for scheme in SplitScheme}
    return table_from_rows(schemas.SPLITS, [row | columns for row in splits.to_pylist()])


def test_without_the_paper_s_split_there_is_nothing_to_compare_with(release_tables: Tables, predictions: pa.Table) -> None:
    with pytest.raises(ReportError, match="none of rankers of the paper's split"):
        generalisation_report(release_tables, {OBJECT: as_local(predictions, "full")}, tier="full", seed=42)
