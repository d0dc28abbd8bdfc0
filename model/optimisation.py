"""A training from epoch to epoch: the steps, how good each epoch was, and the state it resumes from; files are handled in training.py."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Int
from torch import nn

from model.batches import scene_batches, supervision
from model.checkpoint import Progress, TrainingIdentity, Weights, check_weights
from model.errors import CheckpointError, TrainingError
from model.grouping import Grouping
from model.labels import Labels
from model.losses import Losses, losses
from model.networks import Network, build_network
from model.scoring import predict, success_at_1
from model.settings import TrainingSettings
from tables.identity import order_key

HistoryRow = dict[str, Any]

_MOMENTS = {"step", "exp_avg", "exp_avg_sq"}  # what torch.optim.AdamW keeps of each parameter


@dataclass(frozen=True, slots=True)
class Examples:
    """Scenes of one split: inputs and labels."""

    release: Grouping
    labels: Labels
    n_candidates: int


class Run:
    """The state of a training between epochs."""

    def __init__(self, identity: TrainingIdentity, training: Examples, validation: Examples, device: torch.device) -> None:
        self.identity, self.training, self.validation, self.device = identity, training, validation, device
        settings = identity.settings
        network = build_network(settings, identity.variant, identity.seed)
        network.fit(training.release)
        self.ranker = network.to(device)
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
        if not math.isfinite(row["validation_loss"]):
            raise _diverged(f"epoch {epoch}: validation loss", row["validation_loss"], settings)
        is_best = self.best_epoch < 0 or quality_of(row) > quality_of(self.history[self.best_epoch])
        row["is_best"] = is_best
        self.history.append(row)
        if is_best:
            self.best_epoch = epoch
            self.best_weights = {name: tensor.detach().cpu().clone() for name, tensor in self.ranker.state_dict().items()}
        return row

    def _step(self, step: int, groups: Int[np.ndarray, "g"]) -> Losses:
        settings = self.identity.settings
        for parameters in self.optimiser.param_groups:
            parameters["lr"] = learning_rate_at(step, self.steps_per_epoch * settings.n_epochs, settings)
        # The dropout mask depends on seed and step alone, so a resumed training draws the same ones.
        torch.manual_seed(order_key(self.identity.seed, "ranker-dropout", step))
        x = self.training.release.network_input(groups, self.device)
        labels = supervision(self.training.release, self.training.labels, groups, self.device)
        with torch.autocast(self.device.type, torch.bfloat16, enabled=settings.use_bfloat16 and self.device.type == "cuda"):
            prediction = self.ranker.of_members(x)
        found = losses(prediction, labels.repeated(self.ranker.n_members), settings)
        if not bool(torch.isfinite(found.total)):
            raise _diverged(f"step {step}: loss", found.total.item(), settings)
        self.optimiser.zero_grad(set_to_none=True)
        torch.autograd.backward(found.total)
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

    def restore(self, progress: Progress, tensors: Weights, path: Path) -> None:
        """Take over a stored state; raises CheckpointError where it is not one of this network. `path` is for the message."""

        def under(prefix: str) -> Weights:
            return {name.removeprefix(prefix): tensor for name, tensor in tensors.items() if name.startswith(prefix)}

        for weights in (under("weights/"), under("best/")):
            check_weights(self.ranker, weights, path)
        self.ranker.load_state_dict(under("weights/"))
        self.best_weights = under("best/")
        for name, parameter in self.ranker.named_parameters():
            moments = under(f"moments/{name}/")
            if moments:
                if moments.keys() != _MOMENTS or any(moments[key].shape != parameter.shape for key in _MOMENTS - {"step"}):
                    raise CheckpointError(f"{path}: moments of {name} are {sorted(moments)}, must be {sorted(_MOMENTS)} of its shape")
                # torch keeps the step count on the CPU and the moments beside the parameter.
                self.optimiser.state[parameter] = {k: v if k == "step" else v.to(self.device) for k, v in moments.items()}
        self.history, self.best_epoch = list(progress.history), progress.best_epoch


def learning_rate_at(step: int, n_steps: int, settings: TrainingSettings) -> float:
    """Linear warm-up, then a half cosine to zero (Loshchilov and Hutter 2017)."""
    n_warmup = max(1, round(settings.warmup_share * n_steps))
    if step < n_warmup:
        return settings.learning_rate * (step + 1) / n_warmup
    return settings.learning_rate * 0.5 * (1.0 + math.cos(math.pi * (step - n_warmup) / max(1, n_steps - n_warmup)))


def quality_of(row: HistoryRow) -> tuple[float, float, float]:
    """Orders epochs: fixed-target S1, then joint S1, then the lower loss."""
    return row["fixed_s1"] or 0.0, row["joint_s1"] or 0.0, -row["validation_loss"]


def _validated(ranker: Network, validation: Examples, settings: TrainingSettings, device: torch.device) -> HistoryRow:
    """Loss and S1 on the validation scenes, and what may choose the best epoch."""
    row: HistoryRow = {"validation_loss": None, "fixed_s1": None, "joint_s1": None, "n_fixed_covered": 0, "n_joint_covered": 0}
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


def _diverged(what: str, value: float, settings: TrainingSettings) -> TrainingError:
    """Values that are read are finite, so it is the optimisation that went astray."""
    return TrainingError(f"{what} {value}, must be finite; lower learning_rate ({settings.learning_rate})")
