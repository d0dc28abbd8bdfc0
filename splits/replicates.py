"""Executes every planned candidate of the test split of a release again, under small real uncertainty: table `test_replicates`.

python -m splits.replicates DIR [--workers N] [--out FILE]

Needs a whole release (`make plans` for a light one). Scenes are kept as they finish, beside the table: a killed run goes on where it was.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import polars as pl
import pyarrow as pa

from pipelines.proofs.replicates import CODE_VERSION, N_REPLICATES, replicate_table, works_of
from pipelines.recipe import DEFAULT_RECIPE, Recipe, load_recipe
from pipelines.running.data_root import DataRoot
from pipelines.running.lock import locked
from pipelines.stages import STAGE
from splits.errors import ReleaseError
from splits.manifest import Manifest
from splits.release_reader import Release
from tables.errors import PlaceBenchError
from tables.identity import family_of_tier
from tables.schemas import TEST_REPLICATES
from tables.sidecar import Sidecar, find_published
from tables.store import write_table
from tables.versions import library_versions
from tables.vocabulary import Split

TABLE = TEST_REPLICATES.name


def make_replicates(
    release: Release,
    path: Path,
    n_workers: int = 1,
    n_replicates: int = N_REPLICATES,
    recipe_path: Path = DEFAULT_RECIPE,
    log: Callable[[str], Any] = print,
) -> Sidecar:
    """Publish table `test_replicates` of a release at a path, or keep the one that is there and was made from the same.

    Raises:
        ReleaseError, ReplicateError: as `execute_replicates`.
        LockError: somebody else makes this table.
    """
    made_from = replicates_made_from(release.manifest, recipe_of(release, recipe_path), n_replicates)
    found = find_published(TEST_REPLICATES, path, made_from, release.manifest.tier)
    if isinstance(found, Sidecar):
        log(f"{TABLE}: there already, {found.rows:,} rows")
        return found
    with locked(path.with_name(f".{path.name}.lock"), f"{TABLE} of {release.manifest.tier}"):
        table = execute_replicates(release, kept_beside(path), n_workers, n_replicates, recipe_path, log)
        sidecar = write_table(TEST_REPLICATES, table, path, made_from, of=release.manifest.tier)
        kept_beside(path).unlink()
    log(f"{TABLE}: {sidecar.rows:,} rows, content hash {sidecar.content_hash[:12]}, {path}")
    return sidecar


def execute_replicates(
    release: Release,
    kept: Path,
    n_workers: int = 1,
    n_replicates: int = N_REPLICATES,
    recipe_path: Path = DEFAULT_RECIPE,
    log: Callable[[str], Any] = print,
) -> pa.Table:
    """Table `test_replicates` of a release.

    Args:
        kept: file of the finished scenes; whoever has published the table removes it.
        n_workers: worker processes; 0 stays in this process. The table does not depend on it.
        n_replicates: executions of each candidate.
        recipe_path: the recipe that the release was made with.
        log: told how far it is.

    Raises:
        ReleaseError: a release of another recipe, or without plans.
        ReplicateError: a scene that could not be executed; the others are kept for the next run.
    """
    recipe = recipe_of(release, recipe_path)
    of_test = release.candidates.filter(pl.col("y_plan") & (pl.col("split") == Split.TEST.value))
    start_s = time.perf_counter()

    def tell(done: int, total: int, core_s: float) -> None:
        log(f"{TABLE}: {done} of {total} scenes, {core_s:.0f} core-s, {time.perf_counter() - start_s:.0f} s")

    works = works_of(release.values, of_test["candidate_id"].to_list(), recipe, n_replicates)
    return replicate_table(works, kept, replicates_made_from(release.manifest, recipe, n_replicates), n_workers, tell)


def kept_beside(path: Path) -> Path:
    """The file of finished scenes of a table that is being made."""
    return path.with_name(f".{TABLE}.unfinished.jsonl")


def recipe_of(release: Release, path: Path) -> Recipe:
    """The recipe of a file, if the release was made with it; raises ReleaseError where it was not."""
    recipe, stated = load_recipe(family_of_tier(release.manifest.tier), path), release.manifest.provenance["recipe_hash"]
    if recipe.hash_of() != stated:
        raise ReleaseError(f"{release.directory}: of recipe {stated[:12]}, must be this code's {recipe.hash_of()[:12]}")
    return recipe


def replicates_made_from(manifest: Manifest, recipe: Recipe, n_replicates: int) -> dict[str, str]:
    """What decides the rows of `test_replicates` of a release."""
    stage = STAGE["execution_labels"]
    return {
        "release": manifest.release_hash,
        "recipe": recipe.hash_of(),
        "code": CODE_VERSION,
        f"code.{stage.name}": stage.code_version,
        "parameter.replicates": str(n_replicates),
        **{f"engine.{name}": version for name, version in library_versions(stage.engines).items()},
    }


def default_path(directory: Path, tier: str) -> Path:
    """Where the table about a release of a data folder goes: to those shipped with it if there are any, else to those of the tier."""
    root = DataRoot(directory.resolve().parent.parent)
    shipped = root.predictions(tier)
    return shipped / f"{TABLE}.parquet" if shipped.is_dir() else root.tier_table(tier, TABLE)


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line: 0 where the table is there, 1 where it could not be made, 130 where it was interrupted."""
    parser = argparse.ArgumentParser(prog="python -m splits.replicates", description=__doc__)
    parser.add_argument("directory", type=Path, help="a whole release")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="worker processes; the result does not depend on it")
    parser.add_argument("--out", type=Path, metavar="FILE", help=f"of the table; {TABLE}.parquet beside others by default")
    parser.add_argument("--recipe", type=Path, default=DEFAULT_RECIPE)
    chosen = parser.parse_args(arguments)
    try:
        release = Release.open(chosen.directory)
        path = chosen.out or default_path(chosen.directory, release.manifest.tier)
        make_replicates(release, path, chosen.workers, recipe_path=chosen.recipe)
    except PlaceBenchError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted; finished scenes are kept, the same command continues there", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
