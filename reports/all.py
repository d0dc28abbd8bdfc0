"""Every report of a release that can be rendered without labelling or training anything: `make reports TIER=full`.

`python -m reports.all RELEASE [--split SCHEME] [--predictions DIR] [--recipe FILE] [--out DIR]`

Read are the release, whole or light, and the folder of tables that were made about it, by default `data/predictions/TIER` beside
`data/release/TIER`, or `data/tiers/TIER` where a build left them: predictions.parquet, decision_times.parquet, tree_predictions.parquet,
audits.parquet, and attempts.parquet where the release holds none. A report that lacks a table is left out and the file is named.

With --split the reports that a split decides are made under that scheme, into a folder of its name, from predictions of rankers that were
trained under it, by default in a folder of its name too.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from model.settings import scheme_named
from pipelines.recipe import DEFAULT_RECIPE
from reports.kinds import KINDS, Kind
from reports.sources import Sources, folder_beside
from splits.release_reader import Release, report_folder
from tables.errors import PlaceBenchError
from tables.vocabulary import SplitScheme


@dataclass(frozen=True, slots=True)
class Rendered:
    """Names of the reports by what became of them."""

    made: tuple[str, ...]
    left_out: tuple[str, ...]
    failed: tuple[str, ...]


def render_all(sources: Sources, out: Path, log: Callable[[str], Any] = print) -> Rendered:
    """Write every report that the sources give into a folder; one that fails does not keep the others from being made.

    Args:
        sources: under another scheme than the paper's only what a split decides is made.
        log: told what becomes of each report, one line a report, and which file one lacks.
    """
    outcomes: dict[str, list[str]] = {"made": [], "left_out": [], "failed": []}
    for kind in kinds_under(sources.scheme):
        start = time.perf_counter()
        try:
            if lacks := kind.lacks(sources):
                outcomes["left_out"].append(kind.name)
                log(f"{kind.name}: left out, {'; '.join(lacks)}")
                continue
            path, without = kind.make(sources).write(out), kind.goes_without(sources)
        except (PlaceBenchError, OSError) as error:
            outcomes["failed"].append(kind.name)
            log(f"{kind.name}: FAILED, {' '.join(f'{type(error).__name__}: {error}'.split())}")
            continue
        outcomes["made"].append(kind.name)
        log("; ".join([f"{kind.name}: {path}, {time.perf_counter() - start:.1f} s", *without]))
    return Rendered(*(tuple(names) for names in outcomes.values()))


def kinds_under(scheme: SplitScheme) -> list[Kind]:
    """The reports that there are under a scheme: all under the paper's, and else those that a split decides."""
    return [kind for kind in KINDS.values() if kind.by_split or scheme is SplitScheme.SCENE]


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line: 0 where every report was made or lacks a table, 1 where one failed or there is no release."""
    about, _, more = (__doc__ or "").partition("\n")
    parser = argparse.ArgumentParser(prog="python -m reports.all", description=about, epilog=more.rpartition("\n\n")[2])
    parser.add_argument("release", type=Path, help="folder of a release")
    parser.add_argument("--split", default=SplitScheme.SCENE.value, help=f"one of {', '.join(scheme.value for scheme in SplitScheme)}")
    parser.add_argument("--predictions", type=Path, metavar="DIR", help="folder of the tables about it")
    parser.add_argument("--recipe", type=Path, default=DEFAULT_RECIPE, help="that the release was made with, for films (the benchmark's)")
    parser.add_argument("--out", type=Path, help="folder for the reports (those of the tier, or a folder of the scheme there)")
    chosen = parser.parse_args(arguments)
    try:
        scheme, release = scheme_named(chosen.split), Release.open(chosen.release)
    except PlaceBenchError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    tier = release.manifest.tier
    out = chosen.out or Path(report_folder(release), *([] if scheme is SplitScheme.SCENE else [scheme.value]))
    beside = chosen.predictions or folder_beside(chosen.release, tier, scheme)
    rendered = render_all(Sources(release, beside, chosen.recipe, scheme), out)
    rest = [f"{name.replace('_', ' ')}: {', '.join(names)}" for name in ("left_out", "failed") if (names := getattr(rendered, name))]
    print("; ".join([f"{len(rendered.made)} of {len(kinds_under(scheme))} reports in {out}", *rest]))
    return 1 if rendered.failed else 0


if __name__ == "__main__":
    sys.exit(main())
