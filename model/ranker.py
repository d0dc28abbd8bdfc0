"""The ranker: scene feature and three pose branches, fused, into a planning head and an execution head."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Float32, Int
from torch import nn
from torch.nn import functional

from model.pointnet2 import PointNet2, PointwiseLayers
from model.settings import RankerSettings, Variant
from tables.identity import rng_for

N_GRASP_FEATURES, N_RELATIVE_FEATURES, N_TARGET_FEATURES = 256, 128, 128
FUSION_WIDTHS = (1024, 512, 256)


@dataclass(frozen=True, slots=True)
class ModelInput:
    """The five inputs of the candidates of g fixed-target groups: the first four fields are the typed cloud and its neighbourhoods.

    Poses are 9 numbers: position in metres and the first two columns of the rotation matrix. A target pose belongs to a group.
    """

    points_m: Float[torch.Tensor, "g n 3"]
    point_types: Int[torch.Tensor, "g n"]
    neighbours_1: Int[torch.Tensor, "g s1 k1"]
    neighbours_2: Int[torch.Tensor, "g s2 k2"]
    target_pose: Float[torch.Tensor, "g 9"]
    grasp_pose: Float[torch.Tensor, "c 9"]
    object_relative_pose: Float[torch.Tensor, "c 9"]
    group: Int[torch.Tensor, "c"]  # the group of each candidate


@dataclass(frozen=True, slots=True)
class Prediction:
    """Logits of the heads. The direct variant has no planning head: its one head, the final success, stands in `exec_logit`."""

    plan_logit: Float[torch.Tensor, "c"] | None
    exec_logit: Float[torch.Tensor, "c"]

    @property
    def log_p_plan(self) -> Float[torch.Tensor, "c"]:
        """0 for the direct variant, whose score is its one log probability."""
        return torch.zeros_like(self.exec_logit) if self.plan_logit is None else functional.logsigmoid(self.plan_logit)

    @property
    def log_p_exec(self) -> Float[torch.Tensor, "c"]:
        return functional.logsigmoid(self.exec_logit)

    @property
    def score(self) -> Float[torch.Tensor, "c"]:
        """log p_success = log p_plan + log p_exec|plan; logsigmoid keeps it finite where p underflows."""
        return self.log_p_plan + self.log_p_exec


class Ranker(nn.Module):
    """Scores candidates from the five inputs. Initial weights depend on the seed and on the name of each parameter alone.

    Without a seed the weights are left to be loaded.
    """

    def __init__(self, settings: RankerSettings, variant: Variant, seed: int | None) -> None:
        super().__init__()
        self.settings = settings
        self.variant = variant
        in_workspace = (settings.workspace_centre_m, settings.workspace_scale_m)
        self.scene = PointNet2(settings)
        self.grasp = PoseBranch(N_GRASP_FEATURES, *in_workspace, settings.n_frequencies)
        self.relative = PoseBranch(N_RELATIVE_FEATURES, (0.0, 0.0, 0.0), settings.hand_scale_m, settings.n_frequencies)
        self.target = PoseBranch(N_TARGET_FEATURES, *in_workspace, settings.n_frequencies)
        self.fusion_1, self.fusion_2 = PointwiseLayers(FUSION_WIDTHS[:2]), PointwiseLayers(FUSION_WIDTHS[1:])
        self.plan_head = None if variant is Variant.DIRECT else nn.Linear(FUSION_WIDTHS[-1], 1)
        self.exec_head = nn.Linear(FUSION_WIDTHS[-1], 1)
        if seed is not None:
            initialise(self, seed)

    def fit(self, release: Any) -> None:
        """Takes nothing from the training candidates: its normalisation is constant."""

    def of_members(self, x: ModelInput) -> Prediction:
        """It has one member: itself."""
        prediction: Prediction = self(x)
        return prediction

    @property
    def n_members(self) -> int:
        return 1

    def forward(self, x: ModelInput) -> Prediction:
        """Logits of every candidate; each cloud and each target is encoded once and shared by its candidates."""
        scene = self.scene(x.points_m, x.point_types, x.neighbours_1, x.neighbours_2)
        shared = torch.cat([scene, self.target(x.target_pose)], -1).index_select(0, x.group)
        grasp = self.grasp(x.grasp_pose)
        if self.variant is Variant.NO_OBJECT_RELATIVE:
            relative = grasp.new_zeros(len(grasp), N_RELATIVE_FEATURES)
        else:
            relative = self.relative(x.object_relative_pose)
        fused = torch.cat([shared, grasp, relative], -1)
        for layers in (self.fusion_1, self.fusion_2):
            fused = functional.dropout(layers(fused), self.settings.dropout, self.training)
        plan_logit = None if self.plan_head is None else self.plan_head(fused).squeeze(-1).float()
        return Prediction(plan_logit, self.exec_head(fused).squeeze(-1).float())


class PoseBranch(nn.Module):
    """Position and 6-D rotation (Zhou et al. 2019) through Fourier features (Tancik et al. 2020) and two layers."""

    frequencies: torch.Tensor

    def __init__(self, n_features: int, centre_m: tuple[float, float, float], scale_m: float, n_frequencies: int) -> None:
        super().__init__()
        self.centre_m = centre_m
        self.scale_m = scale_m
        # Octaves from a wave twice as long as the scaled range: fixed, so that no draw decides what the branch can resolve.
        self.register_buffer("frequencies", math.pi * 2.0 ** torch.arange(n_frequencies), persistent=False)
        self.layers = PointwiseLayers((9 * (1 + 2 * n_frequencies), n_features, n_features))

    def forward(self, pose: Float[torch.Tensor, "*n 9"]) -> Float[torch.Tensor, "*n f"]:
        position = (pose[..., :3] - pose.new_tensor(self.centre_m)) / self.scale_m
        scaled = torch.cat([position, pose[..., 3:]], -1)
        waves = (scaled[..., None] * self.frequencies).flatten(-2)
        features: torch.Tensor = self.layers(torch.cat([scaled, waves.sin(), waves.cos()], -1))
        return features


def pose9(T: Float[np.ndarray, "*n 4 4"]) -> Float32[np.ndarray, "*n 9"]:
    """Position and the first two columns of the rotation, the continuous 6-D representation of Zhou et al. 2019."""
    columns = np.swapaxes(T[..., :3, :2], -1, -2).reshape(*T.shape[:-2], 6)
    return np.concatenate([T[..., :3, 3], columns], axis=-1).astype(np.float32)


def initialise(module: nn.Module, seed: int) -> None:
    """Uniform in +-1/sqrt(fan-in) (He et al. 2015 with torch's default slope), drawn per parameter name: no order or device matters."""
    for name, layer in module.named_modules():
        if isinstance(layer, nn.Linear):
            bound = 1.0 / math.sqrt(layer.in_features)
            for part, parameter in (("weight", layer.weight), ("bias", layer.bias)):
                drawn = rng_for(seed, "ranker-init", name, part).uniform(-bound, bound, tuple(parameter.shape))
                parameter.data.copy_(torch.from_numpy(drawn))
        elif isinstance(layer, nn.Embedding):
            layer.weight.data.copy_(torch.from_numpy(rng_for(seed, "ranker-init", name).normal(size=tuple(layer.weight.shape))))
