"""A release: tables, data card and manifest in one folder, written so that half a release never looks whole, and the check of it.

python -m splits.release verify DIR
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import pyarrow as pa

from splits.data_card import render_card
from splits.label_errors import find_label_errors
from splits.leakage import find_leaks
from splits.manifest import LIBRARIES, MANIFEST, Manifest, ReleaseError, TableEntry, read_manifest, release_hash_of
from tables.columns import SchemaError
from tables.identity import scenes_of_shard, shards_of_tier
from tables.schemas import ALL_SCHEMAS, SCHEMA_VERSION
from tables.store import StoreError, content_hash, file_sha256, read_table, sidecar_path, write_table, write_text_atomically
from tables.versions import library_versions

LICENCE = "CC-BY-4.0"
CARD = "README.md"

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
        version: version of the data, `major.minor.patch`.
        provenance: what made it, at least `recipe_hash`.
        position_tolerance_m: tolerance the labels were judged by.
        rotation_tolerance_rad: tolerance the labels were judged by.

    Raises:
        ReleaseError: a table missing or unknown, a scene of another tier, no recipe hash, an impossible label, a leak.
        SchemaError: a table that is not what its schema says.
    """
    _check_contents(tables, tier, provenance)
    _check_labels_and_leaks(tables, position_tolerance_m, rotation_tolerance_rad)
    directory.mkdir(parents=True, exist_ok=True)
    (directory / MANIFEST).unlink(missing_ok=True)
    for stale in sorted(directory.glob("*.parquet")):
        if stale.stem not in tables:
            sidecar_path(stale).unlink(missing_ok=True)
            stale.unlink()
    entries = {name: _write(name, tables[name], directory, provenance) for name in sorted(tables)}
    release_hash = release_hash_of(entries)
    facts = {
        "tier": tier,
        "version": version,
        "licence": LICENCE,
        "schema_version": SCHEMA_VERSION,
        "release_hash": release_hash,
        "position_tolerance_m": f"{position_tolerance_m:g}",
        "rotation_tolerance_rad": f"{rotation_tolerance_rad:.4g}",
        "scenes_of_tier": str(sum(len(scenes_of_shard(shard)) for shard in shards_of_tier(tier))),
        **provenance,
    }
    write_text_atomically(directory / CARD, render_card(tables, facts))
    manifest = Manifest(
        name="placebench",
        tier=tier,
        version=version,
        licence=LICENCE,
        schema_version=SCHEMA_VERSION,
        release_hash=release_hash,
        card_sha256=file_sha256(directory / CARD),
        position_tolerance_m=position_tolerance_m,
        rotation_tolerance_rad=rotation_tolerance_rad,
        tables=entries,
        provenance=dict(provenance),
        libraries=library_versions(LIBRARIES),
    )
    write_text_atomically(directory / MANIFEST, json.dumps(asdict(manifest), indent=2, sort_keys=True) + "\n")
    return manifest


def verify_release(directory: Path) -> Manifest:
    """Check every file of a release against its manifest, every value against its schema, and the labels and splits against sense.

    Raises:
        ReleaseError: names the first file or rule that fails, what was found and what it must be.
    """
    manifest = read_manifest(directory)
    if manifest.schema_version != SCHEMA_VERSION:
        raise ReleaseError(f"{MANIFEST}: schema version {manifest.schema_version}, this code reads {SCHEMA_VERSION}")
    missing = [name for name in REQUIRED_TABLES if name not in manifest.tables]
    if missing:
        raise ReleaseError(f"{MANIFEST}: table {missing[0]!r} is not listed, must be one of {sorted(manifest.tables)}")
    listed = {entry.file for entry in manifest.tables.values()}
    unlisted = sorted(path.name for path in directory.glob("*.parquet") if path.name not in listed)
    if unlisted:
        raise ReleaseError(f"{unlisted[0]}: not in the manifest of {len(listed)} tables")
    if release_hash_of(manifest.tables) != manifest.release_hash:
        raise ReleaseError(f"{MANIFEST}: release hash {manifest.release_hash[:12]}, tables give {release_hash_of(manifest.tables)[:12]}")
    _check_sha256(directory / CARD, manifest.card_sha256)
    tables = {name: _read(name, entry, directory) for name, entry in sorted(manifest.tables.items())}
    _check_contents(tables, manifest.tier, manifest.provenance)
    _check_labels_and_leaks(tables, manifest.position_tolerance_m, manifest.rotation_tolerance_rad)
    return manifest


def _check_contents(tables: Mapping[str, pa.Table], tier: str, provenance: Mapping[str, str]) -> None:
    missing = [name for name in REQUIRED_TABLES if name not in tables]
    unknown = sorted(set(tables) - set(ALL_SCHEMAS))
    if missing or unknown:
        raise ReleaseError(f"tables: missing {missing}, unknown {unknown}, must both be empty")
    if not provenance.get("recipe_hash"):
        raise ReleaseError(f"provenance: recipe_hash is missing, given {sorted(provenance)}")
    of_tier = {scene_id for shard in shards_of_tier(tier) for scene_id in scenes_of_shard(shard)}
    strangers = sorted(set(tables["scenes"]["scene_id"].to_pylist()) - of_tier)
    if strangers:
        raise ReleaseError(f"scenes: {strangers[0]} is not in tier {tier} ({len(strangers)} scenes are not, must be 0)")


def _check_labels_and_leaks(tables: Mapping[str, pa.Table], position_tolerance_m: float, rotation_tolerance_rad: float) -> None:
    errors = find_label_errors(
        tables["candidates"],
        tables["grasps"],
        tables["targets"],
        position_tolerance_m=position_tolerance_m,
        rotation_tolerance_rad=rotation_tolerance_rad,
    )
    if errors:
        raise ReleaseError(f"labels: {len(errors)} rules broken, must be 0; first {errors[0]}")
    leaks = find_leaks(tables)
    if leaks:
        raise ReleaseError(f"leakage: {len(leaks)} leaks, must be 0; first {leaks[0]}")


def _write(name: str, table: pa.Table, directory: Path, provenance: Mapping[str, str]) -> TableEntry:
    sidecar = write_table(ALL_SCHEMAS[name], table, directory / f"{name}.parquet", provenance)
    return TableEntry(f"{name}.parquet", sidecar.rows, sidecar.sha256, sidecar.content_hash)


def _read(name: str, entry: TableEntry, directory: Path) -> pa.Table:
    path = directory / entry.file
    if name not in ALL_SCHEMAS:
        raise ReleaseError(f"{MANIFEST}: table {name!r} is unknown")
    _check_sha256(path, entry.sha256)
    try:
        table = read_table(ALL_SCHEMAS[name], path, verify=True)
    except (StoreError, SchemaError, pa.ArrowInvalid, OSError) as error:
        raise ReleaseError(f"{path.name}: {error}") from error
    if table.num_rows != entry.rows:
        raise ReleaseError(f"{path.name}: {table.num_rows} rows, manifest says {entry.rows}")
    if content_hash(table) != entry.content_hash:
        raise ReleaseError(f"{path.name}: content hash {content_hash(table)[:12]}, manifest says {entry.content_hash[:12]}")
    return table


def _check_sha256(path: Path, expected: str) -> None:
    if not path.exists():
        raise ReleaseError(f"{path.name}: missing")
    found = file_sha256(path)
    if found != expected:
        raise ReleaseError(f"{path.name}: SHA-256 {found[:12]}, manifest says {expected[:12]}")


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


__all__ = [
    "Manifest",
    "ReleaseError",
    "TableEntry",
    "find_label_errors",
    "find_leaks",
    "main",
    "read_manifest",
    "verify_release",
    "write_release",
]

if __name__ == "__main__":
    raise SystemExit(main())
