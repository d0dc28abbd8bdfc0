"""The gate of the `ranker` asset reads the checkpoint that was written: it lets a real one through and stops one that read too much."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from dagster import DagsterInstance, ExecuteInProcessResult, materialize

from assets_def.partitions import rankers_of_tier
from assets_def.ranker_assets import ranker
from assets_def.resources import Benchmark
from model import networks
from model.settings import LIGHT, Variant
from tests.model.synthetic_release import write_synthetic_release
from tests.model.test_input_record import let_through


@pytest.fixture
def data_dir(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A synthetic release where the asset looks for one, and one epoch of training instead of 24."""
    monkeypatch.setitem(networks._OF_THE_PAPER, "light", replace(LIGHT, n_epochs=1))
    write_synthetic_release(Benchmark(data_dir=str(tmp_path)).root.release("mini"), n_scenes=5, seed=3, n_points=160)
    return tmp_path


def test_a_real_checkpoint_passes(data_dir: Path) -> None:
    result = _materialised(data_dir)
    assert result.success
    (check,) = result.get_asset_check_evaluations()
    assert check.passed


def test_a_checkpoint_that_read_a_forbidden_column_stops_the_graph(data_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    let_through(monkeypatch, "grasps", "lift_slip_m")
    result = _materialised(data_dir)
    (check,) = result.get_asset_check_evaluations()
    assert not check.passed
    assert str(check.metadata["first_errors"].value).startswith("grasps.lift_slip_m: known only after pick-lift")
    assert not result.success


def _materialised(data_dir: Path) -> ExecuteInProcessResult:
    key = next(key for key in rankers_of_tier("mini") if key.variant is Variant.FULL)
    return materialize(
        [ranker],
        partition_key=str(key),
        resources={"benchmark": Benchmark(data_dir=str(data_dir))},
        instance=DagsterInstance.ephemeral(),
        raise_on_error=False,
    )
