"""The small dataset, built once through the graph; tests damage copies of it."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import pytest
from dagster import AssetsDefinition, DagsterInstance, ExecuteInProcessResult, materialize

from assets_def.release_assets import release_assets
from assets_def.stages import stage_assets
from tests.assets_def.small import SHARD, TIER, SmallBenchmark, small_benchmark, write_made_up_tables, write_objects


@dataclass(frozen=True, slots=True)
class Built:
    """Where the small dataset lies, and what the gates said when it was made: whether each `asset.check` passed."""

    folder: Path
    checks: Mapping[str, bool]

    def copy(self, folder: Path) -> SmallBenchmark:
        """A benchmark of its own with the same data."""
        shutil.copytree(self.folder, folder, dirs_exist_ok=True)
        return small_benchmark(folder)


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Built:
    folder = tmp_path_factory.mktemp("small")
    benchmark = small_benchmark(folder)
    write_objects(benchmark)
    results = [run(stage_assets, SHARD, benchmark), run(release_assets, TIER, benchmark)]
    for result in results:
        assert result.success, [str(e.step_failure_data.error) for e in result.all_events if e.is_step_failure]
    write_made_up_tables(benchmark.root)
    checks = {f"{e.asset_key.to_user_string()}.{e.check_name}": e.passed for r in results for e in r.get_asset_check_evaluations()}
    return Built(folder, checks)


def run(assets: list[AssetsDefinition], partition: str, benchmark: SmallBenchmark) -> ExecuteInProcessResult:
    """A run of some assets in an instance of its own."""
    return materialize(
        assets,
        partition_key=partition,
        resources={"benchmark": benchmark},
        instance=DagsterInstance.ephemeral(),
        run_config={"loggers": {"console": {"config": {"log_level": "CRITICAL"}}}},
        raise_on_error=False,
    )
