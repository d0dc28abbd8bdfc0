"""The figures of the README and of the site's first page: `make figures`, or `python -m reports.front_page RELEASE [--out DIR]`.

Written are `ladder.png`, `chain.png` and `executions.png`. Learned policies are in the ladder where predictions lie beside the release. The
two executions are made again from their ids, which takes a minute of a core; --keep-executions leaves their picture as it is.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import polars as pl

from pipelines.frames import frame_of
from pipelines.proofs.regenerate import make_again
from pipelines.proofs.shown import recorded
from reports.front_figures import chain_figure, ladder_points_figure
from reports.front_strip import strip_figure
from reports.kinds import KINDS
from reports.load import Task
from reports.sources import Sources, folder_beside
from reports.standing import random_mean, standings
from splits.release_reader import Release
from tables.errors import PlaceBenchError
from tables.store import write_bytes_atomically
from tables.vocabulary import Split

PICTURES = Path(__file__).parent / "pictures"
FRONT_PICTURES = ("executions", "ladder", "chain")
FRONT_TIER = "full"  # the one whose pictures `make figures` draws
# Two grasps of one vacuum flask for one target: what a ranker has to tell apart.
EXECUTIONS = ("full-1137-t0-g33", "full-1137-t0-g25")


def ladder_png(sources: Sources) -> bytes:
    """S1 of every policy on the test split of a release."""
    metrics = KINDS["success_at_k"].make(sources).metrics
    manifest = sources.release.manifest
    n_scenes = int((sources.release.table("splits")["split"].to_pandas() == Split.TEST.value).sum())
    title = f"Does the first choice succeed? {manifest.tier} {manifest.version}, test split, {n_scenes:,} scenes"
    return ladder_points_figure(standings(metrics), {task: random_mean(metrics, task) for task in Task}, title)


def chain_png(release: Release) -> bytes:
    """The chain with the numbers of a release."""
    rows = {name: entry.rows for name, entry in release.manifest.tables.items()}
    lifted = frame_of(release.table("grasps"), ["lift_status"]).filter(pl.col("lift_status") == "lifted").height
    successes = int(release.candidates["y_pipe"].fill_null(False).sum())
    numbers = {
        "objects": f"{rows['objects']:,} objects",
        "scenes": f"{rows['scenes']:,} scenes",
        "grasps": f"{lifted:,} lifted grasps",
        "candidates": f"{rows['candidates']:,} pairs",
        "labels": f"{successes:,} successes",
        "release": f"{release.manifest.tier} {release.manifest.version}",
    }
    return chain_figure(numbers)


def executions_png() -> bytes:
    """The two executions, made again from catalogue and recipe alone.

    Raises:
        PlaceBenchError: an execution that does not end as its label.
    """
    recordings = []
    for name in EXECUTIONS:
        made = make_again(name)
        recordings.append(recorded(name, made.recipe, made.object_model, made.rows))
    return strip_figure(recordings, made.recipe.execution.tolerances)


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line: 0, or 1 with one line where there is no release or a figure cannot be made of it."""
    about, _, more = (__doc__ or "").partition("\n")
    parser = argparse.ArgumentParser(prog="python -m reports.front_page", description=about, epilog=more.strip())
    parser.add_argument("release", type=Path, help="folder of a release")
    parser.add_argument("--predictions", type=Path, metavar="DIR", help="folder of the tables about it")
    parser.add_argument("--keep-executions", action="store_true", help="do not make executions.png again")
    parser.add_argument("--out", type=Path, default=PICTURES, help="folder for the figures (reports/pictures)")
    chosen = parser.parse_args(arguments)
    try:
        release = Release.open(chosen.release)
        sources = Sources(release, chosen.predictions or folder_beside(chosen.release, release.manifest.tier))
        figures = {"ladder": ladder_png(sources), "chain": chain_png(release)}
        if not chosen.keep_executions:
            figures["executions"] = executions_png()
    except (PlaceBenchError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    for name, content in figures.items():
        path = chosen.out / f"{name}.png"
        write_bytes_atomically(path, content)
        print(f"{path}: {len(content) / 1e3:.0f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
