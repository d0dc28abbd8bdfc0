"""Command line: build the objects of a catalogue file and show a card, and a picture, of each.

python -m objects.inspect CATALOGUE.toml [--object ID] [--png DIR] [--seed N]
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.panel import Panel
from rich.table import Table

from objects.build import ObjectParams, ObjectTables, build_object, object_models_of
from objects.catalogue import PACKAGED_CATALOGUE, ObjectSpec, load_catalogue
from objects.draw import draw_object
from objects.errors import CatalogueError, ObjectError


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code 0 when every object was built, 1 when one was not; the others are shown all the same."""
    parser = argparse.ArgumentParser(
        prog="python -m objects.inspect", description="Build the objects of a catalogue and show a card of each."
    )
    parser.add_argument("catalogue", nargs="?", type=Path, default=PACKAGED_CATALOGUE, help="catalogue file (default: the packaged one)")
    parser.add_argument("--object", dest="object_id", help="only this object")
    parser.add_argument("--png", type=Path, metavar="DIR", help="also write a picture of each object into this folder")
    parser.add_argument("--seed", type=int, default=0, help="recipe seed (default 0)")
    options = parser.parse_args(arguments)
    out, err = Console(), Console(stderr=True)
    try:
        specs = _wanted(load_catalogue(options.catalogue), options.object_id)
    except CatalogueError as error:
        err.print(f"error: {error}", style="red", markup=False, soft_wrap=True)
        return 1
    n_failed = 0
    for spec in specs:
        try:
            built = build_object(spec, ObjectParams(), options.seed)
        except ObjectError as error:
            err.print(f"error: {error}", style="red", markup=False, soft_wrap=True)
            n_failed += 1
            continue
        out.print(card(spec, built))
        if options.png is not None:
            options.png.mkdir(parents=True, exist_ok=True)
            picture = options.png / f"{spec.object_id}.png"
            draw_object(object_models_of([built])[spec.object_id], picture)
            out.print(f"picture: {picture}", markup=False, soft_wrap=True)
    if n_failed:
        err.print(f"{n_failed} of {len(specs)} objects failed", style="red")
    return 1 if n_failed else 0


def card(spec: ObjectSpec, built: ObjectTables) -> Panel:
    """What a person wants to know of an object before using it."""
    row = built.objects[0]
    table = Table.grid(padding=(0, 2))
    table.add_column(style="bold")
    table.add_column()
    size = " x ".join(f"{row[f'size_{axis}_m'] * 1e3:.1f}" for axis in "xyz")
    com = ", ".join(f"{row[f'com_{axis}_m'] * 1e3:.1f}" for axis in "xyz")
    table.add_row("size", f"{size} mm")
    table.add_row("mass", f"{row['mass_kg'] * 1e3:.0f} g, centre of mass ({com}) mm, friction {row['friction']:.2f}")
    table.add_row("symmetry", str(row["symmetry"]))
    table.add_row("parts", f"{len(built.object_parts)} convex, hull volume {row['hull_volume_ratio']:.3f} x mesh volume")
    if row["cavity_fill"] is not None:
        table.add_row("fill", f"cavity {row['cavity_fill']:.1%}, handle hole {row['handle_hole_fill']:.1%}")
    table.add_row("rests", ", ".join(f"{pose['resting']} {pose['probability']:.1%}" for pose in built.stable_poses))
    kinds = Counter(grasp["grasp_kind"] for grasp in built.grasp_pool)
    widths = [grasp["jaw_width_m"] * 1e3 for grasp in built.grasp_pool]
    table.add_row("grasps", f"{len(built.grasp_pool)}: " + ", ".join(f"{kind} {kinds[kind]}" for kind in sorted(kinds)))
    table.add_row("jaw widths", f"{min(widths):.1f} to {max(widths):.1f} mm")
    table.add_row("source", str(row["source"]))
    table.add_row("hashes", f"mesh {row['mesh_sha256'][:12]}, parts {row['parts_sha256'][:12]}")
    return Panel(table, title=f"{spec.object_id}: {spec.name}", title_align="left", expand=False)


def _wanted(specs: tuple[ObjectSpec, ...], object_id: str | None) -> tuple[ObjectSpec, ...]:
    if object_id is None:
        return specs
    wanted = tuple(spec for spec in specs if spec.object_id == object_id)
    if not wanted:
        raise CatalogueError(f"{object_id}: not in the catalogue, must be one of {[spec.object_id for spec in specs]}")
    return wanted


if __name__ == "__main__":
    sys.exit(main())
