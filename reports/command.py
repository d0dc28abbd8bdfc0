"""The command line that reports on a whole release share: `python -m reports.success_at_k data/release/pilot --split object ...`.

What a report says is decided in its module; here a release is opened, predictions are read, and both must be of the split asked for.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

from model.settings import scheme_named
from reports.load import check_parts, load_release
from reports.predictions import read_predictions
from reports.report import Report
from splits.manifest import read_manifest
from tables.errors import PlaceBenchError
from tables.vocabulary import Split, SplitScheme


@dataclass(frozen=True, slots=True, eq=False)
class Asked:
    """What a report is made of; `predictions` is None where none were named."""

    tables: Mapping[str, pa.Table]
    predictions: pa.Table | None
    tier: str
    seed: int
    scheme: SplitScheme


def report_command(
    name: str,
    make: Callable[[Asked], Report],
    arguments: Sequence[str] | None,
    *,
    needs: Sequence[Split] = (),
    takes_predictions: bool = True,
    needs_predictions: bool = False,
) -> int:
    """Make one report of a release folder, print it, and write it where `--out` says; 0, or 1 with one line on standard error.

    Args:
        name: of the report's module.
        make: makes it.
        arguments: of the command line; those of the process where None.
        needs: splits that must have scenes.
        takes_predictions: whether predictions of a ranker say anything to it.
        needs_predictions: whether there is no report without them.
    """
    parser = argparse.ArgumentParser(prog=f"python -m reports.{name}", description=f"Report {name} of a release.")
    parser.add_argument("release", type=Path, help="folder of a release")
    parser.add_argument("--split", default=SplitScheme.SCENE.value, help=f"one of {', '.join(scheme.value for scheme in SplitScheme)}")
    predictions_help = "Parquet files of model.scoring, by rankers trained under that split"
    if takes_predictions:
        parser.add_argument("--predictions", type=Path, nargs="+", default=[], required=needs_predictions, help=predictions_help)
    parser.add_argument("--seed", type=int, help="of the hash order and the resampling; by default that of the release's recipe")
    parser.add_argument("--out", type=Path, help="folder for the report")
    options = parser.parse_args(arguments)
    try:
        scheme = scheme_named(options.split)
        manifest = read_manifest(options.release)
        tables = load_release(options.release)
        check_parts(tables, scheme, needs)
        seed = int(manifest.provenance.get("recipe_seed", "42")) if options.seed is None else options.seed
        predictions = read_predictions(options.predictions, scheme) if takes_predictions else None
        report = make(Asked(tables, predictions, manifest.tier, seed, scheme))
        if options.out is not None:
            report.write(options.out)
    except PlaceBenchError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(report.markdown)
    return 0
