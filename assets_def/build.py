"""Builds a tier from a terminal: `python -m assets_def.build mini|pilot|full`; every step is a Dagster run, visible in the UI.

With `--catalogue FILE` or `--recipe FILE` it is a dataset of one's own, with a data folder and a Dagster instance of its own.

What is up to date is skipped, so a killed build continues where it was: it loses at most the scenes in work and those that were finished
in the last five seconds, an interrupted one (Ctrl-C) only the scenes in work.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

from dagster import (
    AssetsDefinition,
    DagsterError,
    DagsterExecutionInterruptedError,
    DagsterInstance,
    ExecuteInProcessResult,
)
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from assets_def.chosen_dataset import add_choice, environment_of
from assets_def.curve_assets import curve_step
from assets_def.definitions import definitions_of
from assets_def.jobs import job_of
from assets_def.object_assets import are_objects_done, object_assets
from assets_def.partitions import rankers_of_tier
from assets_def.progress import ShardProgress
from assets_def.proof_assets import attempts_step, audits_step, replicates_step
from assets_def.ranker_assets import predictions_step, ranker_step
from assets_def.release_assets import release_step, release_steps
from assets_def.report_assets import profile_step, report_steps
from assets_def.resources import Benchmark
from assets_def.site_assets import site_step
from assets_def.stages import stage_assets
from assets_def.steps import Step
from assets_def.trees_assets import trees_step
from pipelines.running.shard_runner import is_published
from pipelines.stages import STAGES
from reports.load import Task
from reports.standing import read_metrics, standings
from tables.errors import INTERRUPTED, PlaceBenchError
from tables.identity import TIERS

CONSOLE, ERRORS = Console(), Console(stderr=True)


class BuildError(PlaceBenchError, RuntimeError):
    """A Dagster run that failed; says in one line which step and why, and which run has the whole log."""


def build(tier: str, benchmark: Benchmark, until: str) -> None:
    """Build everything of a tier that is missing, and say so line by line.

    Args:
        until: `release` stops at the release folder and its profile report, `reports` trains rankers and writes every report.

    Raises:
        BuildError: a run failed; finished work is kept.
        StoreError: a published file is missing or broken.
        RecipeError: the recipe cannot be read.
        CatalogueError: the catalogue cannot be read.
        DatasetError: the data folder holds another dataset.
    """
    benchmark.check()
    _build_objects(benchmark)
    _build_shards(tier, benchmark)
    _build_steps(tier, benchmark, until)


def _build_objects(benchmark: Benchmark) -> None:
    with _line("objects") as outcome:
        if are_objects_done(benchmark):
            outcome.append("up to date")
        else:
            _run("objects", [object_assets], None, benchmark)
            outcome.append("made")


def _build_steps(tier: str, benchmark: Benchmark, until: str) -> None:
    for step, partition, name in _steps(tier, until):
        with _line(name) as outcome:
            if step.is_done(benchmark, partition):
                outcome.append("up to date")
            else:
                _run(name, [step.asset], partition, benchmark)
                outcome.append("made")


def _steps(tier: str, until: str) -> Iterator[tuple[Step, str, str]]:
    """(step, partition, name on the terminal) above the shards, in order."""
    yield from ((step, tier, step.name) for step in release_steps)
    if until == "release":
        yield profile_step, tier, profile_step.name
        return
    # Attempts are made from the release and belong into it; rankers are trained on the one that has them.
    yield attempts_step, tier, attempts_step.name
    yield release_step, tier, "release with attempts"
    yield from ((ranker_step, str(key), f"ranker {key}") for key in rankers_of_tier(tier))
    about = (predictions_step, trees_step, curve_step, audits_step, replicates_step, *report_steps, site_step)
    yield from ((step, tier, step.name) for step in about)


def _build_shards(tier: str, benchmark: Benchmark) -> None:
    shards = benchmark.layout.shards_of_tier(tier)
    missing = [shard for shard in shards if not _is_complete(shard, benchmark)]
    CONSOLE.print(f"{'shards':<36}{len(shards) - len(missing)} of {len(shards)} up to date")
    start = time.perf_counter()
    with ShardProgress(CONSOLE, len(missing)) as progress:
        for shard in missing:
            _run(shard, stage_assets, shard, benchmark)
            progress.finish_shard()
    if missing:
        CONSOLE.print(f"{'':<36}{f'{len(missing)} made':<12}{time.perf_counter() - start:7.1f} s")
        for name, seconds in progress.seconds_by_stage.items():
            CONSOLE.print(f"{f'  {name}':<48}{seconds:7.1f} s")


def _is_complete(shard: str, benchmark: Benchmark) -> bool:
    inputs = benchmark.shard_inputs(shard)
    return all(is_published(stage, shard, benchmark.root, inputs) for stage in STAGES)


@contextmanager
def _line(name: str) -> Iterator[list[str]]:
    """One line a step: its name when it starts, the outcome appended to the list and the time when it is done."""
    start = time.perf_counter()
    outcome: list[str] = []
    CONSOLE.print(f"{name:<36}", end="")
    try:
        yield outcome
    except BaseException:
        CONSOLE.print()
        raise
    CONSOLE.print(f"{' '.join(outcome):<12}{time.perf_counter() - start:7.1f} s")


def _run(name: str, assets: Sequence[AssetsDefinition], partition_key: str | None, benchmark: Benchmark) -> None:
    keys = [key for made in assets for key in made.keys]
    # In a named job of the graph, so that the UI lists the run under it.
    graph = definitions_of(benchmark)
    result = graph.resolve_job_def(job_of(graph, keys, partition_key)).execute_in_process(
        asset_selection=keys,
        partition_key=partition_key,
        run_config={"loggers": {"console": {"config": {"log_level": "CRITICAL"}}}},  # failures are told below, in one line
        instance=DagsterInstance.get(),
        raise_on_error=False,
    )
    if not result.success:
        raise BuildError(f"{name}: {_reason(result)} (the whole log: make ui, run {result.run_id[:8]})")


def _reason(result: ExecuteInProcessResult) -> str:
    """The first line of why a run failed: the first finding of a check, or an error below Dagster's own.

    Raises:
        KeyboardInterrupt: it was interrupted, which Dagster reports as a failure of the step in work.
    """
    for check in result.get_asset_check_evaluations():
        if not check.passed:
            found = check.metadata.get("first_errors") or check.metadata.get("error")
            return f"check {check.asset_key.to_user_string()}.{check.check_name}: {_first_line(str(found.value if found else ''))}"
    for event in result.all_events:
        error = event.step_failure_data.error if event.is_step_failure else None
        # Dagster wraps what a step raises; what that was raised from is a detail again.
        while error is not None and error.cause is not None and (error.cls_name or "").startswith("Dagster"):
            error = error.cause
        if error is not None and error.cls_name == DagsterExecutionInterruptedError.__name__:
            raise KeyboardInterrupt
        if error is not None:
            return _first_line(error.message)
    return next((_first_line(str(event.message)) for event in result.all_events if event.is_failure), "no reason given")


def _first_line(text: str) -> str:
    """The first line, and the next one where the first ends in a colon: it announces reasons, and the first of them is wanted."""
    first, _, rest = text.strip().partition("\n")
    return f"{first} {rest.partition(chr(10))[0].strip()}" if first.endswith(":") and rest else first


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        """One line instead of the usage and a line."""
        _say_error(f"{message} (--help says more)")
        sys.exit(2)


def _workers(text: str) -> int:
    try:
        n_workers = int(text)
    except ValueError:
        n_workers = -1
    if n_workers < 0:
        raise argparse.ArgumentTypeError(f"{text}, must be a whole number of at least 0")
    return n_workers


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line: 0 where the tier is built, 1 where it could not be, 2 where the command is wrong, 130 where it was interrupted."""
    parser = _Parser(prog="python -m assets_def.build", description=__doc__)
    parser.add_argument("tier", choices=TIERS)
    default = Benchmark().n_workers
    parser.add_argument("--workers", type=_workers, default=default, help=f"worker processes ({default}); the result does not depend on it")
    parser.add_argument(
        "--until",
        choices=("release", "reports"),
        default="reports",
        help="release: the release folder and its profile report, nothing else; reports (default): rankers and every report too",
    )
    add_choice(parser)
    arguments = sys.argv[1:] if arguments is None else arguments
    chosen = parser.parse_args(arguments)
    try:
        _start_over_where_own(chosen, arguments)
        benchmark = Benchmark(n_workers=chosen.workers)
        build(chosen.tier, benchmark, chosen.until)
    except (KeyboardInterrupt, DagsterExecutionInterruptedError):
        _say_error("interrupted; everything published and every finished scene or epoch is kept, the same command continues there")
        return INTERRUPTED
    except (PlaceBenchError, DagsterError) as error:
        _say_error(f"{type(error).__name__}: {error}" if not isinstance(error, BuildError) else str(error))
        return 1
    _print_result(chosen.tier, chosen.until, benchmark)
    return 0


def _start_over_where_own(chosen: argparse.Namespace, arguments: Sequence[str]) -> None:
    """Run this command once more with the dataset that it names in its environment, unless it does; raises as `environment_of`."""
    if environment := environment_of(chosen):
        sys.stdout.flush()
        os.execve(sys.executable, [sys.executable, "-m", "assets_def.build", *arguments], {**os.environ, **environment})


def _say_error(message: str) -> None:
    ERRORS.print(" ".join(message.split()), style="red", markup=False, highlight=False, soft_wrap=True)


def _print_result(tier: str, until: str, benchmark: Benchmark) -> None:
    reports = benchmark.report_dir(tier)
    paths = {"release": benchmark.root.release(tier)}
    if until == "reports":
        CONSOLE.print(_ladder(tier, reports / "success_at_k.json", has_paper=not benchmark.is_own))
        paths |= {
            "ladder": reports / "success_at_k-test.png",
            "report": reports / "success_at_k.md",
            "site": reports / "site" / "index.html",
        }
    else:
        paths |= {"report": reports / "profile.md"}
    for name, path in paths.items():
        CONSOLE.print(f"{name:<9}{os.path.relpath(path)}", soft_wrap=True, highlight=False)


def _ladder(tier: str, metrics: Path, *, has_paper: bool) -> Table:
    """S1 of every policy in 80 columns, the paper's beside the benchmark's; the report has the rest."""
    ladder = Table(
        "policy",
        box=SIMPLE_HEAD,
        padding=0,
        show_edge=False,
        title=f"{tier}, test: S1 in percent of covered groups",
    )
    for task in Task:
        ladder.add_column(f"{task.value} [95 %]", justify="right")
        if has_paper:
            ladder.add_column("paper", justify="right")
    for standing in standings(read_metrics(metrics)):
        ladder.add_row(*standing.cells(has_paper=has_paper))
    return ladder


if __name__ == "__main__":
    sys.exit(main())
