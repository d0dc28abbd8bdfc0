"""A release: tables, data card and manifest in one folder, written so that half a release never looks whole, and how it is verified.

python -m splits.release verify DIR [--light]
python -m splits.release light WHOLE LIGHT
python -m splits.release render DIR
python -m splits.release diff A B
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import pyarrow as pa

from splits.diff_text import EXIT_STATUS, print_diff
from splits.errors import ReleaseError
from splits.leakage import find_leaks
from splits.manifest import (
    LICENCE,
    MANIFEST,
    NAME,
    TEXTS,
    FileEntry,
    Manifest,
    TableEntry,
    check_tier,
    check_versions,
    files_of_table,
    read_manifest,
    release_hash_of,
)
from splits.pose_errors import find_pose_errors
from splits.provenance import LIBRARIES, check_provenance, layout_of_release
from splits.release_folder import (
    check_files,
    check_nothing_else,
    check_parts,
    clear_folder,
    left_out,
    parts_of_table,
    read_released_table,
)
from splits.release_laws import broken_laws
from splits.release_texts import check_texts, render_texts
from tables.schemas import ALL_SCHEMAS, HEAVY_TABLES, SCHEMA_VERSION
from tables.store import check_table, content_hash, file_sha256, write_bytes_atomically, write_parquet, write_text_atomically
from tables.tolerances import Tolerances
from tables.versions import library_versions

_UNWRITTEN = FileEntry(0, "0" * 64)  # stands for a text until it is written: texts are made from all the rest of the manifest

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
    tolerances: Tolerances,
) -> Manifest:
    """Check the tables, write them with the texts that they make, and write the manifest last.

    An older release in the folder stops being one before the first file changes.

    Args:
        tables: by name, at least `REQUIRED_TABLES`.
        directory: the release folder; made if missing.
        tier: `mini`, `pilot` or `full`.
        version: version of the data, `major.minor.patch`, of no newer major than `DATA_VERSION`.
        provenance: what made it, at least `recipe_hash`, `catalogue_hash` and `git_commit` (see provenance).
        tolerances: what the labels were judged by.

    Raises:
        ReleaseError: a table missing or unknown, a scene of another tier, a malformed version or provenance, an impossible pose or
            label, a leak, or a folder that holds something else.
        SchemaError: a table that is not what its schema says.
    """
    check_versions(SCHEMA_VERSION, version)
    _check_contents(tables, tier, provenance)
    _check_values(tables, tolerances)
    if directory.exists() and not directory.is_dir():
        raise ReleaseError(f"{directory}: not a folder")
    directory.mkdir(parents=True, exist_ok=True)
    clear_folder(directory, tables.keys())
    entries = {name: _write(name, tables, directory) for name in sorted(tables)}
    files = [file for name in entries for file in files_of_table(name)]
    draft = Manifest(
        name=NAME,
        tier=tier,
        version=version,
        licence=LICENCE,
        schema_version=SCHEMA_VERSION,
        release_hash=release_hash_of(entries),
        tolerances=tolerances,
        tables=entries,
        files={**_listed(directory, files), **dict.fromkeys(TEXTS, _UNWRITTEN)},
        provenance=dict(provenance),
        libraries=library_versions(LIBRARIES),
    )
    return _write_texts(directory, tables, draft)


def render_release(directory: Path) -> Manifest:
    """Make the texts of a release again and list them in its manifest: after a DOI, or with code that has other words for the same data.

    Args:
        directory: a release, whole or light; its tables stay as they are, and its texts may be anything.

    Raises:
        ReleaseError: a table that is not what the manifest says.
    """
    manifest = read_manifest(directory)
    absent = left_out(directory, manifest)
    there = sorted(manifest.tables.keys() - set(absent))
    tables = {name: read_released_table(directory, manifest, name, verify=True) for name in there}
    return _write_texts(directory, tables, manifest)


def verify_release(directory: Path, *, may_be_light: bool = False) -> Manifest:
    """Check every file of a release against its manifest, every value against its schema, labels and splits against sense, texts last.

    Args:
        may_be_light: heavy tables may be missing (see `release_folder.left_out`); laws about them are not asked then.

    Raises:
        ReleaseError: names the first file or rule that fails, what was found and what it must be.
    """
    manifest = read_manifest(directory)
    missing = [name for name in REQUIRED_TABLES if name not in manifest.tables]
    if missing:
        raise ReleaseError(f"{MANIFEST}: table {missing[0]!r} is not listed, must be one of {sorted(manifest.tables)}")
    check_nothing_else(directory, manifest)
    absent = left_out(directory, manifest)
    if absent and not may_be_light:
        raise ReleaseError(
            f"{files_of_table(absent[0])[0]}: missing; a light release, which leaves out {', '.join(absent)}, is verified with --light"
        )
    check_files(directory, manifest, hashes=True, without=absent)
    there = sorted(manifest.tables.keys() - set(absent))
    tables = {name: read_released_table(directory, manifest, name, verify=True) for name in there}
    _check_contents(tables, manifest.tier, manifest.provenance, without=absent)
    _check_values(tables, manifest.tolerances)
    check_parts(directory, tables)
    check_texts(directory, tables, manifest)
    return manifest


def release_errors(directory: Path) -> list[str]:
    """What `verify_release` finds wrong, as a list: empty for a sound release."""
    try:
        verify_release(directory)
    except ReleaseError as error:
        return [str(error)]
    return []


def make_light(whole: Path, light: Path) -> Manifest:
    """Copy a release without its heavy tables; the manifest, copied last, still lists them with their hashes.

    Args:
        whole: a release folder, every file of which must be what its manifest says; it may leave out heavy tables itself.
        light: another folder; made if missing. An older release in it is replaced.

    Raises:
        ReleaseError: a damaged release, the same folder twice, or a folder that holds something else.
    """
    manifest = read_manifest(whole)
    check_files(whole, manifest, hashes=True, without=left_out(whole, manifest))
    inner, outer = sorted((whole.resolve(), light.resolve()), key=lambda path: -len(path.parts))
    if inner.is_relative_to(outer):
        raise ReleaseError(f"{light}: must be neither the release itself nor in it nor around it: {whole}")
    if light.exists() and not light.is_dir():
        raise ReleaseError(f"{light}: not a folder")
    light.mkdir(parents=True, exist_ok=True)
    kept = manifest.tables.keys() - HEAVY_TABLES.keys()
    clear_folder(light, kept)
    for file in [*TEXTS, *(file for name in sorted(kept) for file in files_of_table(name))]:
        write_bytes_atomically(light / file, (whole / file).read_bytes())
    write_text_atomically(light / MANIFEST, manifest.to_text())
    return manifest


def _check_contents(tables: Mapping[str, pa.Table], tier: str, provenance: Mapping[str, str], *, without: Collection[str] = ()) -> None:
    missing = [name for name in REQUIRED_TABLES if name not in tables and name not in without]
    unknown = sorted(set(tables) - set(ALL_SCHEMAS))
    if missing or unknown:
        raise ReleaseError(f"tables: missing {missing}, unknown {unknown}, must both be empty")
    check_provenance(provenance)
    check_tier(tier)
    of_tier = set(layout_of_release(provenance, tables["objects"].num_rows).scenes_of_tier(tier))
    strangers = sorted(set(tables["scenes"]["scene_id"].to_pylist()) - of_tier)
    if strangers:
        raise ReleaseError(f"scenes: {strangers[0]} is not in tier {tier} ({len(strangers)} scenes are not, must be 0)")
    objects = set(tables["objects"]["object_id"].to_pylist())
    for name in ("scenes", "grasp_pool"):
        unknown_objects = sorted(set(tables[name]["object_id"].to_pylist()) - objects)
        if unknown_objects:
            raise ReleaseError(f"{name}: object {unknown_objects[0]} is not in objects ({len(unknown_objects)} are not, must be 0)")
    _check_attempts(tables)


def _check_attempts(tables: Mapping[str, pa.Table]) -> None:
    """Raise ReleaseError where repeats are of a candidate that the release does not hold."""
    if "attempts" in tables:
        strange = sorted(set(tables["attempts"]["candidate_id"].to_pylist()) - set(tables["candidates"]["candidate_id"].to_pylist()))
        if strange:
            raise ReleaseError(f"attempts: {strange[0]} is no candidate ({len(strange)} are none, must be 0)")


def _check_values(tables: Mapping[str, pa.Table], tolerances: Tolerances) -> None:
    wrong_poses = find_pose_errors(tables)
    if wrong_poses:
        raise ReleaseError(f"poses: {len(wrong_poses)} columns wrong, must be 0; first {wrong_poses[0]}")
    errors = broken_laws(tables, tolerances)
    if errors:
        raise ReleaseError(f"laws: {len(errors)} broken, must be 0; first {errors[0]}")
    leaks = find_leaks(tables)
    if leaks:
        raise ReleaseError(f"leakage: {len(leaks)} leaks, must be 0; first {leaks[0]}")


def _write_texts(directory: Path, tables: Mapping[str, pa.Table], draft: Manifest) -> Manifest:
    """Write the texts, then the manifest that lists them."""
    for name, text in render_texts(tables, draft).items():
        write_text_atomically(directory / name, text)
    manifest = replace(draft, files={**draft.files, **_listed(directory, TEXTS)})
    write_text_atomically(directory / MANIFEST, manifest.to_text())
    return manifest


def _write(name: str, tables: Mapping[str, pa.Table], directory: Path) -> TableEntry:
    check_table(ALL_SCHEMAS[name], tables[name])
    files = files_of_table(name)
    for file, part in zip(files, parts_of_table(name, tables), strict=True):
        # Heavy tables are made again by later code, which must come to the same bytes, whatever words it has for them.
        write_parquet(ALL_SCHEMAS[name], part, directory / file, described=name not in HEAVY_TABLES)
    return TableEntry(list(files), tables[name].num_rows, content_hash(tables[name]))


def _listed(directory: Path, files: Sequence[str]) -> dict[str, FileEntry]:
    return {file: FileEntry((directory / file).stat().st_size, file_sha256(directory / file)) for file in files}


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line: 0 where the release is sound or was copied, 1 where it is not sound; of `diff` see `diff_text.EXIT_STATUS`."""
    parser = argparse.ArgumentParser(prog="python -m splits.release", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    verify = commands.add_parser("verify", help="check a release folder")
    verify.add_argument("directory", type=Path)
    verify.add_argument("--light", action="store_true", help=f"heavy tables may be missing: {', '.join(HEAVY_TABLES)}")
    light = commands.add_parser("light", help=f"copy a release without its heavy tables: {', '.join(HEAVY_TABLES)}")
    light.add_argument("whole", type=Path, help="the release folder")
    light.add_argument("directory", type=Path, help="the folder of the light one")
    render = commands.add_parser("render", help="make card, datasheet and Croissant metadata again; tables stay as they are")
    render.add_argument("directory", type=Path, help="a release folder, whole or light")
    diff = commands.add_parser("diff", help="say what changed from one release to another, whole or light", epilog=EXIT_STATUS)
    diff.add_argument("a", type=Path, help="the release folder of before")
    diff.add_argument("b", type=Path, help="the one of after")
    chosen = parser.parse_args(arguments)
    if chosen.command == "diff":
        return print_diff(chosen.a, chosen.b)
    try:
        if chosen.command == "light":
            make_light(chosen.whole, chosen.directory)
        elif chosen.command == "render":
            render_release(chosen.directory)
        manifest = verify_release(chosen.directory, may_be_light=chosen.command != "verify" or chosen.light)
    except ReleaseError as error:
        print(f"not sound: {error}", file=sys.stderr)
        return 1
    absent = left_out(chosen.directory, manifest)
    rows = sum(entry.rows for name, entry in manifest.tables.items() if name not in absent)
    megabytes = sum(path.stat().st_size for path in chosen.directory.rglob("*") if path.is_file()) / 1e6
    about = f"{manifest.name} {manifest.tier} {manifest.version}"
    print(f"sound: {about}, {len(manifest.tables) - len(absent)} tables, {rows:,} rows, {megabytes:.1f} MB, {manifest.release_hash}")
    if absent:
        print(f"light: without {', '.join(absent)}")
    for target in (target for name in absent if (target := HEAVY_TABLES[name]) is not None):
        print(f"python -m splits.rebuild {chosen.directory} {target}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
