"""A release as our networks in the hand's frame read it: the view of every candidate, gathered once; at the full setting 1.0 kB each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int

from model.grouping import Grouping, group_starts
from model.hand_view import HandView, hand_view, pose_view
from model.inputs import ReleaseInputs
from model.local_settings import LocalSettings
from model.settings import Variant


@dataclass(frozen=True, slots=True)
class LocalInput:
    """What is seen of the candidates of some groups; without points on poses alone."""

    features: Float[torch.Tensor, "c f"]
    near_m: Float[torch.Tensor, "c m 7"]
    near_types: Int[torch.Tensor, "c m"]
    group: Int[torch.Tensor, "c"]


@dataclass(frozen=True, slots=True)
class LocalRelease(Grouping):
    """Views of all candidates as tensors on the CPU; points in half precision, which tells 0.06 mm apart where a hand is."""

    features: Float[torch.Tensor, "c f"]
    near_m: Float[torch.Tensor, "c m 7"]
    near_types: Int[torch.Tensor, "c m"]

    def network_input(self, groups: Int[np.ndarray, "g"], device: torch.device) -> LocalInput:
        rows = torch.from_numpy(self.candidates_of(groups))
        sizes = self.group_start[groups + 1] - self.group_start[groups]
        return LocalInput(
            features=self.features[rows].to(device),
            near_m=self.near_m[rows].to(device).float(),
            near_types=self.near_types[rows].to(device).long(),
            group=torch.from_numpy(np.repeat(np.arange(len(groups)), sizes)).to(device),
        )


def encode_local(inputs: ReleaseInputs, settings: LocalSettings, variant: Variant) -> LocalRelease:
    """Look at every candidate of a release, of which there must be at least one."""
    T_base_target = inputs.T_base_target[inputs.candidate_group]
    start = np.searchsorted(inputs.group_scene[inputs.candidate_group], np.arange(len(inputs.clouds) + 1))
    views: list[HandView] = []
    for cloud, first, end in zip(inputs.clouds, start[:-1], start[1:], strict=True):
        poses = inputs.T_base_grasp[first:end], T_base_target[first:end]
        views.append(pose_view(cloud.T_base_object, *poses) if variant is Variant.POSE_ONLY else hand_view(cloud, *poses, settings))
    return LocalRelease(
        group_scene=inputs.group_scene,
        group_start=group_starts(inputs.candidate_group, len(inputs.group_scene)),
        features=torch.from_numpy(np.concatenate([view.features for view in views])),
        near_m=torch.from_numpy(np.concatenate([view.near_m.astype(np.float16) for view in views])),
        near_types=torch.from_numpy(np.concatenate([view.near_types for view in views])),
    )
