"""S1 by the number of scenes that a ranker was trained on: trains what is missing of some sizes and writes table `learning_curve`.

`python -m assets_def.learning_curve full [--only local full] [--scenes 46 115 230 460] [--workers 2]`

One seed a size; rankers of all training scenes are those of `make rankers`, as far as they are there. What the table says of sizes and
variants that are not asked for stays, if it is of this release; the report of that name is `make reports`'.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from assets_def.partitions import RankerKey
from assets_def.ranker_training import exit_code_of, folder_name, settings_of, train_all
from assets_def.rankers import Place, keys_of, make_whole
from assets_def.resources import Benchmark
from model.checkpoint import identity_of, is_checkpoint_of
from model.inputs import InputReader, scenes_of_split
from model.scoring import score
from model.settings import Variant
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


def make_learning_curve(
    place: Place, keys: Sequence[RankerKey], sizes: Sequence[int], n_workers: int, log: Callable[[str], Any] = print
) -> None:
    """Train what is missing, size by size, and publish the table.

    Raises:
        RankersError: a training that failed; the others are kept.
        PlaceBenchError: a release that cannot be read, made whole or trained on.
    """
    make_whole(place, n_workers, log)
    with locked(place.trained / ".curve.lock", f"learning curve of {place.tier}"):
        for n in sizes:
            missing = [key for key in keys if not _is_trained(place, key, n)]
            log(f"{n} scenes: {len(keys) - len(missing)} of {len(keys)} trained")
            if missing:
                train_all(place.release_dir, missing, place.scheme, _folder(place, n), n_workers, log, n_train_scenes=n)
        folders = {n: [_folder(place, n) / folder_name(key) for key in keys] for n in sizes}
        n_all = len(scenes_of_split(InputReader(place.release_dir), Split.TRAIN.value))
        folders[n_all] = [folder for key in keys if (folder := place.checkpoint(key)) is not None]
        _publish(place, folders, log)


def _is_trained(place: Place, key: RankerKey, n: int) -> bool:
    identity = identity_of(place.release_dir, key.variant, key.seed, settings_of(key, n), place.scheme)
    return is_checkpoint_of(_folder(place, n) / folder_name(key), identity)


def _folder(place: Place, n: int) -> Path:
    return place.trained / f"of-{n}-scenes"


def _publish(place: Place, folders: Mapping[int, Sequence[Path]], log: Callable[[str], Any]) -> None:
    path = place.beside / f"{LEARNING_CURVE.name}.parquet"
    release = Release.open(place.release_dir)
    made_from = {"release": release.manifest.release_hash}
    splits = (Split.VALIDATION.value,)
    scored = {n: [score(place.release_dir, folder, "cpu", splits) for folder in own] for n, own in folders.items() if own}
    table = learning_curve_table(scored, release.table("candidates"), release.table("splits"))
    if path.exists() and made_from.items() <= read_sidecar(path).made_from.items():
        before = read_table(LEARNING_CURVE, path, verify=True)
        table = join_tables(LEARNING_CURVE, [before.filter(pc.invert(pc.is_in(_trainings(before), _trainings(table)))), table])
    sidecar = write_table(LEARNING_CURVE, table, path, made_from, of=place.tier)
    log(f"{LEARNING_CURVE.name}: {len(_trainings(table).unique())} trainings, {sidecar.rows:,} rows, {path}")


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
    parser.add_argument("--scenes", nargs="+", type=int, default=SIZES, metavar="N", help="training scenes, beside all of them")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="trainings side by side, one thread each")
    chosen = parser.parse_args(arguments)

    def work() -> None:
        keys = list({key.variant: key for key in reversed(keys_of(chosen.tier, SplitScheme.SCENE, chosen.only))}.values())
        make_learning_curve(Place.of(Benchmark(), chosen.tier, SplitScheme.SCENE), keys, sorted(chosen.scenes), chosen.workers)

    return exit_code_of(work)


if __name__ == "__main__":
    sys.exit(main())
