"""What made a release: the commit of the code, the versions of the libraries, and the facts that every release must state.

A release that is not the benchmark's also states `catalogue` and `recipe`, the names of the two files, and `allocation`: from it, and from
how many objects there are, follows which scenes and shards its dataset has.

The hashes of recipe and catalogue are computed where they are parsed, in pipelines/recipe.py and objects/catalogue.py.
"""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Mapping
from pathlib import Path

from splits.errors import ReleaseError, shown
from tables.identity import IdentityError
from tables.layout import INTERLEAVED, Layout, layout_of
from tables.vocabulary import Allocation

PACKAGE_ROOT = Path(__file__).resolve().parent.parent
UNKNOWN_COMMIT = "unknown"

OWN_KEYS = ("catalogue", "recipe", "allocation")

_SHA256 = re.compile(r"[0-9a-f]{64}")
_COMMIT = re.compile(r"[0-9a-f]{40}")
_STATED_COMMIT = re.compile(rf"{_COMMIT.pattern}(-dirty)?|{UNKNOWN_COMMIT}")
_REQUIRED = {
    "recipe_hash": (_SHA256, "64 hex digits"),
    "catalogue_hash": (_SHA256, "64 hex digits"),
    "git_commit": (
        _STATED_COMMIT,
        f"40 hex digits, -dirty after them or not, or {UNKNOWN_COMMIT}",
    ),
}

# Python and every package whose version may change a label or the bytes of a table.
LIBRARIES = (
    "python",
    "coacd",
    "coal",
    "frankik",
    "manifold3d",
    "mujoco-core",
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

# A git hook runs its commands with these set; they would point git at the repository of the hook.
_OF_ANOTHER_REPOSITORY = ("GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE", "GIT_COMMON_DIR", "GIT_PREFIX")
# `git status` reads the whole work tree; a network file system that takes longer is as good as no repository.
_TIMEOUT_S = 60.0


def check_provenance(provenance: Mapping[str, str]) -> None:
    """Raise ReleaseError where a fact that every release must state is missing or malformed."""
    for name, (pattern, expected) in _REQUIRED.items():
        if name not in provenance:
            raise ReleaseError(f"provenance: {name} is missing, must be {expected}; given are {sorted(provenance)}")
        if not pattern.fullmatch(provenance[name]):
            raise ReleaseError(f"provenance: {name} {shown(provenance[name])}, must be {expected}")
    _check_own(provenance)


def own_provenance(catalogue: str, recipe: str, allocation: Allocation) -> dict[str, str]:
    """What a release of one's own states beside the hashes: names of the two files, without folders, and the allocation."""
    return dict(zip(OWN_KEYS, (catalogue, recipe, allocation.value), strict=True))


def is_own(provenance: Mapping[str, str]) -> bool:
    """Whether a release is not the benchmark's."""
    return any(key in provenance for key in OWN_KEYS)


def _check_own(provenance: Mapping[str, str]) -> None:
    """Raise ReleaseError where a release states some of the three facts, or an allocation that there is not."""
    if not is_own(provenance):
        return
    for key in OWN_KEYS:
        if not provenance.get(key, "").strip():
            raise ReleaseError(f"provenance: {key} is missing, must be there beside {', '.join(k for k in OWN_KEYS if k in provenance)}")
    if provenance["allocation"] not in list(Allocation):
        raise ReleaseError(f"provenance: allocation {provenance['allocation']!r}, must be one of {[a.value for a in Allocation]}")


def layout_of_release(provenance: Mapping[str, str], n_objects: int) -> Layout:
    """Scenes, shards and tiers of the dataset that a release is of.

    Args:
        n_objects: rows of table `objects`.

    Raises:
        ReleaseError: an allocation that there is not, or not for so many objects.
    """
    _check_own(provenance)
    if not is_own(provenance):
        return INTERLEAVED
    try:
        return layout_of(Allocation(provenance["allocation"]), n_objects)
    except IdentityError as error:
        raise ReleaseError(f"objects: {error}") from error


def git_commit(folder: Path = PACKAGE_ROOT) -> str:
    """Commit of the checkout that holds the folder: 40 hex digits, followed by `-dirty` where the work tree differs from it.

    Files that are neither tracked nor ignored count as a difference: an untracked module can change a label. What the checkout holds
    in `data` does not: tables are made by the code and never read as a part of it.

    Args:
        folder: by default the folder of this package. Where git does not track anything in it (an installed package inside
            somebody else's repository, for example), the answer is `unknown`, as it is without a repository, a commit or git.
    """
    if not _git(folder, "ls-files", "--", "."):
        return UNKNOWN_COMMIT
    head = _git(folder, "rev-parse", "HEAD")
    changes = _git(folder, "status", "--porcelain", "--", ":/", ":(top,exclude)data")
    if head is None or changes is None or not _COMMIT.fullmatch(head):
        return UNKNOWN_COMMIT
    return f"{head}-dirty" if changes else head


def _git(folder: Path, *arguments: str) -> str | None:
    """Standard output of a git command without the white space around it; None where git is missing or fails."""
    environment = {name: value for name, value in os.environ.items() if name not in _OF_ANOTHER_REPOSITORY}
    # Without optional locks, a status in one process never fails a commit in another.
    command = ["git", "--no-optional-locks", "-C", str(folder), *arguments]
    try:
        done = subprocess.run(command, env=environment, capture_output=True, check=True, timeout=_TIMEOUT_S)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.decode("utf-8", errors="replace").strip()
