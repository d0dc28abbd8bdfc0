"""Reference rankers of a release: trained where they are not, and what they say of the validation and test splits, to lie beside it.

`python -m assets_def.rankers full [--only local full.42] [--split object] [--workers 2]`

A light release gets its points again first. Checkpoints that are shipped in model/checkpoints are taken as they are; the others are trained
into the data folder, several side by side with one thread each, and an interrupted training goes on after its last epoch. Predictions of
rankers that are neither shipped nor trained here stay in the table as they are, if they are of this release: `--only` adds to it.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from assets_def.partitions import RankerKey, rankers_of_tier
from assets_def.ranker_assets import SCORING_CODE_VERSION
from assets_def.ranker_training import SHIPPED, RankersError, exit_code_of, folder_name, settings_of, train_all
from assets_def.resources import Benchmark
from assets_def.trees_assets import TRAININGS, TREE_PREDICTIONS, TREES_CODE_VERSION, made_from_trainings
from model.checkpoint import identity_of, is_checkpoint_of, weights_sha256
from model.inputs import InputReader, contract_hash, scenes_of_split
from model.scoring import score
from model.settings import SCHEME_OF_PREDICTIONS, Variant, scheme_named
from model.trees import read_tree_data, split_predictions
from pipelines.running.lock import locked
from reports.sources import folder_beside
from splits.rebuild import rebuild
from splits.release_reader import Release
from tables.identity import TIERS, parse_candidate_id
from tables.schemas import PREDICTIONS
from tables.sidecar import Sidecar, find_published, read_sidecar
from tables.store import join_tables, read_table, write_table
from tables.vocabulary import Split, SplitScheme

# Rankers are selected on the one and judged on the other; what they say of scenes that they were trained on is no result.
SCORED = (Split.VALIDATION.value, Split.TEST.value)
# Variants of the ablation are compared on validation, so that test takes no part in choosing between them, and on nothing else.
ABLATIONS = (Variant.DIRECT, Variant.NO_OBJECT_RELATIVE, Variant.NO_TARGET_HYPOTHESIS)


@dataclass(frozen=True, slots=True)
class Place:
    """A release, by what its scenes are dealt, and where its rankers and their predictions lie."""

    release_dir: Path
    tier: str
    scheme: SplitScheme
    trained: Path
    beside: Path

    @classmethod
    def of(cls, benchmark: Benchmark, tier: str, scheme: SplitScheme) -> Place:
        release_dir, root = benchmark.root.release(tier), benchmark.root
        trained = root.checkpoint(tier, Variant.FULL.value, 0).parent.joinpath(*_below(scheme))
        return cls(release_dir, tier, scheme, trained, folder_beside(release_dir, tier, scheme))

    def checkpoint(self, key: RankerKey) -> Path | None:
        """The folder of a trained ranker, shipped or trained here; None where there is none of today's settings and release."""
        identity = identity_of(self.release_dir, key.variant, key.seed, settings_of(key), self.scheme)
        folders = (SHIPPED.joinpath(self.tier, *_below(self.scheme), folder_name(key)), self.trained / folder_name(key))
        return next((folder for folder in folders if is_checkpoint_of(folder, identity)), None)


def _below(scheme: SplitScheme) -> tuple[str, ...]:
    """Folders between those of a tier and those of its rankers under a scheme."""
    return () if scheme is SplitScheme.SCENE else (scheme.value,)


def keys_of(tier: str, scheme: SplitScheme, only: Sequence[str] = ()) -> tuple[RankerKey, ...]:
    """Rankers that a tier is judged by: all of it under the paper's scheme, ours and one seed under another.

    Args:
        only: variants, or variant.seed; all without any.

    Raises:
        RankersError: a choice that is no ranker of the tier.
    """
    keys = rankers_of_tier(tier)
    if scheme is not SplitScheme.SCENE:
        keys = tuple(key for key in keys if key.variant is Variant.LOCAL)[:1]
    names = {name: key for key in keys for name in (_short(key), key.variant.value)}
    if strange := [name for name in only if name not in names]:
        raise RankersError(f"{strange[0]}: no ranker of {tier} under split {scheme.value}, must be one of {', '.join(names)}")
    return tuple(key for key in keys if not only or {_short(key), key.variant.value} & set(only))


def make_rankers(place: Place, keys: Sequence[RankerKey], n_workers: int, log: Callable[[str], Any] = print) -> None:
    """Train what is missing of some rankers, and publish what all that are there, and the trees, say of validation and test.

    Raises:
        RankersError: a training that failed; the others are kept.
        PlaceBenchError: a release that cannot be read, made whole or trained on.
    """
    make_whole(place, n_workers, log)
    with locked(place.trained / ".lock", f"rankers of {place.tier}"):
        missing = [key for key in keys if place.checkpoint(key) is None]
        log(f"rankers: {len(keys) - len(missing)} of {len(keys)} there")
        if missing:
            train_all(place.release_dir, missing, place.scheme, place.trained, n_workers, log)
        there = {key: folder for key in keys_of(place.tier, place.scheme) if (folder := place.checkpoint(key)) is not None}
        _publish_predictions(place, there, log)
        _publish_trees(place, log)


def make_whole(place: Place, n_workers: int, log: Callable[[str], Any] = print) -> None:
    """Give a light release the points that networks see; raises as `splits.rebuild.rebuild`."""
    if "scene_points" in Release.open(place.release_dir).left_out:
        rebuild(place.release_dir, "scene_points", n_workers, log=log)


def _publish_predictions(place: Place, there: Mapping[RankerKey, Path], log: Callable[[str], Any]) -> None:
    """Score what has other weights than the table says, keep the rest of it."""
    path = place.beside / f"{PREDICTIONS.name}.parquet"
    made_from = {"code": SCORING_CODE_VERSION, "contract": contract_hash(), **_of_release(place)}
    weights = {_recorded(key): weights_sha256(folder) for key, folder in there.items()}
    kept, rows = _kept(path, made_from)
    weights = {name: sha256 for name, sha256 in kept.items() if name not in weights} | weights
    made_from |= dict(sorted(weights.items()))
    if isinstance(find_published(PREDICTIONS, path, made_from, place.tier), Sidecar):
        log(f"{PREDICTIONS.name}: there already, {len(weights)} rankers")
        return
    of = {_recorded(key): key for key in there}
    stale = [name for name, sha256 in weights.items() if kept.get(name) != sha256]
    parts = [rows.filter(_is_of(rows, name)) for name in weights if name not in stale] if rows is not None else []
    parts += [score(place.release_dir, there[of[name]], "cpu", scored_of(of[name].variant)) for name in stale]
    sidecar = write_table(PREDICTIONS, join_tables(PREDICTIONS, parts), path, made_from, of=place.tier)
    log(f"{PREDICTIONS.name}: {len(stale)} of {len(weights)} rankers scored, {sidecar.rows:,} rows, {path}")


def scored_of(variant: Variant) -> tuple[str, ...]:
    """Splits of which a table beside a release holds what rankers of a variant say."""
    return (Split.VALIDATION.value,) if variant in ABLATIONS else SCORED


def _kept(path: Path, made_from: Mapping[str, str]) -> tuple[dict[str, str], pa.Table | None]:
    """Weights by ranker of the table that is there and its rows, if it was made about this release by this code."""
    if not path.exists():
        return {}, None
    theirs = read_sidecar(path).made_from
    if not made_from.items() <= theirs.items():
        return {}, None
    weights = {name: value for name, value in theirs.items() if name.startswith("ranker.")}
    return weights, read_table(PREDICTIONS, path, verify=True)


def _is_of(rows: pa.Table, name: str) -> pa.ChunkedArray:
    _, variant, seed = name.split(".")
    return pc.and_(pc.equal(rows["variant"].cast(pa.string()), variant), pc.equal(rows["seed"], int(seed)))


def _publish_trees(place: Place, log: Callable[[str], Any]) -> None:
    path = place.beside / f"{TREE_PREDICTIONS}.parquet"
    trainings = TRAININGS if place.scheme is SplitScheme.SCENE else TRAININGS[:1]
    made_from = {"code": TREES_CODE_VERSION, "contract": contract_hash(), **_of_release(place), **made_from_trainings(trainings)}
    if isinstance(find_published(PREDICTIONS, path, made_from, place.tier), Sidecar):
        log(f"{TREE_PREDICTIONS}: there already")
        return
    data = read_tree_data(place.release_dir)
    parts = [split_predictions(place.release_dir, data, variant, seed, place.scheme) for variant, seed in trainings]
    table = join_tables(PREDICTIONS, parts)
    reader = InputReader(place.release_dir, place.scheme)
    scored = {scene_id for split in SCORED for scene_id in scenes_of_split(reader, split)}
    is_scored = [parse_candidate_id(name).scene_id in scored for name in table["candidate_id"].to_pylist()]
    sidecar = write_table(PREDICTIONS, table.filter(pa.array(is_scored)), path, made_from, of=place.tier)
    log(f"{TREE_PREDICTIONS}: {sidecar.rows:,} rows, {path}")


def _of_release(place: Place) -> dict[str, str]:
    scheme = {} if place.scheme is SplitScheme.SCENE else {SCHEME_OF_PREDICTIONS: place.scheme.value}
    return {"release": Release.open(place.release_dir).manifest.release_hash, "scored": " ".join(SCORED), **scheme}


def _recorded(key: RankerKey) -> str:
    return f"ranker.{_short(key)}"


def _short(key: RankerKey) -> str:
    """`local.42`: a ranker among those of a tier."""
    return f"{key.variant.value}.{key.seed}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line: 0 where every chosen ranker is trained and scored, 1 where one could not be, 130 where it was interrupted."""
    about, _, more = (__doc__ or "").partition("\n")
    parser = argparse.ArgumentParser(prog="python -m assets_def.rankers", description=about, epilog=more.rpartition("\n\n")[2])
    parser.add_argument("tier", choices=TIERS)
    parser.add_argument("--only", nargs="+", default=(), metavar="RANKER", help="variants, or variant.seed, such as local or full.42 (all)")
    parser.add_argument("--split", default=SplitScheme.SCENE.value, help=f"one of {', '.join(scheme.value for scheme in SplitScheme)}")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="trainings side by side, one thread each")
    chosen = parser.parse_args(arguments)

    def work() -> None:
        scheme = scheme_named(chosen.split)
        keys = keys_of(chosen.tier, scheme, chosen.only)
        make_rankers(Place.of(Benchmark(), chosen.tier, scheme), keys, chosen.workers)

    return exit_code_of(work)


if __name__ == "__main__":
    sys.exit(main())
