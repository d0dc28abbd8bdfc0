"""The trees of a tier through the graph: made once, kept while the release stays, and reported as the command reports them."""

from __future__ import annotations

import json
from pathlib import Path

import pyarrow.compute as pc
import pytest
from dagster import DagsterInstance, ExecuteInProcessResult, materialize

from assets_def.report_assets import report_assets, report_steps
from assets_def.resources import Benchmark
from assets_def.trees_assets import TREE_PREDICTIONS, TREE_TIMES, TREES_SEED, trees_assets, trees_step
from model.features import CANDIDATE_GEOMETRY
from model.trees import read_tree_data
from reports.trees_probe import tree_predictions
from splits.release import write_release
from splits.release_reader import Release
from tables.schemas import ALL_SCHEMAS, PREDICTIONS
from tables.store import read_table, table_from_rows
from tests.model.synthetic_release import RELEASE_SCHEMAS, TOLERANCES, write_synthetic_release
from tests.splits.damage import PROVENANCE

TIER = "pilot"
(PROBE,) = (k for k, step in enumerate(report_steps) if step.name == "trees_probe report")


@pytest.fixture
def benchmark(tmp_path: Path) -> Benchmark:
    """A benchmark whose release of `pilot` is a synthetic one of ten scenes."""
    made = Benchmark(data_dir=str(tmp_path / "data"), reports_dir=str(tmp_path / "reports"))
    loose = write_synthetic_release(tmp_path / "loose", n_scenes=10, seed=1, n_points=40)
    tables = {schema.name: read_table(schema, loose / f"{schema.name}.parquet") for schema in RELEASE_SCHEMAS}
    write_release(tables, made.root.release(TIER), TIER, "0.1.0", PROVENANCE, TOLERANCES)
    return made


def test_the_tables_and_the_report_are_made_once(benchmark: Benchmark) -> None:
    first = run(benchmark)
    assert first.success
    assert {(e.asset_key.to_user_string(), e.check_name, e.passed) for e in first.get_asset_check_evaluations()} == {
        (CANDIDATE_GEOMETRY.name, "schema", True),
        (TREE_PREDICTIONS, "schema", True),
        (TREE_TIMES, "schema", True),
    }
    assert reused(first) == {CANDIDATE_GEOMETRY.name: False, TREE_PREDICTIONS: False, TREE_TIMES: False, "trees_probe_report": False}
    assert trees_step.is_done(benchmark, TIER)
    assert reused(run(benchmark)) == {CANDIDATE_GEOMETRY.name: True, TREE_PREDICTIONS: True, TREE_TIMES: True, "trees_probe_report": True}

    release_dir = benchmark.root.release(TIER)
    expected = tree_predictions(release_dir, read_tree_data(release_dir), TREES_SEED, None)
    made = read_table(PREDICTIONS, benchmark.root.tier_table(TIER, TREE_PREDICTIONS))
    assert made.filter(pc.equal(made["seed"], TREES_SEED)).equals(expected)
    trained = {(row["variant"], row["seed"]) for row in made.select(["variant", "seed"]).to_pylist()}
    assert trained == {("trees", 42), ("trees", 43), ("trees", 44), ("trees_poses", 42)}, "as many on geometry as networks have seeds"
    metrics = json.loads((benchmark.report_dir(TIER) / "trees_probe.json").read_text())
    assert metrics["trees.auroc_plan"] > 0.8


def test_another_release_makes_them_again(benchmark: Benchmark) -> None:
    assert run(benchmark).success
    release_dir = benchmark.root.release(TIER)
    tables = Release.open(release_dir).tables()
    rows = tables["policy_features"].to_pylist()
    rows[0]["ik_feasible"] = not rows[0]["ik_feasible"]
    tables["policy_features"] = table_from_rows(ALL_SCHEMAS["policy_features"], rows)
    write_release(tables, release_dir, TIER, "0.1.0", PROVENANCE, TOLERANCES)
    assert not trees_step.is_done(benchmark, TIER)
    assert reused(run(benchmark)) == {
        CANDIDATE_GEOMETRY.name: False,
        TREE_PREDICTIONS: False,
        TREE_TIMES: False,
        "trees_probe_report": False,
    }


def run(benchmark: Benchmark) -> ExecuteInProcessResult:
    return materialize(
        [*trees_assets, report_assets[PROBE]],
        partition_key=TIER,
        resources={"benchmark": benchmark},
        instance=DagsterInstance.ephemeral(),
        run_config={"loggers": {"console": {"config": {"log_level": "CRITICAL"}}}},
        raise_on_error=False,
    )


def reused(result: ExecuteInProcessResult) -> dict[str, object]:
    events = (event.materialization for event in result.get_asset_materialization_events())
    return {event.asset_key.to_user_string(): event.metadata["reused"].value for event in events}
