"""S1 by the number of scenes that a ranker was trained on: trains what is missing of some sizes and writes table `learning_curve`.

`python -m assets_def.learning_curve full [--only local full] [--scenes 46 115 230 460] [--workers 2]`

One seed a size; rankers of all training scenes are those of `make rankers`, as far as they are there. What the table says of sizes and
variants that are not asked for stays, if it is of this release; the report of that name is `make reports`'.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import metadata
from itertools import groupby
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from assets_def.partitions import RankerKey
from assets_def.ranker_assets import SCORING_CODE_VERSION
from assets_def.ranker_training import RankersError, exit_code_of, folder_name, settings_of, train_all
from assets_def.rankers import Place, keys_of, make_whole
from assets_def.resources import Benchmark
from model.checkpoint import identity_of, is_checkpoint_of
from model.inputs import InputReader, contract_hash, scenes_of_split
from model.scoring import score
from model.settings import TrainingSettings, Variant, settings_to_dict
from pipelines.running.lock import locked
from reports.learning_curve import learning_curve_table
from splits.release_reader import Release
from tables.identity import TIERS
from tables.schemas import LEARNING_CURVE
from tables.sidecar import read_sidecar
from tables.store import join_tables, read_table, write_table
from tables.vocabulary import Split, SplitScheme

# Of 757 on `full`: doublings, about; the first is all of `pilot`.
SIZES = (46, 115, 230, 460)
VARIANTS = (Variant.LOCAL.value, Variant.FULL.value)


@dataclass(frozen=True, slots=True)
class SizedRanker:
    """One training of the curve: a ranker of the first `n` training scenes in hash order; the last of a curve saw them all."""

    place: Place
    key: RankerKey
    n: int
    is_whole: bool = False

    @property
    def settings(self) -> TrainingSettings:
        return settings_of(self.key, 0 if self.is_whole else self.n)

    @property
    def folder(self) -> Path | None:
        """Of its checkpoint; None where it is not trained."""
        if self.is_whole:
            return self.place.checkpoint(self.key)
        identity = identity_of(self.place.release_dir, self.key.variant, self.key.seed, self.settings, self.place.scheme)
        folder = self.folder_of_size(self.place, self.n) / folder_name(self.key)
        return folder if is_checkpoint_of(folder, identity) else None

    @staticmethod
    def folder_of_size(place: Place, n: int) -> Path:
        return place.trained / f"of-{n}-scenes"

    @property
    def recorded(self) -> tuple[str, str]:
        """`training.local.46.42` and the SHA-256 of its settings, for the record of the table."""
        settings = json.dumps(settings_to_dict(self.settings), sort_keys=True)
        return f"training.{self.key.variant.value}.{self.n}.{self.key.seed}", hashlib.sha256(settings.encode()).hexdigest()


def curve_of(place: Place, keys: Sequence[RankerKey], sizes: Sequence[int] = ()) -> list[SizedRanker]:
    """Every training of a curve, of all scenes too.

    Args:
        keys: one ranker a variant.
        sizes: numbers of training scenes; without any the usual ones that are smaller than the train split, or its quarter and half.
    """
    n_all = len(scenes_of_split(InputReader(place.release_dir), Split.TRAIN.value))
    sizes = sizes or [n for n in SIZES if n < n_all] or sorted({max(1, n_all // 4), max(1, n_all // 2)} - {n_all})
    return [*(SizedRanker(place, key, n) for n in sorted(sizes) for key in keys), *(SizedRanker(place, key, n_all, True) for key in keys)]


def curve_keys(tier: str, only: Sequence[str] = VARIANTS) -> list[RankerKey]:
    """The first training of each variant; raises RankersError as `keys_of`."""
    return list({key.variant: key for key in reversed(keys_of(tier, SplitScheme.SCENE, only))}.values())


def made_from(curve: Sequence[SizedRanker]) -> dict[str, str]:
    """What decides the rows of a curve of at least one training."""
    return _of_release(curve[0].place) | dict(sorted(ranker.recorded for ranker in curve))


def curve_table(curve: Sequence[SizedRanker], n_workers: int, log: Callable[[str], Any] = print, tells_epochs: bool = True) -> pa.Table:
    """Train what is missing of a curve, size by size, and score the validation split with it.

    Rankers of all scenes are those of the tier, and must be there.

    Raises:
        RankersError: a training that failed; the others are kept.
        PlaceBenchError: a release that cannot be read, made whole or trained on.
    """
    place = curve[0].place
    make_whole(place, n_workers, log)
    with locked(place.trained / ".curve.lock", f"learning curve of {place.tier}"):
        for n, of_size in groupby((ranker for ranker in curve if not ranker.is_whole), key=lambda ranker: ranker.n):
            rankers = list(of_size)
            missing = [ranker.key for ranker in rankers if ranker.folder is None]
            log(f"{n} scenes: {len(rankers) - len(missing)} of {len(rankers)} trained")
            if missing:
                out = SizedRanker.folder_of_size(place, n)
                train_all(place.release_dir, missing, place.scheme, out, n_workers, log, n, tells_epochs)
    scored: dict[int, list[pa.Table]] = {}
    for ranker in curve:
        folder = ranker.folder
        if folder is None:
            name = folder_name(ranker.key)
            raise RankersError(f"{name} of {ranker.n} scenes is not trained, must be: make rankers ONLY={ranker.key.variant}")
        scored.setdefault(ranker.n, []).append(score(place.release_dir, folder, "cpu", (Split.VALIDATION.value,)))
    release = Release.open(place.release_dir)
    return learning_curve_table(scored, release.table("candidates"), release.table("splits"))


def make_learning_curve(
    place: Place, keys: Sequence[RankerKey], sizes: Sequence[int], n_workers: int, log: Callable[[str], Any] = print
) -> None:
    """Publish the table of a curve, without rankers of all scenes that are not there, beside what it says of other trainings.

    Raises:
        RankersError, PlaceBenchError: as `curve_table`.
    """
    curve = [ranker for ranker in curve_of(place, keys, sizes) if not ranker.is_whole or ranker.folder is not None]
    table, record = curve_table(curve, n_workers, log), made_from(curve)
    path = place.beside / f"{LEARNING_CURVE.name}.parquet"
    if path.exists() and _of_release(place).items() <= (theirs := read_sidecar(path).made_from).items():
        before = read_table(LEARNING_CURVE, path, verify=True)
        table = join_tables(LEARNING_CURVE, [before.filter(pc.invert(pc.is_in(_trainings(before), _trainings(table)))), table])
        record = theirs | record
    sidecar = write_table(LEARNING_CURVE, table, path, record, of=place.tier)
    log(f"{LEARNING_CURVE.name}: {len(_trainings(table).unique())} trainings, {sidecar.rows:,} rows, {path}")


def _of_release(place: Place) -> dict[str, str]:
    """What all trainings of a curve have in common."""
    release_hash = Release.open(place.release_dir).manifest.release_hash
    return {"code": SCORING_CODE_VERSION, "contract": contract_hash(), "engine.torch": metadata.version("torch"), "release": release_hash}


def _trainings(table: pa.Table) -> pa.Array:
    """`local 46 42`: which training each row is of."""
    parts = [table[name].cast(pa.string()) for name in ("variant", "n_train_scenes", "seed")]
    return pc.binary_join_element_wise(*parts, " ").combine_chunks()


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line: 0 where every size is trained and scored, 1 where one could not be, 130 where it was interrupted."""
    about, _, more = (__doc__ or "").partition("\n")
    parser = argparse.ArgumentParser(prog="python -m assets_def.learning_curve", description=about, epilog=more.rpartition("\n\n")[2])
    parser.add_argument("tier", choices=TIERS)
    parser.add_argument("--only", nargs="+", default=VARIANTS, metavar="VARIANT", help=f"variants ({', '.join(VARIANTS)})")
    parser.add_argument(
        "--scenes", nargs="+", type=int, default=(), metavar="N", help="training scenes, beside all of them (46 115 230 460)"
    )
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="trainings side by side, one thread each")
    chosen = parser.parse_args(arguments)

    def work() -> None:
        place = Place.of(Benchmark(), chosen.tier, SplitScheme.SCENE)
        make_learning_curve(place, curve_keys(chosen.tier, chosen.only), chosen.scenes, chosen.workers)

    return exit_code_of(work)


if __name__ == "__main__":
    sys.exit(main())
