"""Executes every planned candidate of the test split of a release again, under small real uncertainty: table `test_replicates`.

python -m splits.replicates DIR [--scenes N] [--workers N] [--out FILE]

Needs a whole release (`make plans` for a light one). Scenes are kept as they finish, beside the table: a killed run goes on where it was.
With --scenes the table is of so many scenes of the split, the first in the order of their hash; a later run adds to it.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import polars as pl
import pyarrow as pa

from pipelines.proofs.replicates import CODE_VERSION, N_REPLICATES, replicate_table, works_of
from pipelines.recipe import DEFAULT_RECIPE, Recipe
from pipelines.running.data_root import DataRoot
from pipelines.running.lock import locked
from pipelines.stages import STAGE
from splits.manifest import Manifest
from splits.origin import recipe_of
from splits.release_reader import Release
from tables.errors import INTERRUPTED, PlaceBenchError
from tables.identity import order_key, parse_candidate_id
from tables.schemas import TEST_REPLICATES
from tables.sidecar import Sidecar, find_published, read_sidecar
from tables.store import join_tables, read_table, write_table
from tables.versions import library_versions
from tables.vocabulary import Split

TABLE = TEST_REPLICATES.name
_SCENES = "parameter.scenes"


def make_replicates(
    release: Release,
    path: Path,
    n_workers: int = 1,
    n_scenes: int = 0,
    n_replicates: int = N_REPLICATES,
    recipe_path: Path = DEFAULT_RECIPE,
    log: Callable[[str], Any] = print,
) -> Sidecar:
    """Publish table `test_replicates` of a release at a path; what is there and was made from the same stays, and may be of fewer scenes.

    Args:
        n_workers: worker processes; 0 stays in this process. The table does not depend on it.
        n_scenes: how many scenes of the test split, the first in the order of their hash, so that more hold the fewer; 0: all.
        n_replicates: executions of each candidate.
        recipe_path: the recipe that the release was made with.
        log: told how far it is.

    Raises:
        ReleaseError: a release of another recipe or other code.
        ReplicateError: as of `execute_replicates`.
        LockError: somebody else makes this table.
    """
    tier, recipe = release.manifest.tier, checked_recipe(release.manifest, recipe_path)
    made_from = replicates_made_from(release.manifest, recipe, n_replicates)
    scenes = _planned_scenes(release, recipe.seed)
    chosen = scenes[: n_scenes or None]
    with locked(path.with_name(f".{path.name}.lock"), f"{TABLE} of {tier}"):
        found, before = _published(path, made_from, tier)
        there = {parse_candidate_id(name).scene_id for name in before["candidate_id"].to_pylist()} if before is not None else set()
        missing = [scene_id for scene_id in chosen if scene_id not in there]
        if found is not None and not missing:
            log(f"{TABLE}: there already, {found.rows:,} rows of {len(there)} scenes")
            return found
        made = execute_replicates(release, recipe, kept_beside(path), missing, n_workers, n_replicates, log)
        table = join_tables(TEST_REPLICATES, [made] if before is None else [before, made])
        n = len(there.union(chosen))
        sidecar = write_table(TEST_REPLICATES, table, path, made_from | _of_scenes(n, len(scenes)), of=tier)
        kept_beside(path).unlink()
    log(f"{TABLE}: {sidecar.rows:,} rows of {n} of {len(scenes)} scenes, content hash {sidecar.content_hash[:12]}, {path}")
    return sidecar


def _planned_scenes(release: Release, seed: int) -> list[str]:
    """Scenes of the test split with a planned candidate, in the order of their hash."""
    return sorted(_planned(release)["scene_id"].unique(), key=lambda scene_id: order_key(seed, "replicated-scenes", scene_id))


def _planned(release: Release) -> pl.DataFrame:
    return release.candidates.filter(pl.col("y_plan") & (pl.col("split") == Split.TEST.value)).select(
        "candidate_id", pl.col("scene_id").cast(pl.String)
    )


def _published(path: Path, made_from: Mapping[str, str], tier: str) -> tuple[Sidecar, pa.Table] | tuple[None, None]:
    """The table at a path and its sidecar, if it was made from the same, of whatever scenes."""
    if not path.exists():
        return None, None
    of_scenes = {name: value for name, value in read_sidecar(path).made_from.items() if name == _SCENES}
    found = find_published(TEST_REPLICATES, path, dict(made_from) | of_scenes, tier)
    return (found, read_table(TEST_REPLICATES, path, verify=True)) if isinstance(found, Sidecar) else (None, None)


def execute_replicates(
    release: Release,
    recipe: Recipe,
    kept: Path,
    scene_ids: Collection[str] | None = None,
    n_workers: int = 1,
    n_replicates: int = N_REPLICATES,
    log: Callable[[str], Any] = print,
) -> pa.Table:
    """Rows of table `test_replicates` of a release.

    Args:
        recipe: of the release, as `checked_recipe` gives it.
        kept: file of the finished scenes; whoever has published the table removes it.
        scene_ids: of scenes of the test split; all of them without.
        n_workers, n_replicates, log: as of `make_replicates`.

    Raises:
        ReleaseError: a release without plans.
        ReplicateError: a scene that could not be executed; the others are kept for the next run.
    """
    planned = _planned(release)
    chosen = planned if scene_ids is None else planned.filter(pl.col("scene_id").is_in(scene_ids))
    start_s = time.perf_counter()

    def tell(done: int, total: int, core_s: float) -> None:
        log(f"{TABLE}: {done} of {total} scenes, {core_s:.0f} core-s, {time.perf_counter() - start_s:.0f} s")

    works = works_of(release.values, chosen["candidate_id"].to_list(), recipe, n_replicates)
    return replicate_table(works, kept, replicates_made_from(release.manifest, recipe, n_replicates), n_workers, tell)


def checked_recipe(manifest: Manifest, recipe_path: Path) -> Recipe:
    """The recipe that a release was made with; raises ReleaseError where file or code are not those that made its executions."""
    return recipe_of(manifest, recipe_path, [STAGE["execution_labels"]])


def kept_beside(path: Path) -> Path:
    """The file of finished scenes of a table that is being made."""
    return path.with_name(f".{TABLE}.unfinished.jsonl")


def replicates_made_from(manifest: Manifest, recipe: Recipe, n_replicates: int) -> dict[str, str]:
    """What decides the rows of `test_replicates` of a scene of a release."""
    stage = STAGE["execution_labels"]
    return {
        "release": manifest.release_hash,
        "recipe": recipe.hash_of(),
        "code": CODE_VERSION,
        f"code.{stage.name}": stage.code_version,
        "parameter.replicates": str(n_replicates),
        **{f"engine.{name}": version for name, version in library_versions(stage.engines).items()},
    }


def _of_scenes(n: int, n_all: int) -> dict[str, str]:
    """What a record says besides where a table is not of all scenes."""
    return {} if n == n_all else {_SCENES: str(n)}


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
    parser.add_argument("--scenes", type=int, default=0, metavar="N", help="scenes of the split, the first in hash order (all)")
    parser.add_argument("--out", type=Path, metavar="FILE", help=f"of the table; {TABLE}.parquet beside others by default")
    parser.add_argument("--recipe", type=Path, default=DEFAULT_RECIPE)
    chosen = parser.parse_args(arguments)
    try:
        release = Release.open(chosen.directory)
        path = chosen.out or default_path(chosen.directory, release.manifest.tier)
        make_replicates(release, path, chosen.workers, chosen.scenes, recipe_path=chosen.recipe)
    except PlaceBenchError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted; finished scenes are kept, the same command continues there", file=sys.stderr)
        return INTERRUPTED
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
