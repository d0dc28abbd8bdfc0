"""The manifest of a release: what it says and how it is read; writing and checking a release is release's."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

MANIFEST = "manifest.json"

# Measured once, different on every machine: shipped and checksummed, but no part of what the release hash identifies.
MEASUREMENTS = ("timings",)

# Python and every package whose version may change a label or the bytes of a table.
LIBRARIES = (
    "python",
    "coacd",
    "coal",
    "frankik",
    "manifold3d",
    "numpy",
    "ompl",
    "pin",
    "polars",
    "pyarrow",
    "pybullet",
    "ruckig",
    "scipy",
    "trimesh",
)


class ReleaseError(RuntimeError):
    """A release that is incomplete, changed, or wrong; names the file or rule, the value and the bound."""


@dataclass(frozen=True, slots=True)
class TableEntry:
    """One table of a release."""

    file: str
    rows: int
    sha256: str
    content_hash: str


@dataclass(frozen=True, slots=True)
class Manifest:
    """What a release is: `release_hash` identifies its tables' values and nothing else."""

    name: str
    tier: str
    version: str
    licence: str
    schema_version: str
    release_hash: str
    card_sha256: str
    position_tolerance_m: float
    rotation_tolerance_rad: float
    tables: dict[str, TableEntry]
    provenance: dict[str, str]
    libraries: dict[str, str]


def read_manifest(directory: Path) -> Manifest:
    """The manifest of a release; raises ReleaseError where there is none or it cannot be read."""
    path = directory / MANIFEST
    if not path.exists():
        raise ReleaseError(f"{path}: missing, so this is no complete release")
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        content["tables"] = {name: TableEntry(**entry) for name, entry in content["tables"].items()}
        return Manifest(**content)
    except (UnicodeDecodeError, json.JSONDecodeError, TypeError, KeyError, AttributeError) as error:
        raise ReleaseError(f"{path}: cannot be read as a manifest: {error}") from error


def release_hash_of(entries: Mapping[str, TableEntry]) -> str:
    """SHA-256 over the content hashes of the tables, without measurements."""
    lines = [f"{name} {entry.content_hash}\n" for name, entry in sorted(entries.items()) if name not in MEASUREMENTS]
    return hashlib.sha256("".join(lines).encode()).hexdigest()
