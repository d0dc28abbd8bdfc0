"""Ways to damage a release folder: plainly, and as someone would who regenerates every checksum after an edit."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from splits.errors import ReleaseError
from splits.manifest import BY_SPLIT, MANIFEST, TableEntry, content_sha256, files_of_table, read_manifest, release_hash_of
from splits.release import main
from splits.release_reader import Release
from splits.release_texts import render_texts
from tables.store import content_hash
from tables.vocabulary import Split

TRAIN_FILE = files_of_table("candidates")[0]
PROVENANCE = {"recipe_hash": "0" * 64, "catalogue_hash": "c" * 64, "git_commit": "a1" * 20, "code.scenes": "2"}

Damage = Callable[[Path], object]


def copy_of(release: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(release, tmp_path / "copy", dirs_exist_ok=True))


def contents(directory: Path) -> dict[str, bytes]:
    """The bytes of every file by its path in the folder."""
    return {path.relative_to(directory).as_posix(): path.read_bytes() for path in sorted(directory.rglob("*")) if path.is_file()}


def read_json(path: Path) -> dict[str, Any]:
    content = json.loads(path.read_text())
    assert isinstance(content, dict)
    return content


def write_signed(directory: Path, content: dict[str, Any]) -> None:
    """Write a manifest with the hash that belongs to its content."""
    signed = {**content, "manifest_sha256": content_sha256(content)}
    (directory / MANIFEST).write_text(json.dumps(signed, indent=2, sort_keys=True) + "\n")


def answer(directory: Path) -> str:
    """What `verify` says of a damaged release: one line on standard error."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(["verify", str(directory)])
    assert (code, out.getvalue()) == (1, "")
    line = err.getvalue()
    assert line.startswith("not sound: ")
    assert line.endswith("\n")
    assert len(line.splitlines()) == 1
    assert len(line) < 1000, "a line that nobody reads"
    return line


def swapped(a: str, b: str) -> Damage:
    def damage(directory: Path) -> None:
        (directory / a).rename(directory / "aside")
        (directory / b).rename(directory / a)
        (directory / "aside").rename(directory / b)

    return damage


def edited(*path: str, to: object) -> Damage:
    """One field of the manifest changed, its hash left alone."""
    return lambda directory: (directory / MANIFEST).write_text(
        json.dumps(_with(read_json(directory / MANIFEST), path, to), indent=2, sort_keys=True) + "\n"
    )


def signed(*path: str, to: object) -> Damage:
    """One field of the manifest changed, its hash made to fit."""
    return lambda directory: write_signed(directory, _with(read_json(directory / MANIFEST), path, to))


def dropped(*path: str) -> Damage:
    """One field of the manifest taken away, its hash made to fit."""
    return signed(*path, to=...)


def listed(directory: Path, *names: str) -> None:
    """Make the manifest list these files with the size and SHA-256 that they have now."""
    content = read_json(directory / MANIFEST)
    for name in names:
        found = (directory / name).read_bytes()
        content["files"][name] = {"bytes": len(found), "sha256": hashlib.sha256(found).hexdigest()}
    write_signed(directory, content)


def rewritten(name: str, change: Callable[[bytes], bytes]) -> Damage:
    """The bytes of a file changed, nothing else."""
    return lambda directory: (directory / name).write_bytes(change((directory / name).read_bytes()))


def relisted(name: str, change: Callable[[bytes], bytes]) -> Damage:
    """The bytes of a file changed, the manifest made to fit."""

    def damage(directory: Path) -> None:
        rewritten(name, change)(directory)
        listed(directory, name)

    return damage


def republished(directory: Path, name: str, table: pa.Table | bytes) -> None:
    """Replace a table by any other, of its schema or not, or its first file by any bytes; checksums and release hash are made to fit.

    The texts stay as they were (see `rerendered`).
    """
    content, files = read_json(directory / MANIFEST), files_of_table(name)
    entry = content["tables"].setdefault(name, {"files": list(files), "rows": 0, "content_hash": "0" * 64})
    if isinstance(table, bytes):
        (directory / files[0]).write_bytes(table)
    else:
        for file, part in zip(files, _parts(directory, name, table), strict=True):
            pq.write_table(part, directory / file)
        entry |= {"rows": table.num_rows, "content_hash": content_hash(table)}
    _write_with_release_hash(directory, content)
    listed(directory, *files)


def rerendered(directory: Path) -> None:
    """Make the texts those of the tables that are there now, as far as these can be read; the manifest is made to fit."""
    with contextlib.suppress(ReleaseError):
        texts = render_texts(Release.open(directory).tables(), read_manifest(directory))
        for name, text in texts.items():
            (directory / name).write_text(text)
        listed(directory, *texts)


def _parts(directory: Path, name: str, table: pa.Table) -> list[pa.Table]:
    if name not in BY_SPLIT:
        return [table]
    split_of = {row["scene_id"]: row["split"] for row in pq.read_table(directory / "splits.parquet").to_pylist()}
    own = pa.array([split_of.get(scene_id) for scene_id in table["scene_id"].to_pylist()], pa.string())
    return [table.filter(pc.equal(own, split.value)) for split in Split]


def without(name: str) -> Damage:
    """A table gone from folder and manifest, everything else made to fit."""

    def damage(directory: Path) -> None:
        content = read_json(directory / MANIFEST)
        del content["tables"][name]
        for file in files_of_table(name):
            (directory / file).unlink()
            del content["files"][file]
        _write_with_release_hash(directory, content)

    return damage


def _write_with_release_hash(directory: Path, content: dict[str, Any]) -> None:
    content["release_hash"] = release_hash_of({key: TableEntry(**value) for key, value in content["tables"].items()})
    write_signed(directory, content)


def _with(content: dict[str, Any], path: tuple[str, ...], value: object) -> dict[str, Any]:
    *parents, last = path
    inner = content
    for name in parents:
        inner = inner[name]
    if value is ...:
        del inner[last]
    else:
        inner[last] = value
    return content
