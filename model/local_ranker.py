"""Our rankers: what the hand of each candidate meets, through a small PointNet, and its derived geometry, into the paper's two heads.

Of the object in the hand the geometry tells extents, mean and levers. Its points told no more of known objects, and let the network know
them by heart (RANKERS.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import nn
from torch.nn import functional

from model.features import FEATURES, POSE_FEATURES, TURNING
from model.hand_view import NEAR_PHASES
from model.inputs import ENVIRONMENT, OBSTACLE
from model.local_release import LocalInput
from model.local_settings import LocalSettings
from model.pointnet2 import PointwiseLayers
from model.ranker import Prediction, initialise
from model.settings import Variant
from tables.identity import rng_for

SCALES_M = (0.1, 0.02)  # of a hand, and of a clearance
NARROWEST = 1e-4
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
        features = FEATURES if self.has_points else POSE_FEATURES
        self.read = [k for k, feature in enumerate(features) if feature.name not in TURNING]
        self.encoding = FeatureEncoding(len(self.read), settings.n_bins)
        n_features = self.encoding.n_values
        if self.has_points:
            self.near = PointNet(3 + 2 * len(NEAR_PHASES) + 3 + 2, settings.point_widths)
            n_features += settings.point_widths[-1]
        self.first = PointwiseLayers((n_features, settings.widths[0]))
        self.members = Members(settings.widths, settings.head_width, settings.n_members)
        self.attention = GroupAttention(settings.widths[0], settings.n_attention_heads) if settings.n_attention_heads else None
        if seed is not None:
            initialise(self, seed)
            self.members.initialise_scales(seed)

    @property
    def n_members(self) -> int:
        return self.settings.n_members

    def fit(self, release: Any) -> None:
        """What is taken from the training candidates, a LocalRelease, before the first step; it is stored with the weights."""
        self.encoding.fit(release.features[:, self.read])

    def forward(self, x: LocalInput) -> Prediction:
        """Logits of every candidate of whole fixed-target groups: the mean of the members'."""
        return Prediction(*(logits.mean(0).float() for logits in self._logits(x)))

    def of_members(self, x: LocalInput) -> Prediction:
        """Logits of the first member, of the second and so on, end to end: each is trained by its own errors."""
        return Prediction(*(logits.flatten().float() for logits in self._logits(x)))

    def _logits(self, x: LocalInput) -> tuple[Float[torch.Tensor, "m c"], Float[torch.Tensor, "m c"]]:
        seen = [self.encoding(x.features[:, self.read])]
        if self.has_points:
            seen.append(self.near(_near_values(x)).amax(-2))
        fused = functional.dropout(self.first(torch.cat(seen, -1)), self.settings.dropout, self.training)
        if self.attention is not None:
            fused = self.attention(fused, x.group)
        plan, execution = self.members(fused, self.settings.dropout)
        return plan, execution


class FeatureEncoding(nn.Module):
    """Piecewise-linear encoding (Gorishniy et al. 2022): how much of each bin of a feature lies below its value.

    Bins hold equally many training candidates. A network that is given metres alone does not tell a clearance of 5 mm from one of 10.
    """

    edges: torch.Tensor

    def __init__(self, n_features: int, n_bins: int) -> None:
        super().__init__()
        self.n_values = n_features * n_bins
        self.register_buffer("edges", torch.linspace(-1.0, 1.0, n_bins + 1).repeat(n_features, 1))

    def fit(self, features: Float[torch.Tensor, "c f"]) -> None:
        """Put the edges where the training candidates are."""
        shares = np.linspace(0.0, 1.0, self.edges.shape[1])
        self.edges.copy_(torch.from_numpy(np.quantile(features.numpy().astype(np.float64), shares, axis=0).T))

    def forward(self, features: Float[torch.Tensor, "c f"]) -> Float[torch.Tensor, "c v"]:
        low, high = self.edges[:, :-1], self.edges[:, 1:]
        # Where many candidates have one value a bin has no width and becomes a step.
        return ((features[..., None] - low) / (high - low).clamp_min(NARROWEST)).clamp(0.0, 1.0).flatten(-2)


class PointNet(nn.Module):
    """Linear and ReLU a point; no norm, which would cost more than both."""

    def __init__(self, n_values: int, widths: Sequence[int]) -> None:
        super().__init__()
        self.linear = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise((n_values, *widths)))

    def forward(self, x: Float[torch.Tensor, "*n a"]) -> Float[torch.Tensor, "*n b"]:
        for linear in self.linear:
            x = functional.relu(linear(x))
        return x


class Members(nn.Module):
    """A few networks that share their matrices and differ in scales and heads (BatchEnsemble, Wen 2020; TabM, Gorishniy 2024).

    Candidates of few scenes are learned by heart in many ways; the mean of members that were trained each by itself forgets most of them.
    """

    def __init__(self, widths: Sequence[int], head_width: int, n_members: int) -> None:
        super().__init__()
        self.scale_in = nn.Parameter(torch.ones(n_members, 1, widths[0]))
        self.body = PointwiseLayers(tuple(widths)) if len(widths) > 1 else None
        self.scale_out = nn.Parameter(torch.ones(n_members, 1, widths[-1]))
        self.hidden = nn.Linear(widths[-1], 2 * head_width)
        self.heads = nn.Linear(head_width, 2 * n_members)
        self.n_members, self.head_width = n_members, head_width

    def initialise_scales(self, seed: int) -> None:
        """A random sign each, for diversity; the only member of one keeps ones."""
        if self.n_members > 1:
            for name in ("scale_in", "scale_out"):
                scale = getattr(self, name)
                signs = rng_for(seed, "ranker-init", name).integers(0, 2, tuple(scale.shape)) * 2.0 - 1.0
                scale.data.copy_(torch.from_numpy(signs))

    def forward(self, x: Float[torch.Tensor, "c w"], dropout: float) -> Float[torch.Tensor, "2 m c"]:
        """Logits of planning and of execution."""
        each = x * self.scale_in
        if self.body is not None:
            each = functional.dropout(self.body(each), dropout, self.training)
        hidden = functional.relu(self.hidden(each * self.scale_out)).view(self.n_members, len(x), 2, self.head_width)
        weight = self.heads.weight.view(2, self.n_members, self.head_width)
        bias = self.heads.bias.view(2, self.n_members)
        return torch.einsum("mchw,hmw->hmc", hidden, weight) + bias[..., None]


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
        q, k, v = self.query_key_value(padded).view(*padded.shape[:2], 3, self.n_heads, -1).permute(2, 0, 3, 1, 4)
        seen = functional.scaled_dot_product_attention(q, k, v, attn_mask=is_there[:, None, None])
        added: torch.Tensor = self.out(seen.transpose(1, 2).flatten(-2))[group, place]
        return x + added


def _up_in_hand(features: Float[torch.Tensor, "c f"]) -> Float[torch.Tensor, "c 3"]:
    """The upward direction in the TCP frame at the place: the third row of its rotation, which is among the features."""
    row = [features[:, [_NUMBER[f"composed_{of}{axis}"] for axis in "xyz"]] for of in "yz"]
    across_z = row[0][:, 0] * row[1][:, 1] - row[0][:, 1] * row[1][:, 0]
    return torch.stack([across_z, row[0][:, 2], row[1][:, 2]], -1)


def _near_values(x: LocalInput) -> Float[torch.Tensor, "c m v"]:
    """Where a near point is, how far from the hand on two scales, which way is up, and what it is; zero where there is none."""
    n = x.near_m.shape[1]
    gaps_m = x.near_m[..., 3:]
    kinds = torch.stack([x.near_types == OBSTACLE, x.near_types == ENVIRONMENT], -1).to(gaps_m.dtype)
    values = [
        x.near_m[..., :3] / SCALES_M[0],
        torch.tanh(gaps_m / SCALES_M[0]),
        torch.tanh(gaps_m / SCALES_M[1]),
        _up_in_hand(x.features)[:, None].expand(-1, n, -1),
        kinds,
    ]
    return torch.cat(values, -1) * (x.near_types >= 0)[..., None]
