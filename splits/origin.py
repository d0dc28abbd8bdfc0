"""Whether this code and a recipe file are those that made a release: asked before hours of work, whose hash would only say no."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pipelines.recipe import Recipe, load_recipe
from pipelines.stage import Stage
from splits.errors import ReleaseError
from splits.manifest import Manifest
from tables.identity import family_of_tier


def recipe_of(manifest: Manifest, path: Path, stages: Sequence[Stage] = ()) -> Recipe:
    """The recipe of a file, if the release was made with it, and with the code of some stages.

    Raises:
        ReleaseError: it was not.
        RecipeError: the file is no recipe.
    """
    recipe = load_recipe(family_of_tier(manifest.tier), path)
    check_origin(manifest, {"recipe_hash": recipe.hash_of(), **{f"code.{stage.name}": stage.code_version for stage in stages}})
    return recipe


def check_origin(manifest: Manifest, own: dict[str, str]) -> None:
    """Raise ReleaseError for the first of these origins, by their names in the manifest, that the release states otherwise."""
    for key, value in own.items():
        stated = str(manifest.provenance.get(key))
        if stated != value:
            commit = str(manifest.provenance.get("git_commit", "unknown"))
            raise ReleaseError(
                f"{key} of the release is {stated[:12]}, must be that of this code, {value[:12]}; use what made it (commit {commit[:12]})"
            )
