"""Training of one ranker: seeded, resumable, the best epoch chosen on validation scenes; test scenes are never read.

`python -m model.training --release DIR --variant full --seed 42 --setting light --out DIR [--split object]`
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from model.checkpoint import (
    RESUME,
    check_checkpoint_writable,
    drop_resume_state,
    identity_of,
    load_resume_state,
    save_checkpoint,
    save_resume_state,
)
from model.determinism import deterministic, device_named
from model.errors import RankerError, TrainingError
from model.inputs import InputReader, ReleaseInputs, read_inputs, scenes_of_split
from model.labels import Labels, read_labels
from model.networks import encode, settings_named
from model.optimisation import Examples, HistoryRow, Run
from model.settings import TrainingSettings, Variant, check_seed, scheme_named, variant_named
from tables.identity import order_key
from tables.vocabulary import Split, SplitScheme


@dataclass(frozen=True, slots=True)
class TrainingResult:
    """Where the checkpoint is and how it came to be; `history` has one row an epoch and no wall-clock times."""

    checkpoint_dir: Path
    best_epoch: int
    selected_by: str
    history: tuple[HistoryRow, ...]
    n_epochs_resumed: int  # epochs taken over from an interrupted training
    n_parameters: int
    n_train_candidates: int
    n_validation_candidates: int


def train(
    release_dir: Path,
    variant: Variant | str,
    seed: int,
    settings: TrainingSettings,
    out_dir: Path,
    *,
    scheme: SplitScheme | str = SplitScheme.SCENE,
    device: str = "auto",
    resume: bool = False,
    on_epoch: Callable[[HistoryRow], None] | None = None,
) -> TrainingResult:
    """Train one variant with one seed and write its checkpoint into `out_dir`.

    After each epoch the validation scenes are scored, and the state to resume from is published. The best epoch has the highest
    fixed-target S1 on validation; ties go to joint S1, then to the lower validation loss, then to the earlier epoch. Where no validation
    group is covered the loss alone decides; `selected_by` says which. Nothing is written before all that is read has been checked.

    Args:
        scheme: by what scenes are dealt to train, validation and test; the paper's split without it.
        resume: continue from the state in `out_dir` if it is of this very training (variant, seed, settings, scheme, release); the result
            is that of an uninterrupted training.
        on_epoch: called with each history row.

    Raises:
        RankerError: bad settings or release, no training or no validation candidates, no place to write to, a loss that is not finite.
    """
    variant, scheme = variant_named(variant), scheme_named(scheme)
    chosen_device = device_named(device)
    check_seed(seed)
    reader = InputReader(release_dir, scheme)
    scenes = {
        Split.TRAIN: _training_scenes(reader, settings.n_train_scenes),
        Split.VALIDATION: scenes_of_split(reader, Split.VALIDATION.value),
    }
    read = [_read_split(reader, split, ids) for split, ids in scenes.items()]
    identity = identity_of(release_dir, variant, seed, settings, scheme)
    check_checkpoint_writable(out_dir)
    training, validation = (_examples(inputs, labels, settings, variant) for inputs, labels in read)

    with deterministic(settings, chosen_device):
        run = Run(identity, training, validation, chosen_device)
        found = load_resume_state(out_dir, identity) if resume else None
        if found is not None:
            run.restore(*found, out_dir / RESUME)
        n_epochs_resumed = run.n_epochs_done
        while run.n_epochs_done < settings.n_epochs:
            row = run.epoch()
            save_resume_state(out_dir, identity, run.progress, run.resume_tensors())
            if on_epoch is not None:
                on_epoch(row)
    save_checkpoint(out_dir, identity, run.progress, run.best_weights, reader.selected)
    drop_resume_state(out_dir)
    return TrainingResult(
        checkpoint_dir=out_dir,
        best_epoch=run.best_epoch,
        selected_by=run.selected_by,
        history=tuple(run.history),
        n_epochs_resumed=n_epochs_resumed,
        n_parameters=sum(p.numel() for p in run.ranker.parameters()),
        n_train_candidates=training.n_candidates,
        n_validation_candidates=validation.n_candidates,
    )


def _training_scenes(reader: InputReader, n_scenes: int) -> tuple[str, ...]:
    """Ids of the scenes of the training split, or of some of them; raises TrainingError where there are not so many."""
    scenes = scenes_of_split(reader, Split.TRAIN.value)
    if n_scenes > len(scenes):
        raise TrainingError(f"n_train_scenes: {n_scenes}, must be at most {len(scenes)}, the scenes of the training split")
    return tuple(sorted(sorted(scenes, key=lambda scene_id: order_key(0, "train-scenes", scene_id))[: n_scenes or None]))


def _read_split(reader: InputReader, split: Split, scene_ids: Sequence[str]) -> tuple[ReleaseInputs, Labels]:
    """Inputs and labels of the scenes of a split; raises TrainingError where none has a candidate."""
    inputs = read_inputs(reader, scene_ids)
    if not inputs.candidate_ids:
        of = "" if reader.scheme is SplitScheme.SCENE else f" of scheme {reader.scheme.value}"
        raise TrainingError(f"{reader.release_dir}: the {split.value} split{of} has 0 candidates, must have at least 1")
    return inputs, read_labels(reader.release_dir, inputs.candidate_ids)


def _examples(inputs: ReleaseInputs, labels: Labels, settings: TrainingSettings, variant: Variant) -> Examples:
    return Examples(encode(inputs, settings, variant), labels, len(inputs.candidate_ids))


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m model.training", description="Train a ranker on a release.")
    parser.add_argument("--release", type=Path, required=True, help="folder with <table>.parquet")
    parser.add_argument("--variant", default=Variant.FULL.value, help=f"one of {', '.join(v.value for v in Variant)}")
    parser.add_argument("--seed", type=int, default=42)
    parser.add_argument("--split", default=SplitScheme.SCENE.value, help=f"one of {', '.join(s.value for s in SplitScheme)}")
    parser.add_argument(
        "--setting", default="full", help="light (mini), cpu (the paper's on two cores) or full (the paper's on a GPU; ours)"
    )
    parser.add_argument("--epochs", type=int, help="number of epochs, instead of that of the setting")
    parser.add_argument("--train-scenes", type=int, default=0, metavar="N", help="the first N training scenes in hash order (all)")
    parser.add_argument("--out", type=Path, required=True, help="checkpoint folder to write")
    parser.add_argument("--device", default="auto", help="auto, cpu or cuda")
    parser.add_argument("--resume", action="store_true", help="continue an interrupted training in --out")
    options = parser.parse_args(arguments)
    start_s = time.perf_counter()
    try:
        settings = settings_named(options.setting, variant_named(options.variant))
        settings = replace(settings, n_train_scenes=options.train_scenes)
        if options.epochs is not None:
            settings = replace(settings, n_epochs=options.epochs)
        keywords = {"scheme": options.split, "device": options.device, "resume": options.resume}
        result = train(options.release, options.variant, options.seed, settings, options.out, on_epoch=_print_row, **keywords)
    except RankerError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    if options.resume:
        print(
            f"resumed after {result.n_epochs_resumed} epochs"
            if result.n_epochs_resumed
            else "found no state of this training, started afresh"
        )
    print(f"{result.checkpoint_dir}: epoch {result.best_epoch} by {result.selected_by}, {time.perf_counter() - start_s:.0f} s")
    return 0


def _print_row(row: HistoryRow) -> None:
    shown = {name: "-" if row[name] is None else f"{row[name]:.3f}" for name in ("train_loss", "validation_loss", "fixed_s1", "joint_s1")}
    print(f"epoch {row['epoch']:3d}", *(f"{name} {value}" for name, value in shown.items()), "*" if row["is_best"] else "", flush=True)


if __name__ == "__main__":
    sys.exit(main())
