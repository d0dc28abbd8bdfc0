"""The commands that pages and reports show of a release: of one's own they name its catalogue and its recipe, where those are own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePath

from objects.catalogue import catalogue_hash, load_catalogue
from pipelines.recipe import load_recipe
from splits.provenance import is_own
from tables.identity import family_of_tier

# Stands for an id where a command is shown of any candidate.
ANY_ID = "ID"


@dataclass(frozen=True, slots=True)
class OwnFiles:
    """Names of the files that a command must name because they are not the benchmark's; "" for one that is. Folders nobody states."""

    catalogue: str = ""
    recipe: str = ""

    @property
    def data(self) -> str:
        """Where `make dataset` puts a dataset of these files."""
        return f"data/own/{PurePath(self.catalogue or self.recipe).stem}" if self.catalogue or self.recipe else "data"


def own_files(provenance: Mapping[str, str], tier: str) -> OwnFiles:
    """Which of catalogue and recipe of a release are somebody's own, by the hashes of those of this code."""
    if not is_own(provenance):
        return OwnFiles()
    has_catalogue = provenance["catalogue_hash"] != catalogue_hash(load_catalogue())
    has_recipe = provenance["recipe_hash"] != load_recipe(family_of_tier(tier)).hash_of()
    return OwnFiles(provenance["catalogue"] if has_catalogue else "", provenance["recipe"] if has_recipe else "")


def regenerate_command(name: str, provenance: Mapping[str, str], tier: str, files: str) -> str:
    """Make a candidate again, compare it with the release bit for bit, and write files to look at.

    Args:
        name: id of the candidate, or `ANY_ID`.
        provenance: of the release.
        tier: of the release.
        files: flags of what is written, as `--gif out.gif`.
    """
    own = own_files(provenance, tier)
    parts = [f"python -m pipelines.regenerate {name} --release {own.data}/release/{tier}"]
    if is_own(provenance):
        parts.append(f"--data {own.data}")
    parts += [f"--{flag} {path}" for flag, path in (("catalogue", own.catalogue), ("recipe", own.recipe)) if path]
    return " ".join([*parts, files])


def make_command(targets: Sequence[str], provenance: Mapping[str, str], tier: str) -> str:
    """`make` of some targets on a release."""
    own = own_files(provenance, tier)
    files = [f"{name}={path}" for name, path in (("CATALOGUE", own.catalogue), ("RECIPE", own.recipe)) if path]
    return " ".join(["make", *targets, f"TIER={tier}", *files])


def what_to_put_in(provenance: Mapping[str, str], tier: str) -> str:
    """A sentence on what a reader must replace in the command of a release of one's own; "" for the benchmark's."""
    own = own_files(provenance, tier)
    names = [path for path in (own.catalogue, own.recipe) if path]
    if not names:
        return ""
    return f"Put in the path of {' and of '.join(names)}, and the folder of the data where it is not {own.data}."
