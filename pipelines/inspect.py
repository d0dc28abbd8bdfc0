"""Command line: build the objects of a catalogue file as the recipe asks, and show a card of each with what scenes would make of it.

python -m pipelines.inspect CATALOGUE.toml [--object ID] [--png DIR] [--recipe FILE] [--allow-outside]
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from objects.build import ObjectTables, build_object, object_models_of
from objects.card import card_rows, kinds_text
from objects.catalogue import PACKAGED_CATALOGUE, ObjectSpec, load_catalogue
from objects.draw import draw_object
from objects.errors import CatalogueError
from pipelines.recipe import DEFAULT_RECIPE, Recipe, load_recipe
from pipelines.scenes.draws import SceneSamplingParams
from pipelines.scenes.outlook import N_SPOTS, RestOutlook, scene_outlook
from tables.errors import PlaceBenchError


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code 0 when every object was built and has scenes, 1 when one was not or has none; the others are shown all the same."""
    parser = argparse.ArgumentParser(
        prog="python -m pipelines.inspect", description="Build the objects of a catalogue and show a card of each."
    )
    parser.add_argument("catalogue", nargs="?", type=Path, default=PACKAGED_CATALOGUE, help="catalogue file (default: the packaged one)")
    parser.add_argument("--object", dest="object_id", help="only this object")
    parser.add_argument("--png", type=Path, metavar="DIR", help="also write a picture of each object into this folder")
    parser.add_argument("--recipe", type=Path, default=DEFAULT_RECIPE, help="recipe file: seed and parameters (default: the shipped one)")
    parser.add_argument("--allow-outside", action="store_true", help="mesh files may lie outside the folder of the catalogue")
    options = parser.parse_args(arguments)
    err = Console(stderr=True)
    try:
        recipe = load_recipe("full", options.recipe)
        specs = _wanted(load_catalogue(options.catalogue, options.allow_outside), options.object_id)
    except PlaceBenchError as error:
        _print_error(err, error)
        return 1
    n_failed = 0
    for spec in specs:
        try:
            _show(spec, recipe, options.png, err)
        except PlaceBenchError as error:
            _print_error(err, error)
            n_failed += 1
    if n_failed:
        err.print(f"{n_failed} of {len(specs)} objects failed", style="red")
    return 1 if n_failed else 0


class NoSceneError(PlaceBenchError, RuntimeError):
    """An object that was built, but for which no scene could be drawn."""


def _show(spec: ObjectSpec, recipe: Recipe, folder: Path | None, err: Console) -> None:
    """Build an object and print its card; progress goes to the error stream.

    Raises:
        ObjectError: it cannot be built.
        NoSceneError: it can, and no scene could be drawn for it.
    """
    out, start = Console(), time.monotonic()
    built = build_object(spec, recipe.objects, recipe.seed, lambda line: err.print(line, style="dim", markup=False, soft_wrap=True))
    object_model = object_models_of([built])[spec.object_id]
    outlooks = scene_outlook(object_model, recipe.scene_sampling, recipe.physics, recipe.seed)
    out.print(card(spec, built, outlooks, recipe.scene_sampling))
    out.print(f"{spec.object_id}: {time.monotonic() - start:.1f} s", markup=False)
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        picture = folder / f"{spec.object_id}.png"
        draw_object(object_model, picture)
        out.print(f"picture: {picture}", markup=False, soft_wrap=True)
    least = recipe.scene_sampling.min_initial_grasps
    if not any(outlook.may_start for outlook in outlooks):
        best = max((max(outlook.within_reach) for outlook in outlooks if outlook.stays), default=0)
        raise NoSceneError(
            f"{spec.object_id}: {best} grasps within reach at the best of {N_SPOTS} spots of any resting pose that stays, must be at least"
            f" {least} (scene_sampling.min_initial_grasps) for a scene to start from"
        )


def card(spec: ObjectSpec, built: ObjectTables, outlooks: Sequence[RestOutlook], params: SceneSamplingParams) -> Panel:
    """The card of an object, and a row for each resting pose with what scenes would use it for."""
    table = Table.grid(padding=(0, 2))
    table.add_column(style="bold")
    table.add_column()
    others = f", {1 - params.share_same_rest:.0%} of them in another pose than the start" if len(outlooks) > 1 else ""
    scenes = (
        f"start from {_names([o for o in outlooks if o.may_start])} (poses take turns, {params.min_initial_grasps} grasps within reach)",
        f"targets in {_names([o for o in outlooks if o.may_be_target])} ({params.min_target_grasps} within reach{others})",
    )
    for label, text in (*card_rows(built), *((_label(o), _text(o)) for o in outlooks), *(("scenes", line) for line in scenes)):
        table.add_row(label, Text(text))
    return Panel(table, title=Text(f"{spec.object_id}: {spec.name}"), title_align="left", expand=False)


def _label(outlook: RestOutlook) -> str:
    return f"rest {outlook.resting}"


def _text(outlook: RestOutlook) -> str:
    kinds, reached = Counter(outlook.above_table), outlook.within_reach
    return (
        f"{outlook.probability:.1%} of drops, {'stays' if outlook.stays else 'does not stay'};"
        f" {kinds.total()} grasps clear the table ({kinds_text(kinds)}), {min(reached)} to {max(reached)} within reach;"
        f" of {N_SPOTS} spots {outlook.start_spots} for a start, {outlook.target_spots} for a target"
    )


def _names(outlooks: Sequence[RestOutlook]) -> str:
    return ", ".join(outlook.resting for outlook in outlooks) or "no pose"


def _print_error(err: Console, error: PlaceBenchError) -> None:
    err.print(f"error: {error}", style="red", markup=False, soft_wrap=True)


def _wanted(specs: tuple[ObjectSpec, ...], object_id: str | None) -> tuple[ObjectSpec, ...]:
    if object_id is None:
        return specs
    wanted = tuple(spec for spec in specs if spec.object_id == object_id)
    if not wanted:
        raise CatalogueError(f"{object_id}: not in the catalogue, must be one of {[spec.object_id for spec in specs]}")
    return wanted


if __name__ == "__main__":
    sys.exit(main())
