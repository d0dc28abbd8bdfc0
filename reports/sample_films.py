"""Films and traces of a release: some candidates of every outcome and category, each run again as its label was made.

`python -m reports.sample_films RELEASE [--each 2] [--out DIR]`

Written are `<candidate id>.gif`, `.png` and `.mcap`; the site shows them. About ten seconds of a core a film; what is there stays.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import polars as pl

from pipelines.codecs import Row
from pipelines.pictures.filmstrip import film, filmstrip
from pipelines.pictures.recording import Recording
from pipelines.pictures.trace import trace
from pipelines.recipe import DEFAULT_RECIPE, Recipe
from reports.recordings import recording_of
from reports.report import ReportError
from reports.sources import Sources
from splits.examples import chosen_by_outcome
from splits.release_reader import Release, report_folder
from tables.errors import PlaceBenchError
from tables.store import write_bytes_atomically

N_FILMS_EACH = 2


def chosen_candidates(release: Release, seed: int, n_each: int) -> list[str]:
    """Candidates of every outcome in every category, where there are any, the first by the hash of their ids."""
    chosen = chosen_by_outcome(release.candidates, seed, n_each, by=["category"])
    return sorted(name for names in chosen.values() for name in names)


def recorded(release: Release, candidate_id: str, recipe: Recipe) -> Recording:
    """A candidate of a release, run again from its stored plan, or its rejection.

    Raises:
        ReportError: the run ended otherwise than its row says, or an executed candidate has no plan.
    """
    stored, recording = release.values.labels(candidate_id), recording_of(release.values, candidate_id, recipe)
    others = [name for name, value in stored.items() if recording.labels[name] != value]
    if others:
        raise ReportError(f"{candidate_id}: {others[0]} is {stored[others[0]]!r}, came out {recording.labels[others[0]]!r} when run again")
    return recording


def write_films(sources: Sources, out: Path, n_each: int = N_FILMS_EACH, log: Callable[[str], Any] = print) -> list[Path]:
    """Films of the chosen candidates in a folder; returns the paths of all, those that were there too.

    Raises:
        ReportError: a label does not come out again.
        ReleaseError: this code has another recipe than the release, or it is a light one without plans or points.
    """
    release, recipe = sources.release, sources.recipe()
    identity = {"recipe_hash": recipe.hash_of(), "release_hash": release.manifest.release_hash, "release_version": release.manifest.version}
    points, paths = release.table("scene_points"), []
    for name in chosen_candidates(release, sources.seed, n_each):
        own = [out / f"{name}.{kind}" for kind in ("png", "gif", "mcap")]
        paths += own
        if all(path.exists() for path in own):
            continue
        recording = recorded(release, name, recipe)
        rows: list[Row] = pl.DataFrame(points).filter(pl.col("scene_id") == recording.candidate.scene.scene_id).to_dicts()
        for path, content in zip(own, (filmstrip(recording), film(recording), trace(recording, rows, identity)), strict=True):
            write_bytes_atomically(path, content)
        log(recording.verdict)
    return paths


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line: 0, or 1 with one line where there is no release or no film can be made of it."""
    about, _, more = (__doc__ or "").partition("\n")
    parser = argparse.ArgumentParser(prog="python -m reports.sample_films", description=about, epilog=more.rpartition("\n\n")[2])
    parser.add_argument("release", type=Path, help="folder of a release")
    parser.add_argument("--each", type=int, default=N_FILMS_EACH, metavar="N", help="films of an outcome and category (2)")
    parser.add_argument("--recipe", type=Path, default=DEFAULT_RECIPE, help="that the release was made with (the benchmark's)")
    parser.add_argument("--out", type=Path, help="folder for the films (films/ among the reports of the tier)")
    chosen = parser.parse_args(arguments)
    try:
        release = Release.open(chosen.release)
        out = chosen.out or report_folder(release) / "films"
        paths = write_films(Sources(release, chosen.release, chosen.recipe), out, chosen.each)
    except (PlaceBenchError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(f"{len(paths) // 3} candidates in {out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
