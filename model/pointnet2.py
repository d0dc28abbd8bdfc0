"""PointNet++ (Qi et al. 2017) over clouds whose neighbourhoods are already known; they are found in clouds.py."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import torch
from jaxtyping import Float, Int
from torch import nn
from torch.nn import functional

from model.inputs import TYPE_NAMES
from model.settings import RankerSettings

N_SCENE_FEATURES = 512


class PointNet2(nn.Module):
    """Two set abstractions and a global one: a typed cloud becomes 512 numbers."""

    def __init__(self, settings: RankerSettings) -> None:
        super().__init__()
        self.workspace_centre_m = settings.workspace_centre_m
        self.workspace_scale_m = settings.workspace_scale_m
        self.types = nn.Embedding(len(TYPE_NAMES), settings.n_type_features)
        self.local = SetAbstraction(settings.n_type_features, settings.widths_1, settings.radius_1_m)
        self.regional = SetAbstraction(settings.widths_1[-1], settings.widths_2, settings.radius_2_m)
        self.overall = PointwiseLayers((3 + settings.widths_2[-1], settings.width_global, N_SCENE_FEATURES))

    def forward(
        self,
        points_m: Float[torch.Tensor, "b n 3"],
        types: Int[torch.Tensor, "b n"],
        neighbours_1: Int[torch.Tensor, "b s1 k1"],
        neighbours_2: Int[torch.Tensor, "b s2 k2"],
    ) -> Float[torch.Tensor, "b 512"]:
        """Scene features; the centres of each level are its leading points (see GroupedClouds)."""
        n_centres_1, n_centres_2 = neighbours_1.shape[1], neighbours_2.shape[1]
        points = points_m - points_m.new_tensor(self.workspace_centre_m)
        local = self.local(points, self.types(types), neighbours_1)
        regional = self.regional(points[:, :n_centres_1], local, neighbours_2)
        centres = points[:, :n_centres_2] / self.workspace_scale_m
        overall: torch.Tensor = self.overall(torch.cat([centres, regional], -1))
        return overall.amax(-2)


class SetAbstraction(nn.Module):
    """Each centre gathers features and offsets of its neighbours, in units of the radius, transforms each, and keeps the maximum."""

    def __init__(self, n_features: int, widths: Sequence[int], radius_m: float) -> None:
        super().__init__()
        self.radius_m = radius_m
        self.first = nn.Linear(3 + n_features, widths[0])
        self.norm = nn.LayerNorm(widths[0])
        self.rest = PointwiseLayers(tuple(widths))

    def forward(
        self, points: Float[torch.Tensor, "b n 3"], features: Float[torch.Tensor, "b n f"], neighbours: Int[torch.Tensor, "b s k"]
    ) -> Float[torch.Tensor, "b s w"]:
        """Features of the first s points as centres; `points` in metres about the workspace centre."""
        n_clouds, n_points, _ = points.shape
        n_centres = neighbours.shape[1]
        scaled = points / self.radius_m
        # The first layer is linear in (point - centre, feature), so it runs once a point and once a centre, not once a neighbour:
        # W [p - c; f] + b = (W [p; f] + b) - W_offset c. Neighbourhoods overlap 4 to 8 times, and this was half of the cost.
        of_point = self.first(torch.cat([scaled, features], -1))
        of_centre = functional.linear(scaled[:, :n_centres], self.first.weight[:, :3])
        first_row = torch.arange(n_clouds, device=points.device)[:, None, None] * n_points
        gathered = of_point.reshape(n_clouds * n_points, -1).index_select(0, (neighbours + first_row).reshape(-1))
        offset = gathered.reshape(*neighbours.shape, -1) - of_centre[:, :, None, :]
        transformed: torch.Tensor = self.rest(functional.relu(self.norm(offset)))
        return transformed.amax(-2)


class PointwiseLayers(nn.Module):
    """Linear, LayerNorm, ReLU per row. LayerNorm and not BatchNorm: the feature of a cloud must not depend on what else is in the batch."""

    def __init__(self, widths: Sequence[int]) -> None:
        super().__init__()
        self.linear = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(widths))
        self.norm = nn.ModuleList(nn.LayerNorm(b) for b in widths[1:])

    def forward(self, x: Float[torch.Tensor, "*n a"]) -> Float[torch.Tensor, "*n b"]:
        for linear, norm in zip(self.linear, self.norm, strict=True):
            x = functional.relu(norm(linear(x)))
        return x
