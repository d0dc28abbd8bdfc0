"""Our rankers: what the hand of each candidate meets, through a small PointNet, and its derived geometry, into the paper's two heads."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import torch
from jaxtyping import Float, Int
from torch import nn
from torch.nn import functional

from model.features import FEATURES, POSE_FEATURES, Feature
from model.hand_view import NEAR_PHASES
from model.inputs import ENVIRONMENT, OBSTACLE
from model.local_release import LocalInput
from model.local_settings import LocalSettings
from model.pointnet2 import PointwiseLayers
from model.ranker import Prediction, initialise
from model.settings import Variant

# Metres: of a workspace, of a hand, of a clearance, of a slip. A network that only sees the first cannot tell 5 mm apart.
SCALES_M = (0.5, 0.1, 0.02)
_N_OBJECT_VALUES = 3 + 2 + 3
_NUMBER = {feature.name: k for k, feature in enumerate(FEATURES)}


class LocalRanker(nn.Module):
    """Scores candidates from the five inputs, seen from the hand. Without points (`pose_only`) from poses alone.

    Initial weights depend on the seed and on the name of each parameter alone; without a seed they are left to be loaded.
    """

    def __init__(self, settings: LocalSettings, variant: Variant, seed: int | None) -> None:
        super().__init__()
        self.settings = settings
        self.variant = variant
        self.has_points = variant is Variant.LOCAL
        self.encoding = FeatureEncoding(FEATURES if self.has_points else POSE_FEATURES)
        n_features = self.encoding.n_values
        if self.has_points:
            self.object = PointNet(_N_OBJECT_VALUES, settings.point_widths)
            self.near = PointNet(3 + 2 * len(NEAR_PHASES) + 3 + 2, settings.point_widths)
            n_features += 3 * settings.point_widths[-1]
        self.body = PointwiseLayers((n_features, *settings.widths))
        self.attention = GroupAttention(settings.widths[-1], settings.n_attention_heads) if settings.n_attention_heads else None
        self.plan_head = Head(settings.widths[-1], settings.head_width)
        self.exec_head = Head(settings.widths[-1], settings.head_width)
        if seed is not None:
            initialise(self, seed)

    def forward(self, x: LocalInput) -> Prediction:
        """Logits of every candidate of whole fixed-target groups."""
        seen = [self.encoding(x.features)]
        if self.has_points:
            up = {phase: _up_in_hand(x.features, name) for phase, name in (("pick", "grasp"), ("place", "composed"))}
            seen += self._object(x, up) + [self.near(_near_values(x, up["place"])).amax(-2)]
        fused = torch.cat(seen, -1)
        for linear, norm in zip(self.body.linear, self.body.norm, strict=True):
            fused = functional.dropout(functional.relu(norm(linear(fused))), self.settings.dropout, self.training)
        if self.attention is not None:
            fused = self.attention(fused, x.group)
        return Prediction(self.plan_head(fused).float(), self.exec_head(fused).float())

    def _object(self, x: LocalInput, up: dict[str, Float[torch.Tensor, "c 3"]]) -> list[Float[torch.Tensor, "c w"]]:
        """Points of the object in the hand, each with its height at pick and place, as their largest and their mean feature."""
        points_m = x.object_points_m.index_select(0, x.grasp)
        heights_m = []
        for phase, name in (("pick", "grasp"), ("place", "composed")):
            above_tcp_m = (points_m * up[phase][:, None]).sum(-1)
            heights_m.append(above_tcp_m + x.features[:, None, _NUMBER[f"{name}_z_m"]])
        gravity = up["place"][:, None].expand(-1, points_m.shape[1], -1)
        features = self.object(torch.cat([points_m / 0.05, torch.stack(heights_m, -1) / 0.1, gravity], -1))
        return [features.amax(-2), features.mean(-2)]


class FeatureEncoding(nn.Module):
    """Features as numbers of size 1: lengths on several scales, angles and directions as they are. Constants, so that nothing is fitted."""

    def __init__(self, features: Sequence[Feature]) -> None:
        super().__init__()
        self.lengths = [k for k, feature in enumerate(features) if feature.unit == "m"]
        self.others = [k for k, feature in enumerate(features) if feature.unit != "m"]
        self.n_values = len(self.others) + len(SCALES_M) * len(self.lengths)

    def forward(self, features: Float[torch.Tensor, "c f"]) -> Float[torch.Tensor, "c v"]:
        lengths_m = features[:, self.lengths]
        return torch.cat([features[:, self.others], lengths_m / SCALES_M[0], *(torch.tanh(lengths_m / scale_m) for scale_m in SCALES_M[1:])], -1)


class PointNet(nn.Module):
    """Linear and ReLU a point; no norm, which would cost more than both."""

    def __init__(self, n_values: int, widths: Sequence[int]) -> None:
        super().__init__()
        self.linear = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise((n_values, *widths)))

    def forward(self, x: Float[torch.Tensor, "*n a"]) -> Float[torch.Tensor, "*n b"]:
        for linear in self.linear:
            x = functional.relu(linear(x))
        return x


class Head(nn.Module):
    """One logit a candidate."""

    def __init__(self, n_features: int, width: int) -> None:
        super().__init__()
        self.hidden, self.out = nn.Linear(n_features, width), nn.Linear(width, 1)

    def forward(self, x: Float[torch.Tensor, "c f"]) -> Float[torch.Tensor, "c"]:
        logit: torch.Tensor = self.out(functional.relu(self.hidden(x))).squeeze(-1)
        return logit


class GroupAttention(nn.Module):
    """One layer of self-attention (Vaswani et al. 2017) over the candidates of each fixed-target group, added to what came in.

    A joint group is scored target by target, so that a candidate has one score in both tasks.
    """

    def __init__(self, width: int, n_heads: int) -> None:
        super().__init__()
        self.n_heads = n_heads
        self.norm = nn.LayerNorm(width)
        self.query_key_value, self.out = nn.Linear(width, 3 * width), nn.Linear(width, width)

    def forward(self, x: Float[torch.Tensor, "c w"], group: Int[torch.Tensor, "c"]) -> Float[torch.Tensor, "c w"]:
        n_groups = int(group[-1]) + 1
        sizes = torch.bincount(group, minlength=n_groups)
        place = torch.arange(len(group), device=x.device) - (sizes.cumsum(0) - sizes)[group]
        padded = x.new_zeros(n_groups, int(sizes.max()), x.shape[-1]).index_put((group, place), self.norm(x))
        is_there = torch.arange(padded.shape[1], device=x.device) < sizes[:, None]
        q, k, v = self.query_key_value(padded).unflatten(-1, (3, self.n_heads, -1)).permute(2, 0, 3, 1, 4)
        seen = functional.scaled_dot_product_attention(q, k, v, attn_mask=is_there[:, None, None])
        return x + self.out(seen.transpose(1, 2).flatten(-2))[group, place]


def _up_in_hand(features: Float[torch.Tensor, "c f"], pose: str) -> Float[torch.Tensor, "c 3"]:
    """The upward direction in the TCP frame of a pose among the features: the third row of its rotation."""
    row = [features[:, [_NUMBER[f"{pose}_{of}{axis}"] for axis in "xyz"]] for of in "yz"]
    across_z = row[0][:, 0] * row[1][:, 1] - row[0][:, 1] * row[1][:, 0]
    return torch.stack([across_z, row[0][:, 2], row[1][:, 2]], -1)


def _near_values(x: LocalInput, up: Float[torch.Tensor, "c 3"]) -> Float[torch.Tensor, "c m v"]:
    """Where a near point is, how far from the hand on two scales, which way is up, and what it is; zero where there is none."""
    n = x.near_m.shape[1]
    gaps_m = x.near_m[..., 3:]
    kinds = torch.stack([x.near_types == OBSTACLE, x.near_types == ENVIRONMENT], -1).to(gaps_m.dtype)
    values = [x.near_m[..., :3] / SCALES_M[1], torch.tanh(gaps_m / SCALES_M[1]), torch.tanh(gaps_m / SCALES_M[2]), up[:, None].expand(-1, n, -1), kinds]
    return torch.cat(values, -1) * (x.near_types >= 0)[..., None]
