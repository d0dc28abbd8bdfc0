"""Trainings side by side: a process each with one thread, told epoch by epoch; which rankers there are is rankers.py's."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

from assets_def.partitions import RankerKey
from assets_def.resources import REPOSITORY
from model.networks import settings_named
from model.optimisation import HistoryRow
from model.settings import TrainingSettings
from model.training import train
from pipelines.running.workers import run_units
from tables.errors import INTERRUPTED, PlaceBenchError
from tables.vocabulary import SplitScheme

# Beside the code, by tier, split scheme where it is not the paper's, variant and seed.
SHIPPED = REPOSITORY / "model" / "checkpoints"


class RankersError(PlaceBenchError, RuntimeError):
    """Rankers that could not be trained, or a choice that names none."""


def exit_code_of(work: Callable[[], object]) -> int:
    """What a command that trains returns: 0, 1 with one line where it could not, 130 where it was interrupted."""
    try:
        work()
    except PlaceBenchError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted; finished epochs are kept, the same command continues there", file=sys.stderr)
        return INTERRUPTED
    return 0


def settings_of(key: RankerKey, n_train_scenes: int = 0) -> TrainingSettings:
    """What a ranker of a tier is trained with on two cores: ours at their full size on `full`.

    Args:
        n_train_scenes: how many of the training scenes it sees; 0: all.
    """
    name = "light" if key.tier != "full" else "full" if key.variant.is_local else "cpu"
    return replace(settings_named(name, key.variant), n_train_scenes=n_train_scenes)


def folder_name(key: RankerKey) -> str:
    """`local-42`: of a checkpoint."""
    return f"{key.variant.value}-{key.seed}"


def train_all(
    release_dir: Path,
    keys: Sequence[RankerKey],
    scheme: SplitScheme,
    out: Path,
    n_workers: int,
    log: Callable[[str], Any] = print,
    n_train_scenes: int = 0,
    tells_epochs: bool = True,
) -> None:
    """Train rankers, each into a folder of its name below `out`, as many at once as there are workers.

    Args:
        n_workers: processes; 0 trains in this one, one after the other. Weights do not depend on it.
        n_train_scenes: how many of the training scenes they see; 0: all.
        tells_epochs: whether a line is printed after each epoch.

    Raises:
        RankersError: a training that failed, with its reason; the others are kept.
    """
    units = [(release_dir, key, scheme, out / folder_name(key), n_train_scenes, tells_epochs) for key in keys]
    errors = []
    with closing(run_units(_train, units, min(n_workers, len(units)), units_per_life=1)) as outcomes:
        for outcome in outcomes:
            name = folder_name(keys[outcome.index])
            if outcome.error is None:
                log(f"{name}: {outcome.value}, {outcome.core_ms / 6e4:.1f} core-min")
            else:
                errors.append(f"{name}: {outcome.error.strip().splitlines()[0]}")
    if errors:
        raise RankersError(f"{len(errors)} of {len(units)} trainings failed, must be 0: {min(errors)}")


def _train(release_dir: Path, key: RankerKey, scheme: SplitScheme, out_dir: Path, n_train_scenes: int, tells_epochs: bool) -> str:
    """In a worker: one training, told epoch by epoch; returns what was chosen."""
    settings = settings_of(key, n_train_scenes)
    start_s, done = time.perf_counter(), [0]

    def tell(row: HistoryRow) -> None:
        done[0] += 1
        left_s = (time.perf_counter() - start_s) / done[0] * (settings.n_epochs - 1 - row["epoch"])
        shown = ", ".join(f"{task} S1 {row[f'{task}_s1']:.3f}" for task in ("joint", "fixed") if row[f"{task}_s1"] is not None)
        print(f"{folder_name(key)}: epoch {row['epoch'] + 1} of {settings.n_epochs}, {shown}, about {left_s / 60:.0f} min left", flush=True)

    result = train(
        release_dir,
        key.variant,
        key.seed,
        settings,
        out_dir,
        scheme=scheme,
        device="cpu",
        resume=True,
        on_epoch=tell if tells_epochs else None,
    )
    return f"epoch {result.best_epoch + 1} by {result.selected_by}, {result.n_parameters:,} parameters"
