"""Makes a heavy table of a light release again, from what the release holds and the code that made it.

python -m splits.rebuild DIR points|plans|rejections [--workers N]

Points are rendered from the scenes; a plan is searched again for every candidate that has one; rejections are the draws that scene
sampling did not keep. Work goes shard by shard through the same stages that made the release, into a folder beside it, so that a killed
rebuild goes on where it was. The release gets the table only if all its values have the hash that its manifest lists.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from objects.object_model import object_models_from_tables
from pipelines.recipe import DEFAULT_RECIPE, Recipe
from pipelines.running.data_root import DataRoot
from pipelines.running.shard_runner import ShardInputs, run_stage
from pipelines.stage import Stage
from pipelines.stages import STAGE
from splits.errors import ReleaseError
from splits.manifest import Manifest, files_of_table
from splits.origin import recipe_of
from splits.release_laws import allocations_in, stage_tables
from splits.release_reader import Release
from tables.errors import INTERRUPTED, PlaceBenchError
from tables.files import file_sha256, write_bytes_atomically
from tables.schemas import ALL_SCHEMAS, HEAVY_TABLES, OBJECT_TABLES
from tables.sidecar import Sidecar, find_published
from tables.store import content_hash, read_tables, write_parquet, write_table
from tables.versions import library_versions

_STAGE_OF = {"plans": STAGE["planning_labels"], "scene_points": STAGE["scene_points"], "scene_attempts": STAGE["scenes"]}
TARGETS = {target: table for table, target in HEAVY_TABLES.items() if target is not None}


def rebuild(directory: Path, name: str, n_workers: int = 1, recipe_path: Path = DEFAULT_RECIPE, log: Callable[[str], Any] = print) -> None:
    """Put a heavy table back into a release folder, or leave it where it is.

    Args:
        directory: a light release; the tables that are there must be what the manifest says.
        name: `plans`, `scene_points` or `scene_attempts`.
        n_workers: worker processes; 0 stays in this process. The result does not depend on it.
        recipe_path: the recipe that the release was made with.
        log: told how far it is, one line a shard.

    Raises:
        ReleaseError: a damaged release, one of another recipe or of other code, a table that the release does not list, or a table that
            did not come out as it was: nothing is changed then.
        StageError: scenes that could not be made again; the others are kept for the next run.
    """
    release = Release.open(directory, verify=True)
    if name not in release.left_out:
        release.table(name)  # says so where the release never had one
        log(f"{name}: there already")
        return
    stage = _STAGE_OF[name]
    recipe = recipe_of(release.manifest, recipe_path, [stage])
    root = DataRoot(directory.resolve().with_name(f".{directory.resolve().name}.rebuild"))
    shards = make_shards(release, stage, _upstream(release, stage), recipe, root, n_workers, log)
    made = {s.name: read_tables(s, [root.shard_table(shard, s.name) for shard in shards], of=shards) for s in stage.outputs}
    try:
        _check_outcome(release, name, made)
        _publish(release, name, made[name], root)
    finally:
        shutil.rmtree(root.path)  # also what came out otherwise: it would only be found wrong again
    log(f"{name}: {made[name].num_rows:,} rows, content hash {release.manifest.tables[name].content_hash[:12]} as in the manifest")


def make_shards(
    release: Release,
    stage: Stage,
    upstream: Mapping[str, pa.Table],
    recipe: Recipe,
    root: DataRoot,
    n_workers: int,
    log: Callable[[str], Any],
    scene_ids: Collection[str] | None = None,
) -> list[str]:
    """Run a stage on every shard that the release has scenes of, or has some scenes of; returns their keys.

    Args:
        upstream: the tables that the stage reads, by name.
        root: where they are laid out shard by shard, and what the stage makes is put.
        scene_ids: the scenes; all without them.

    Raises:
        StageError: scenes that could not be made; the others are kept for the next run.
    """
    allocations = {
        allocation.scene_id: allocation
        for allocation in allocations_in(release.table("scenes"))
        if scene_ids is None or allocation.scene_id in scene_ids
    }
    object_models = object_models_from_tables(*(release.table(name) for name in OBJECT_TABLES))
    object_hashes = {name: release.manifest.tables[name].content_hash for name in OBJECT_TABLES}
    layout = release.manifest.layout
    shards = sorted({layout.shard_of_scene(scene_id) for scene_id in allocations})
    start, n_made = time.perf_counter(), 0
    for k, shard in enumerate(shards, 1):
        own = [scene_id for scene_id in layout.scenes_of_shard(shard) if scene_id in allocations]
        for name, table in upstream.items():
            _write_upstream(root, shard, name, rows_of_scenes(table, own), release.manifest)
        inputs = ShardInputs(recipe, object_models, [allocations[scene_id] for scene_id in own], object_hashes)
        report = run_stage(stage, shard, root, inputs, n_workers, log=log)
        n_made += not report.is_reused
        spent_s = time.perf_counter() - start
        left_s = spent_s / max(n_made, 1) * (len(shards) - k)
        done = "kept" if report.is_reused else f"made in {report.core_s:.1f} core-s"
        log(f"{shard}: {done}, {k} of {len(shards)} shards in {spent_s:.0f} s, about {left_s:.0f} s left")
    return shards


def _upstream(release: Release, stage: Stage) -> dict[str, pa.Table]:
    """The tables that the stage reads. Of candidates only those that have a plan: of the others nothing is stored."""
    if not stage.inputs:
        return {}
    parts = {name: release.table(name) for name in ("scenes", "obstacles", "targets")}
    if "candidate_pairs" in {schema.name for schema in stage.inputs}:
        parts |= stage_tables(_planned(release))
    return {schema.name: parts[schema.name] for schema in stage.inputs}


def _planned(release: Release) -> dict[str, pa.Table]:
    candidates = release.table("candidates")
    return {"grasps": release.table("grasps"), "candidates": candidates.filter(candidates["y_plan"])}


def rows_of_scenes(table: pa.Table, scene_ids: Collection[str]) -> pa.Table:
    """The rows of some scenes of a table with a column `scene_id`."""
    return table.filter(pc.is_in(table["scene_id"].cast(pa.string()), pa.array(sorted(scene_ids), pa.string())))


def _write_upstream(root: DataRoot, shard: str, name: str, table: pa.Table, manifest: Manifest) -> None:
    made_from, path = {"release": manifest.release_hash}, root.shard_table(shard, name)
    if not isinstance(find_published(ALL_SCHEMAS[name], path, made_from, shard), Sidecar):
        write_table(ALL_SCHEMAS[name], table, path, made_from, of=shard)


def _check_outcome(release: Release, name: str, made: Mapping[str, pa.Table]) -> None:
    """Raise ReleaseError where the table, or another that the stage makes with it, is not what the release says."""
    stored = {"planning_labels": lambda: stage_tables(_planned(release))["planning_labels"]}
    for other in made.keys() - {name}:
        # Where these differ, the row to look at has a name.
        expected = stored.get(other, lambda other=other: release.table(other))()
        if content_hash(made[other]) != content_hash(expected):
            raise ReleaseError(
                f"{other} made again with {name}: {first_difference(made[other], expected)}; nothing was put into the release"
            )
    entry, found = release.manifest.tables[name], content_hash(made[name])
    if found != entry.content_hash:
        raise ReleaseError(
            f"{name} made again: content hash {found[:12]} of {made[name].num_rows} rows, manifest says {entry.content_hash[:12]}"
            f" of {entry.rows}{other_engines(release.manifest, _STAGE_OF[name].engines)}; nothing was put into the release"
        )


def other_engines(manifest: Manifest, engines: Iterable[str]) -> str:
    """Engines of another version than those that made the release: the first thing to suspect."""
    installed = library_versions(engines)
    other = [f"{name} {manifest.libraries.get(name)}, here {own}" for name, own in installed.items() if manifest.libraries.get(name) != own]
    return f" (made with {'; '.join(other)})" if other else ""


def first_difference(made: pa.Table, expected: pa.Table) -> str:
    """In what two tables that should be equal differ first, in words."""
    if made.num_rows != expected.num_rows:
        return f"{made.num_rows} rows, the release holds {expected.num_rows}"
    row, found, stored = next((k, a, b) for k, (a, b) in enumerate(zip(made.to_pylist(), expected.to_pylist(), strict=True)) if a != b)
    column = next(key for key in stored if found[key] != stored[key])
    return f"row {row} ({next(iter(stored.values()))}) has {column} {found[column]!r}, the release holds {stored[column]!r}"


def _publish(release: Release, name: str, table: pa.Table, root: DataRoot) -> None:
    """Write the file aside and move it in if it is, byte for byte, the one that the manifest lists."""
    manifest, (file,) = release.manifest, files_of_table(name)
    write_parquet(ALL_SCHEMAS[name], table, root.path / file, described=False)
    found, expected = file_sha256(root.path / file), manifest.files[file].sha256
    if found != expected:
        pyarrow = manifest.libraries.get("pyarrow", "unknown")
        raise ReleaseError(
            f"{file}: same values, but SHA-256 {found[:12]}, manifest says {expected[:12]}: written by pyarrow {pa.__version__},"
            f" the release by {pyarrow}; nothing was put into the release"
        )
    write_bytes_atomically(release.directory / file, (root.path / file).read_bytes())


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line: 0 where the table is there, 1 where it could not be made again as it was, 130 where it was interrupted."""
    parser = argparse.ArgumentParser(prog="python -m splits.rebuild", description=__doc__)
    parser.add_argument("directory", type=Path, help="a light release")
    parser.add_argument("target", choices=sorted(TARGETS), help=", ".join(f"{target}: table {table}" for target, table in TARGETS.items()))
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="worker processes; the result does not depend on it")
    parser.add_argument("--recipe", type=Path, default=DEFAULT_RECIPE)
    chosen = parser.parse_args(arguments)
    try:
        rebuild(chosen.directory, TARGETS[chosen.target], chosen.workers, chosen.recipe)
    except PlaceBenchError as error:
        print(f"not rebuilt: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted; finished scenes are kept, the same command continues there", file=sys.stderr)
        return INTERRUPTED
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
