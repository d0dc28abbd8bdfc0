"""Filmstrips of the first choices that fail, a row each; which groups are shown is decided in error_analysis.py."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import pyarrow as pa

from pipelines.decoded import Decoded
from pipelines.pictures.filmstrip import strip_tiles
from pipelines.pictures.sheet import sheet
from pipelines.recipe import Recipe
from reports.gallery import FRAME_PX, FRAMES_OF_FILM
from reports.recordings import recording_of

# A picture of 20 rows is 4,000 pixels high and has 0.5 to 0.8 MB; viewers shrink what is higher.
ROWS_A_PICTURE = 20


@dataclass(frozen=True, slots=True, eq=False)
class Films:
    """What films of first choices are made of.

    Attributes:
        tables: objects, `scenes`, `obstacles`, `targets`, `grasps`, `candidates` and `plans`; None for no films.
        recipe: what the plans were made with.
        n: films a task.
        why_not: said where there are none.
    """

    tables: Mapping[str, pa.Table] | None = None
    recipe: Recipe | None = None
    n: int = 0
    why_not: str = ""


def error_films(candidate_ids: Sequence[str], films: Films) -> tuple[list[bytes], str]:
    """PNGs with a strip a candidate, in order, at most `films.n` of them; or none, and why.

    With a plan a strip is its execution, without one the hand at its place.
    """
    if films.tables is None or films.recipe is None:
        return [], films.why_not or "nothing to make them of"
    release, shown = Decoded(films.tables), candidate_ids[: films.n]
    strips = [strip_tiles(recording_of(release, name, films.recipe), FRAMES_OF_FILM, FRAME_PX) for name in shown]
    pictures = [strips[k : k + ROWS_A_PICTURE] for k in range(0, len(strips), ROWS_A_PICTURE)]
    return [sheet([tile for strip in rows for tile in strip], FRAMES_OF_FILM) for rows in pictures], ""
