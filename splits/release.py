"""A release: tables, data card and manifest in one folder, written so that half a release never looks whole, and how it is verified.

python -m splits.release verify DIR
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import pyarrow as pa

from splits.data_card import render_card
from splits.errors import ReleaseError
from splits.leakage import find_leaks
from splits.manifest import (
    CARD,
    LICENCE,
    MANIFEST,
    NAME,
    FileEntry,
    Manifest,
    TableEntry,
    check_tier,
    check_tolerances,
    check_versions,
    files_of_table,
    read_manifest,
    release_hash_of,
)
from splits.pose_errors import find_pose_errors
from splits.provenance import LIBRARIES, check_provenance
from splits.release_folder import check_files, check_nothing_else, clear_folder, read_released_table
from splits.release_laws import broken_laws
from tables.identity import scenes_of_shard, shards_of_tier
from tables.schemas import ALL_SCHEMAS, SCHEMA_VERSION
from tables.store import file_sha256, write_table, write_text_atomically
from tables.versions import library_versions

REQUIRED_TABLES = (
    "objects",
    "grasp_pool",
    "scenes",
    "obstacles",
    "targets",
    "scene_points",
    "grasps",
    "candidates",
    "policy_features",
    "splits",
)


def write_release(
    tables: Mapping[str, pa.Table],
    directory: Path,
    tier: str,
    version: str,
    provenance: Mapping[str, str],
    *,
    position_tolerance_m: float,
    rotation_tolerance_rad: float,
) -> Manifest:
    """Check the tables, write them with the data card, and write the manifest last.

    An older release in the folder stops being one before the first file changes.

    Args:
        tables: by name, at least `REQUIRED_TABLES`.
        directory: the release folder; made if missing.
        tier: `mini`, `pilot` or `full`.
        version: version of the data, `major.minor.patch`, of no newer major than `DATA_VERSION`.
        provenance: what made it, at least `recipe_hash`, `catalogue_hash` and `git_commit` (see provenance).
        position_tolerance_m: tolerance the labels were judged by.
        rotation_tolerance_rad: tolerance the labels were judged by.

    Raises:
        ReleaseError: a table missing or unknown, a scene of another tier, a malformed version, tolerance or provenance, an
            impossible pose or label, a leak, or a folder that holds something else.
        SchemaError: a table that is not what its schema says.
    """
    check_versions(SCHEMA_VERSION, version)
    check_tolerances(position_tolerance_m, rotation_tolerance_rad)
    _check_contents(tables, tier, provenance)
    _check_values(tables, position_tolerance_m, rotation_tolerance_rad)
    if directory.exists() and not directory.is_dir():
        raise ReleaseError(f"{directory}: not a folder")
    directory.mkdir(parents=True, exist_ok=True)
    clear_folder(directory, tables.keys())
    entries = {name: _write(name, tables[name], directory, tier, provenance) for name in sorted(tables)}
    release_hash = release_hash_of(entries)
    facts = {
        **provenance,
        "tier": tier,
        "version": version,
        "licence": LICENCE,
        "schema_version": SCHEMA_VERSION,
        "release_hash": release_hash,
        "position_tolerance_m": f"{position_tolerance_m:g}",
        "rotation_tolerance_rad": f"{rotation_tolerance_rad:.4g}",
        "scenes_of_tier": str(sum(len(scenes_of_shard(shard)) for shard in shards_of_tier(tier))),
    }
    write_text_atomically(directory / CARD, render_card(tables, facts))
    files = [CARD, *(file for name in entries for file in files_of_table(name))]
    manifest = Manifest(
        name=NAME,
        tier=tier,
        version=version,
        licence=LICENCE,
        schema_version=SCHEMA_VERSION,
        release_hash=release_hash,
        position_tolerance_m=position_tolerance_m,
        rotation_tolerance_rad=rotation_tolerance_rad,
        tables=entries,
        files={file: FileEntry((directory / file).stat().st_size, file_sha256(directory / file)) for file in files},
        provenance=dict(provenance),
        libraries=library_versions(LIBRARIES),
    )
    write_text_atomically(directory / MANIFEST, manifest.to_text())
    return manifest


def verify_release(directory: Path) -> Manifest:
    """Check every file of a release against its manifest, every value against its schema, and the labels and splits against sense.

    Raises:
        ReleaseError: names the first file or rule that fails, what was found and what it must be.
    """
    manifest = read_manifest(directory)
    missing = [name for name in REQUIRED_TABLES if name not in manifest.tables]
    if missing:
        raise ReleaseError(f"{MANIFEST}: table {missing[0]!r} is not listed, must be one of {sorted(manifest.tables)}")
    check_nothing_else(directory, manifest)
    check_files(directory, manifest, hashes=True)
    tables = {name: read_released_table(directory, manifest, name, verify=True) for name in sorted(manifest.tables)}
    _check_contents(tables, manifest.tier, manifest.provenance)
    _check_values(tables, manifest.position_tolerance_m, manifest.rotation_tolerance_rad)
    return manifest


def release_errors(directory: Path) -> list[str]:
    """What `verify_release` finds wrong, as a list: empty for a sound release."""
    try:
        verify_release(directory)
    except ReleaseError as error:
        return [str(error)]
    return []


def _check_contents(tables: Mapping[str, pa.Table], tier: str, provenance: Mapping[str, str]) -> None:
    missing = [name for name in REQUIRED_TABLES if name not in tables]
    unknown = sorted(set(tables) - set(ALL_SCHEMAS))
    if missing or unknown:
        raise ReleaseError(f"tables: missing {missing}, unknown {unknown}, must both be empty")
    check_provenance(provenance)
    check_tier(tier)
    of_tier = {scene_id for shard in shards_of_tier(tier) for scene_id in scenes_of_shard(shard)}
    strangers = sorted(set(tables["scenes"]["scene_id"].to_pylist()) - of_tier)
    if strangers:
        raise ReleaseError(f"scenes: {strangers[0]} is not in tier {tier} ({len(strangers)} scenes are not, must be 0)")
    objects = set(tables["objects"]["object_id"].to_pylist())
    for name in ("scenes", "grasp_pool"):
        unknown_objects = sorted(set(tables[name]["object_id"].to_pylist()) - objects)
        if unknown_objects:
            raise ReleaseError(f"{name}: object {unknown_objects[0]} is not in objects ({len(unknown_objects)} are not, must be 0)")


def _check_values(tables: Mapping[str, pa.Table], position_tolerance_m: float, rotation_tolerance_rad: float) -> None:
    wrong_poses = find_pose_errors(tables)
    if wrong_poses:
        raise ReleaseError(f"poses: {len(wrong_poses)} columns wrong, must be 0; first {wrong_poses[0]}")
    errors = broken_laws(tables, position_tolerance_m=position_tolerance_m, rotation_tolerance_rad=rotation_tolerance_rad)
    if errors:
        raise ReleaseError(f"laws: {len(errors)} broken, must be 0; first {errors[0]}")
    leaks = find_leaks(tables)
    if leaks:
        raise ReleaseError(f"leakage: {len(leaks)} leaks, must be 0; first {leaks[0]}")


def _write(name: str, table: pa.Table, directory: Path, tier: str, provenance: Mapping[str, str]) -> TableEntry:
    file, _ = files_of_table(name)
    sidecar = write_table(ALL_SCHEMAS[name], table, directory / file, provenance, of=tier)
    return TableEntry(file, sidecar.rows, sidecar.content_hash)


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line: 0 where the release is sound, 1 where it is not."""
    parser = argparse.ArgumentParser(prog="python -m splits.release", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    verify = commands.add_parser("verify", help="check a release folder")
    verify.add_argument("directory", type=Path)
    chosen = parser.parse_args(arguments)
    try:
        manifest = verify_release(chosen.directory)
    except ReleaseError as error:
        print(f"not sound: {error}", file=sys.stderr)
        return 1
    rows = sum(entry.rows for entry in manifest.tables.values())
    print(
        f"sound: {manifest.name} {manifest.tier} {manifest.version}, {len(manifest.tables)} tables, {rows:,} rows, {manifest.release_hash}"
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
