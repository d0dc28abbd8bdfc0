"""Whether the held object's engine is valid: `python -m assets_def.validity pilot` writes reports/out/validity.json and validity.md.

With `--only STUDY ...` some studies run, and the report, which says what it leaves out, has a name of its own:
`validity-TIER-STUDY.json` and `.md`.

The tests are in pipelines/proofs/validity. Rows are kept as they finish, below the tier, and used again as long as code, recipe, release
and engines are the same: a killed command continues where it was.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Collection, Sequence
from pathlib import Path

from rich.console import Console
from rich.markdown import Markdown
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from assets_def.inputs import source_version
from assets_def.resources import Benchmark
from pipelines.proofs.validity.studies import STUDIES, StudyProgress, numbers_of, run_studies
from pipelines.proofs.validity.subject import Sizes, Subject
from pipelines.recipe import Recipe
from pipelines.running.lock import locked
from reports.validity import ValidityReport, validity_report
from splits.errors import ReleaseError
from splits.manifest import Manifest
from splits.release_reader import Release
from tables.errors import INTERRUPTED, PlaceBenchError
from tables.files import write_text_atomically
from tables.identity import TIERS
from tables.versions import library_versions
from tables.vocabulary import Category

CONSOLE, ERRORS = Console(), Console(stderr=True)
# Whatever may change a row: packages below which everything is simulated, and the libraries that do it.
SOURCES = ("tables", "objects", "pipelines")
ENGINES = ("frankik", "mujoco-core", "numpy", "pybullet", "ruckig", "scipy")


def validity(
    tier: str, benchmark: Benchmark, sizes: Sizes, console: Console = CONSOLE, only: Collection[str] = tuple(STUDIES)
) -> ValidityReport:
    """Measure what is missing, and write both files.

    Args:
        only: names of the studies that run.

    Raises:
        ReleaseError: there is no release of the tier, it was made with another recipe than today's, or it has no objects to measure on.
        LockError: somebody else measures this tier.
    """
    release, recipe = Release.open(benchmark.root.release(tier)), benchmark.recipe_of_tier(tier)
    _check_recipe(release.manifest, recipe)
    _check_objects(release)
    subject = Subject(release.values, release.table("candidates"), recipe, sizes)
    made_from = {
        "release": release.manifest.release_hash,
        "recipe": recipe.hash_of(),
        "code": source_version(*SOURCES),
        **{f"engine.{name}": version for name, version in library_versions(ENGINES).items()},
    }
    folder = benchmark.root.validity(tier)
    makers = {name: maker for name, maker in STUDIES.items() if name in only}
    with locked(folder / ".lock", f"validity of {tier}"), _Bar(console) as bar:
        results = run_studies(subject, folder, made_from, benchmark.n_workers, bar.show, makers)
    commit = {"commit of the release": release.manifest.provenance["git_commit"], "data version": release.manifest.version}
    origin = {"tier": tier, "seed": str(recipe.seed), **made_from, **commit}
    report = validity_report(numbers_of(results, subject), results, origin, [name for name in STUDIES if name not in makers])
    path = report_path(tier, benchmark, only)
    write_text_atomically(path.with_suffix(".json"), report.json)
    write_text_atomically(path, report.markdown)
    return report


def report_path(tier: str, benchmark: Benchmark, only: Collection[str]) -> Path:
    """Where the text of a report lies, the numbers beside it: one of some studies never replaces one of all."""
    chosen = [name for name in STUDIES if name in only]
    name = "validity" if len(chosen) == len(STUDIES) else f"validity-{tier}-{'+'.join(chosen)}"
    return benchmark.reports / f"{name}.md"


def _check_recipe(manifest: Manifest, recipe: Recipe) -> None:
    stored, today = manifest.provenance["recipe_hash"][:12], recipe.hash_of()[:12]
    if stored != today:
        raise ReleaseError(f"release {manifest.tier}: made with recipe {stored}, must be today's {today} (make dataset again)")


def _check_objects(release: Release) -> None:
    """Theory and the second engine are asked of plain shapes: without them there is nothing to hold the engine against."""
    found = set(release.table("objects")["category"].to_pylist())
    if missing := sorted({Category.CAN.value, Category.CUBOID.value} - found):
        raise ReleaseError(
            f"release {release.manifest.tier}: no {' and no '.join(missing)} among its objects, must have both to be measured on"
        )


class _Bar:
    """A progress bar with an estimated end; a log, which shows no bar, gets a line a study."""

    def __init__(self, console: Console) -> None:
        columns = (TextColumn("{task.description:<34}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
        self._progress = Progress(*columns, TextColumn("left"), TimeRemainingColumn(), console=console, speed_estimate_period=600)
        self._console, self._start = console, time.perf_counter()
        self._task = self._progress.add_task("validity", total=1.0)

    def __enter__(self) -> _Bar:
        self._progress.start()
        return self

    def __exit__(self, *of_error: object) -> None:
        self._progress.stop()

    def show(self, progress: StudyProgress) -> None:
        self._progress.update(self._task, completed=progress.share, description=f"{progress.study} {progress.done}/{progress.total}")
        if progress.done == progress.total and not self._console.is_terminal:
            spent_s = time.perf_counter() - self._start
            left_s = spent_s * (1.0 - progress.share) / progress.share if progress.share else 0.0
            self._console.print(f"{progress.study}: {progress.total} units, {spent_s:.0f} s in all, about {left_s:.0f} s left")


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line: 0 where every number of the studies is within its bounds, 1 where one is not or is missing, 130 where interrupted."""
    parser = argparse.ArgumentParser(prog="python -m assets_def.validity", description=__doc__)
    parser.add_argument("tier", choices=TIERS, nargs="?", default="pilot")
    default = Benchmark().n_workers
    parser.add_argument("--workers", type=int, default=default, help=f"worker processes ({default}); the result does not depend on it")
    parser.add_argument(
        "--only", nargs="+", choices=STUDIES, default=tuple(STUDIES), metavar="STUDY", help=f"studies to run (all): {', '.join(STUDIES)}"
    )
    parser.add_argument("--data", default=Benchmark().data_dir, help="data folder; a relative one is below the checkout")
    parser.add_argument("--recipe", default=Benchmark().recipe_path, help="that the release was made with; relative as the data folder")
    chosen = parser.parse_args(arguments)
    benchmark = Benchmark(n_workers=chosen.workers, data_dir=chosen.data, recipe_path=chosen.recipe)
    try:
        report = validity(chosen.tier, benchmark, Sizes.of_tier(chosen.tier), only=chosen.only)
    except KeyboardInterrupt:
        ERRORS.print("interrupted; finished rows are kept, the same command continues there", style="red")
        return INTERRUPTED
    except PlaceBenchError as error:
        ERRORS.print(f"{type(error).__name__}: {error}", style="red", markup=False, highlight=False, soft_wrap=True)
        return 1
    CONSOLE.print(Markdown(report.markdown.partition("\n## Beside them")[0]))
    CONSOLE.print(f"written to {report_path(chosen.tier, benchmark, chosen.only)} and .json")
    return 0 if report.holds else 1


if __name__ == "__main__":
    sys.exit(main())
