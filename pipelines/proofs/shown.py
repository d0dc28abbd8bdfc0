"""A candidate that was made again, as files to look at: an MCAP trace, a filmstrip, a film; and beside what a release says of it.

A candidate without a plan has no motion: shown are the state after the lift, from where planning started, and the open hand at the
place that it could not be brought to, with the status of the rejection.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from pathlib import Path

import pyarrow.dataset as ds

from objects.object_model import ObjectModel
from pipelines.codecs import Row, known_in
from pipelines.labels.planning import motion_of
from pipelines.pictures.filmstrip import film, filmstrip
from pipelines.pictures.recording import Recording, record_execution, record_rejection
from pipelines.pictures.trace import trace
from pipelines.recipe import Recipe
from tables.errors import PlaceBenchError
from tables.schemas import CANDIDATES
from tables.store import write_bytes_atomically

Rows = Mapping[str, list[Row]]


class ShownError(PlaceBenchError, ValueError):
    """A label that did not come out again as stored, or a name or folder that nothing can be shown of."""


def add_film_flags(parser: argparse.ArgumentParser) -> None:
    """Flags of what to write and what to compare with."""
    parser.add_argument("--mcap", type=Path, metavar="FILE", help="trace with Foxglove's schemas, for Foxglove, Rerun and others")
    parser.add_argument("--filmstrip", type=Path, metavar="FILE", help="PNG of a candidate from lift to rest")
    parser.add_argument("--gif", type=Path, metavar="FILE", help="the same as a film")
    parser.add_argument("--release", type=Path, metavar="DIR", help="a release whose row of the candidate must come out again")


def check_shown(chosen: argparse.Namespace) -> None:
    """Raise ShownError where a scene is to be shown: only a candidate can."""
    is_shown = any(getattr(chosen, name) is not None for name in ("mcap", "filmstrip", "gif", "release"))
    if is_shown and "-t" not in chosen.name:
        raise ShownError(f"{chosen.name}: a scene, must be a candidate like {chosen.name}-t3-g17 to be shown or compared with a release")


def show(chosen: argparse.Namespace, recipe: Recipe, object_model: ObjectModel, rows: Rows) -> bool:
    """Write the files that were asked for, if any, and print their paths; whether there was a row of a release to compare with.

    Nothing is written unless the row of the release, where one is named, comes out again in every bit, and the film ends as its label.

    Args:
        chosen: the command line; `name` is the id of a candidate.
        rows: of that candidate, by table, made again.

    Raises:
        ShownError: a row that is not as stored, or a release of another recipe or without the candidate.
    """
    outputs: dict[str, Path] = {name: path for name in ("mcap", "filmstrip", "gif") if (path := getattr(chosen, name)) is not None}
    if not outputs and chosen.release is None:
        return False
    identity = {"recipe_hash": recipe.hash_of()}
    if chosen.release is not None:
        identity |= check_released(chosen.release, chosen.name, recipe, rows)
        print(f"as in release {identity['release_hash'][:12]}: every label of {chosen.name}, every bit")
    if outputs:
        recording = recorded(chosen.name, recipe, object_model, rows)
        makers = {
            "mcap": lambda: trace(recording, rows["scene_points"], identity),
            "filmstrip": lambda: filmstrip(recording),
            "gif": lambda: film(recording),
        }
        for name, path in outputs.items():
            write_bytes_atomically(path, makers[name]())
            print(f"{name}: {path}")
        print(recording.verdict)
    return chosen.release is not None


def recorded(candidate_id: str, recipe: Recipe, object_model: ObjectModel, rows: Rows) -> Recording:
    """Run a candidate once more from its rows and watch; the end must be that of its label.

    Args:
        rows: by table, of its scene and itself, as stages make them.

    Raises:
        ShownError: no such candidate among the rows, or another end.
    """
    known = known_in(rows)
    candidate = next((c for c in known.candidates if c.candidate_id == candidate_id), None)
    planning_row = next((row for row in rows["planning_labels"] if row["candidate_id"] == candidate_id), None)
    if candidate is None or planning_row is None:
        raise ShownError(f"{candidate_id}: not among the {len(known.candidates)} candidates")
    plan = known.plans.get(candidate_id)
    if plan is None:
        return record_rejection(object_model, candidate, recipe.planning.release_height_m, planning_row)
    motion = motion_of(candidate, plan, recipe.planning)
    recording = record_execution(object_model, candidate, motion, recipe.execution_setup, planning_row)
    label = next(row for row in rows["execution_labels"] if row["candidate_id"] == candidate_id)
    _check_equal(candidate_id, label, {name: recording.labels[name] for name in label}, "when watched")
    return recording


def check_released(directory: Path, candidate_id: str, recipe: Recipe, rows: Rows) -> dict[str, str]:
    """Compare a candidate with its row of a release's table `candidates`, bit for bit; returns what identifies the release.

    Raises:
        ShownError: no release, one of another recipe, one without the candidate, or a value that differs.
    """
    try:
        manifest = json.loads((directory / "manifest.json").read_text(encoding="utf-8"))
        about = {"release_hash": manifest["release_hash"], "release_version": manifest["version"], "tier": manifest["tier"]}
        made_with = manifest["provenance"]["recipe_hash"]
        table = ds.dataset(directory / CANDIDATES.name, format="parquet").to_table(filter=ds.field("candidate_id") == candidate_id)
    except (OSError, ValueError, KeyError) as error:
        raise ShownError(f"{directory}: no release: {' '.join(str(error).split())}") from error
    if made_with != recipe.hash_of():
        raise ShownError(f"{directory}: of recipe {made_with[:12]}, must be {recipe.hash_of()[:12]}: labels of another recipe differ")
    if table.num_rows != 1:
        raise ShownError(f"{directory}: {table.num_rows} rows of {candidate_id} in candidates, must be 1")
    (stored,) = table.select(CANDIDATES.names).to_pylist()
    made: Row = dict.fromkeys(CANDIDATES.names)
    for name in ("candidate_pairs", "planning_labels", "execution_labels"):
        made |= next((row for row in rows[name] if row["candidate_id"] == candidate_id), {})
    _check_equal(candidate_id, stored, made, f"in {directory}")
    return about


def _check_equal(candidate_id: str, stored: Row, made: Row, where: str) -> None:
    """Every value the same, reals in every bit (no stored real is NaN, and -0.0 is 0.0)."""
    others = [name for name in stored if stored[name] != made[name]]
    if others:
        name = others[0]
        raise ShownError(
            f"{candidate_id}: {name} is {stored[name]!r} {where}, {made[name]!r} made again ({len(others)} of {len(stored)} columns differ)"
        )
