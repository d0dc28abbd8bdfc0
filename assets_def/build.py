"""Builds a tier from a terminal: `python -m assets_def.build mini|pilot|full`; every step is a Dagster run, visible in the UI.

Shards that are up to date are skipped, so a killed build continues where it was: it loses at most the scenes in work and those that
were finished in the last five seconds.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence

from dagster import AssetSelection, DagsterInstance, materialize
from rich.console import Console
from rich.markdown import Markdown
from rich.table import Table

from assets_def.definitions import definitions
from assets_def.object_assets import object_assets
from assets_def.partitions import rankers_of_tier
from assets_def.progress import ShardProgress
from assets_def.ranker_assets import predictions, ranker
from assets_def.release_assets import joined_tables, release, splits_table
from assets_def.report_assets import report_assets_of
from assets_def.resources import Benchmark
from assets_def.stages import stage_assets
from pipelines.running.shard_runner import is_published
from pipelines.stages import STAGES
from tables.identity import TIERS, shards_of_tier

CONSOLE = Console()


class BuildError(RuntimeError):
    """A Dagster run that failed; its log is in the UI and above."""


def build(tier: str, n_workers: int, until: str) -> dict[str, float]:
    """Build everything of a tier that is missing.

    Args:
        until: `release` stops at the release folder and its profile report, `reports` trains rankers and writes every report.

    Returns:
        Wall time in seconds by step.

    Raises:
        BuildError: a run failed; finished work is kept.
    """
    benchmark = Benchmark(n_workers=n_workers)
    seconds: dict[str, float] = {}
    _run(seconds, "objects", [object_assets], None, benchmark)
    _build_shards(seconds, tier, benchmark)
    _run(seconds, "release", [joined_tables, splits_table, release], tier, benchmark)
    if until == "reports":
        for key in rankers_of_tier(tier):
            _run(seconds, f"ranker {key.variant} {key.seed}", [ranker], str(key), benchmark)
        _run(seconds, "predictions", [predictions], tier, benchmark)
    _run(seconds, "reports", report_assets_of(until), tier, benchmark)
    return seconds


def _build_shards(seconds: dict[str, float], tier: str, benchmark: Benchmark) -> None:
    shards = shards_of_tier(tier)
    missing = [shard for shard in shards if not _is_complete(shard, benchmark)]
    CONSOLE.print(f"{tier}: {len(shards) - len(missing)} of {len(shards)} shards are up to date")
    start = time.perf_counter()
    with ShardProgress(CONSOLE, len(missing)) as progress:
        for shard in missing:
            _run({}, shard, stage_assets, shard, benchmark)
            progress.finish_shard()
    seconds["shards"] = time.perf_counter() - start
    seconds.update(progress.seconds_by_stage)


def _is_complete(shard: str, benchmark: Benchmark) -> bool:
    inputs = benchmark.shard_inputs(shard)
    return all(is_published(stage, shard, benchmark.root, inputs) for stage in STAGES)


def _run(seconds: dict[str, float], name: str, assets: Sequence[object], partition_key: str | None, benchmark: Benchmark) -> None:
    start = time.perf_counter()
    chosen = AssetSelection.assets(*(key for asset in assets for key in asset.keys))  # type: ignore[attr-defined]
    result = materialize(
        list(definitions.assets or ()),  # type: ignore[arg-type]
        selection=chosen,
        partition_key=partition_key,
        resources={"benchmark": benchmark},
        run_config={"loggers": {"console": {"config": {"log_level": "WARNING"}}}},
        instance=DagsterInstance.get(),
        raise_on_error=False,
    )
    if not result.success:
        failures = [event for event in result.all_events if event.is_failure]
        reasons = "\n".join(str(event.message) for event in failures)
        failed_checks = [e for e in result.get_asset_check_evaluations() if not e.passed]
        reasons += "\n".join(f"check {e.asset_key.to_user_string()}.{e.check_name}: {e.metadata}" for e in failed_checks)
        raise BuildError(f"{name}: run {result.run_id} failed:\n{reasons}")
    seconds[name] = time.perf_counter() - start


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line: 0 where the tier is built, 1 where a run failed."""
    parser = argparse.ArgumentParser(prog="python -m assets_def.build", description=__doc__)
    parser.add_argument("tier", choices=TIERS)
    parser.add_argument("--workers", type=int, default=Benchmark().n_workers, help="worker processes; the result does not depend on it")
    parser.add_argument("--until", choices=("release", "reports"), default="reports")
    chosen = parser.parse_args(arguments)
    try:
        seconds = build(chosen.tier, chosen.workers, chosen.until)
    except BuildError as error:
        CONSOLE.print(str(error), style="red", markup=False)
        return 1
    _print_result(chosen.tier, chosen.until, seconds)
    return 0


def _print_result(tier: str, until: str, seconds: dict[str, float]) -> None:
    benchmark = Benchmark()
    reports = benchmark.report_dir(tier)
    shown = "success_at_k" if until == "reports" else "profile"
    sections = (reports / f"{shown}.md").read_text(encoding="utf-8").split("\n## ")
    CONSOLE.print(Markdown("\n## ".join(sections[:2])))
    table = Table("step", "wall s", title=f"wall time of this run, tier {tier}")
    for name, value in seconds.items():
        table.add_row(name, f"{value:.1f}")
    CONSOLE.print(table)
    CONSOLE.print(f"release: {benchmark.root.release(tier)}\nreports: {reports}")


if __name__ == "__main__":
    sys.exit(main())
