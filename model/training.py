"""Training of one ranker: seeded, resumable, the best epoch chosen on validation scenes; test scenes are never read.

`python -m model.training --release DIR --variant full --seed 42 --setting light --out DIR`
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from model.batches import EncodedRelease, encode_release, model_input, scene_batches, supervision
from model.checkpoint import (
    CheckpointError,
    Progress,
    TrainingIdentity,
    drop_resume_state,
    identity_of,
    load_resume_state,
    save_checkpoint,
    save_resume_state,
)
from model.determinism import deterministic, device_named
from model.inputs import read_inputs, scenes_of_split
from model.labels import Labels, read_labels
from model.losses import Losses, losses
from model.ranker import Ranker
from model.scoring import predict, success_at_1
from model.settings import RankerError, RankerSettings, Variant, settings_named, variant_named
from tables.identity import order_key
from tables.vocabulary import Split

HistoryRow = dict[str, Any]
Weights = dict[str, torch.Tensor]


class TrainingError(RankerError):
    """A training that cannot start or that diverged."""


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


@dataclass(frozen=True, slots=True)
class _Examples:
    """Scenes of one split: inputs and labels."""

    release: EncodedRelease
    labels: Labels
    n_candidates: int


def train(
    release_dir: Path,
    variant: Variant | str,
    seed: int,
    settings: RankerSettings,
    out_dir: Path,
    *,
    device: str = "auto",
    resume: bool = False,
    on_epoch: Callable[[HistoryRow], None] | None = None,
) -> TrainingResult:
    """Train one variant with one seed and write its checkpoint into `out_dir`.

    After each epoch the validation scenes are scored, and the state to resume from is published. The best epoch has the highest
    fixed-target S1 on validation; ties go to joint S1, then to the lower validation loss, then to the earlier epoch. Where no validation
    group is covered the loss alone decides, and without validation scenes the last epoch is taken; `selected_by` says which.

    Args:
        resume: continue from the state in `out_dir` if it is of this very training (variant, seed, settings, release); the result is that
            of an uninterrupted training.
        on_epoch: called with each history row.

    Raises:
        RankerError: bad settings or release, no training candidates, a loss that is not finite.
    """
    variant = variant_named(variant)
    chosen_device = device_named(device)
    identity = identity_of(release_dir, variant, seed, settings)
    training = _examples(release_dir, Split.TRAIN, settings, variant)
    validation = _examples(release_dir, Split.VALIDATION, settings, variant)
    if training is None:
        raise TrainingError(f"{release_dir}: the train split has no candidates, must have at least 1")

    with deterministic(settings, chosen_device):
        run = _Run(identity, training, validation, chosen_device)
        found = load_resume_state(out_dir, identity) if resume else None
        if found is not None:
            run.restore(*found)
        n_epochs_resumed = run.n_epochs_done
        while run.n_epochs_done < settings.n_epochs:
            row = run.epoch()
            save_resume_state(out_dir, identity, run.progress, run.resume_tensors())
            if on_epoch is not None:
                on_epoch(row)
    save_checkpoint(out_dir, identity, run.progress, run.best_weights)
    drop_resume_state(out_dir)
    return TrainingResult(
        checkpoint_dir=out_dir,
        best_epoch=run.best_epoch,
        selected_by=run.selected_by,
        history=tuple(run.history),
        n_epochs_resumed=n_epochs_resumed,
        n_parameters=sum(p.numel() for p in run.ranker.parameters()),
        n_train_candidates=training.n_candidates,
        n_validation_candidates=validation.n_candidates if validation else 0,
    )


class _Run:
    """The state of a training between epochs."""

    def __init__(self, identity: TrainingIdentity, training: _Examples, validation: _Examples | None, device: torch.device) -> None:
        self.identity, self.training, self.validation, self.device = identity, training, validation, device
        settings = identity.settings
        self.ranker = Ranker(settings, identity.variant, identity.seed).to(device)
        self.optimiser = torch.optim.AdamW(self.ranker.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay)
        self.steps_per_epoch = math.ceil(training.release.n_scenes / settings.scenes_per_batch)
        self.history: list[HistoryRow] = []
        self.best_epoch = -1
        self.best_weights: Weights = {}

    @property
    def n_epochs_done(self) -> int:
        return len(self.history)

    @property
    def selected_by(self) -> str:
        return str(self.history[-1]["selected_by"])

    @property
    def progress(self) -> Progress:
        return Progress(self.n_epochs_done, self.best_epoch, self.selected_by, tuple(self.history))

    def epoch(self) -> HistoryRow:
        """One pass over the training scenes and one over the validation scenes."""
        epoch, settings = self.n_epochs_done, self.identity.settings
        self.ranker.train()
        terms = []
        for number, scenes in enumerate(scene_batches(self.training.release.n_scenes, settings, self.identity.seed, epoch)):
            found = self._step(epoch * self.steps_per_epoch + number, self.training.release.groups_of_scenes(scenes.tolist()))
            terms.append([term.item() for term in (found.plan, found.exec, found.rank, found.total)])
        means = np.mean(terms, axis=0).tolist()
        row: HistoryRow = {"epoch": epoch, "learning_rate": self.optimiser.param_groups[0]["lr"]}
        row |= dict(zip(("train_loss_plan", "train_loss_exec", "train_loss_rank", "train_loss"), means, strict=True))
        row |= _validated(self.ranker, self.validation, self.identity.settings, self.device)
        is_best = self.best_epoch < 0 or quality_of(row) > quality_of(self.history[self.best_epoch])
        row["is_best"] = is_best
        self.history.append(row)
        if is_best:
            self.best_epoch = epoch
            self.best_weights = {name: tensor.detach().cpu().clone() for name, tensor in self.ranker.state_dict().items()}
        return row

    def _step(self, step: int, groups: np.ndarray) -> Losses:
        settings = self.identity.settings
        for parameters in self.optimiser.param_groups:
            parameters["lr"] = learning_rate_at(step, self.steps_per_epoch * settings.n_epochs, settings)
        # The dropout mask depends on seed and step alone, so a resumed training draws the same ones.
        torch.manual_seed(order_key(self.identity.seed, "ranker-dropout", step))
        x = model_input(self.training.release, groups, self.device)
        labels = supervision(self.training.release, self.training.labels, groups, self.device)
        with torch.autocast(self.device.type, torch.bfloat16, enabled=settings.use_bfloat16 and self.device.type == "cuda"):
            prediction = self.ranker(x)
        found = losses(prediction, labels, settings)
        if not bool(torch.isfinite(found.total)):
            raise TrainingError(f"step {step}: loss {found.total.item()}, must be finite; lower learning_rate ({settings.learning_rate})")
        self.optimiser.zero_grad(set_to_none=True)
        found.total.backward()
        nn.utils.clip_grad_norm_(self.ranker.parameters(), settings.max_gradient_norm)
        self.optimiser.step()
        return found

    def resume_tensors(self) -> Weights:
        """Weights, best weights and optimiser moments under distinct names."""
        tensors = {f"weights/{name}": tensor for name, tensor in self.ranker.state_dict().items()}
        tensors |= {f"best/{name}": tensor for name, tensor in self.best_weights.items()}
        for name, parameter in self.ranker.named_parameters():
            tensors |= {f"moments/{name}/{key}": value for key, value in self.optimiser.state[parameter].items()}
        return tensors

    def restore(self, progress: Progress, tensors: Weights) -> None:
        def under(prefix: str) -> Weights:
            return {name.removeprefix(prefix): tensor for name, tensor in tensors.items() if name.startswith(prefix)}

        self.ranker.load_state_dict(under("weights/"))
        self.best_weights = under("best/")
        for name, parameter in self.ranker.named_parameters():
            moments = under(f"moments/{name}/")
            if moments:
                # torch keeps the step count on the CPU and the moments beside the parameter.
                self.optimiser.state[parameter] = {k: v if k == "step" else v.to(self.device) for k, v in moments.items()}
        self.history, self.best_epoch = list(progress.history), progress.best_epoch
        if self.best_epoch < 0 or self.n_epochs_done != progress.n_epochs_done:
            raise CheckpointError(f"resume state: {progress.n_epochs_done} epochs done, {self.n_epochs_done} in its history")


def learning_rate_at(step: int, n_steps: int, settings: RankerSettings) -> float:
    """Linear warm-up, then a half cosine to zero (Loshchilov and Hutter 2017)."""
    n_warmup = max(1, round(settings.warmup_share * n_steps))
    if step < n_warmup:
        return settings.learning_rate * (step + 1) / n_warmup
    return settings.learning_rate * 0.5 * (1.0 + math.cos(math.pi * (step - n_warmup) / max(1, n_steps - n_warmup)))


def _examples(release_dir: Path, split: Split, settings: RankerSettings, variant: Variant) -> _Examples | None:
    """Scenes of a split that have candidates, or None."""
    inputs = read_inputs(release_dir, scenes_of_split(release_dir, split.value))
    if not inputs.candidate_ids:
        return None
    labels = read_labels(release_dir, inputs.candidate_ids)
    return _Examples(encode_release(inputs, settings, variant), labels, len(inputs.candidate_ids))


def _validated(ranker: Ranker, validation: _Examples | None, settings: RankerSettings, device: torch.device) -> HistoryRow:
    """Loss and S1 on the validation scenes, and what may choose the best epoch."""
    row: HistoryRow = {"validation_loss": None, "fixed_s1": None, "joint_s1": None, "n_fixed_covered": 0, "n_joint_covered": 0}
    if validation is None:
        return row | {"selected_by": "last epoch (no validation scenes)"}
    release = validation.release
    groups = np.arange(len(release.group_scene))
    prediction = predict(ranker, release, groups)
    row["validation_loss"] = float(losses(prediction, supervision(release, validation.labels, groups, device), settings).total)
    score = prediction.score.cpu().numpy()
    group = np.repeat(groups, np.diff(release.group_start))
    success = validation.labels.success
    row["fixed_s1"], row["n_fixed_covered"] = success_at_1(score, success, group)
    row["joint_s1"], row["n_joint_covered"] = success_at_1(score, success, release.group_scene[group])
    return row | {"selected_by": "validation S1" if row["n_fixed_covered"] else "validation loss (no covered validation group)"}


def quality_of(row: HistoryRow) -> tuple[float, float, float]:
    """Orders epochs: fixed-target S1, then joint S1, then the lower loss; without validation scenes the later one is better."""
    if row["validation_loss"] is None:
        return 0.0, 0.0, float(row["epoch"])
    return row["fixed_s1"] or 0.0, row["joint_s1"] or 0.0, -row["validation_loss"]


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m model.training", description="Train a ranker on a release.")
    parser.add_argument("--release", type=Path, required=True, help="folder with <table>.parquet")
    parser.add_argument("--variant", default=Variant.FULL.value, help=f"one of {', '.join(v.value for v in Variant)}")
    parser.add_argument("--seed", type=int, default=42)
    parser.add_argument("--setting", default="full", help="light (mini, CPU) or full (GPU)")
    parser.add_argument("--epochs", type=int, help="instead of the setting's number of epochs")
    parser.add_argument("--out", type=Path, required=True, help="checkpoint folder to write")
    parser.add_argument("--device", default="auto", help="auto, cpu or cuda")
    parser.add_argument("--resume", action="store_true", help="continue an interrupted training in --out")
    options = parser.parse_args(arguments)
    start_s = time.perf_counter()
    try:
        settings = settings_named(options.setting)
        if options.epochs is not None:
            settings = replace(settings, n_epochs=options.epochs)
        keywords = {"device": options.device, "resume": options.resume}
        result = train(options.release, options.variant, options.seed, settings, options.out, on_epoch=_print_row, **keywords)
    except RankerError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
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
