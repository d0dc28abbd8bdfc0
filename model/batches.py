"""A release as tensors, and the batches of an epoch; their order is a pure function of seed and epoch."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Int

from model.clouds import GroupedClouds, grouped_clouds
from model.grouping import Grouping, group_starts
from model.inputs import ReleaseInputs
from model.labels import Labels
from model.losses import Supervision
from model.ranker import ModelInput, pose9
from model.settings import RankerSettings, TrainingSettings, Variant
from tables.identity import rng_for
from tables.poses import inverse


@dataclass(frozen=True, slots=True)
class EncodedRelease(Grouping):
    """The inputs of all candidates as tensors on the CPU: at the full setting 45 kB a fixed-target group."""

    clouds: GroupedClouds
    target_pose: torch.Tensor
    grasp_pose: torch.Tensor
    object_relative_pose: torch.Tensor

    def network_input(self, groups: Int[np.ndarray, "g"], device: torch.device) -> ModelInput:
        return model_input(self, groups, device)


def encode_release(inputs: ReleaseInputs, settings: RankerSettings, variant: Variant) -> EncodedRelease:
    """Sample and group every cloud, and write poses as 9 numbers."""
    T_base_hand = inputs.T_base_grasp
    if settings.is_grasp_at_place:
        T_base_hand = inputs.T_base_target[inputs.candidate_group] @ inverse(inputs.T_grasp_object)
    return EncodedRelease(
        clouds=grouped_clouds(inputs, settings, has_target_copy=variant is not Variant.NO_TARGET_HYPOTHESIS),
        target_pose=torch.from_numpy(pose9(inputs.T_base_target)),
        grasp_pose=torch.from_numpy(pose9(T_base_hand)),
        object_relative_pose=torch.from_numpy(pose9(inputs.T_grasp_object)),
        group_scene=inputs.group_scene,
        group_start=group_starts(inputs.candidate_group, len(inputs.group_scene)),
    )


def scene_batches(n_scenes: int, settings: TrainingSettings, seed: int, epoch: int) -> Iterator[Int[np.ndarray, "s"]]:
    """Scene numbers of each batch: every scene once an epoch."""
    order = rng_for(seed, "ranker-epoch", epoch).permutation(n_scenes)
    for first in range(0, n_scenes, settings.scenes_per_batch):
        yield order[first : first + settings.scenes_per_batch]


def model_input(release: EncodedRelease, groups: Int[np.ndarray, "g"], device: torch.device) -> ModelInput:
    """The five inputs of all candidates of some groups, on the device."""
    candidates = torch.from_numpy(release.candidates_of(groups))
    sizes = release.group_start[groups + 1] - release.group_start[groups]
    picked = torch.from_numpy(groups)
    # Numbers are stored small and widened on the device.
    return ModelInput(
        points_m=release.clouds.points_m[picked].to(device),
        point_types=release.clouds.types[picked].to(device).long(),
        neighbours_1=release.clouds.neighbours_1[picked].to(device).long(),
        neighbours_2=release.clouds.neighbours_2[picked].to(device).long(),
        target_pose=release.target_pose[picked].to(device),
        grasp_pose=release.grasp_pose[candidates].to(device),
        object_relative_pose=release.object_relative_pose[candidates].to(device),
        group=torch.from_numpy(np.repeat(np.arange(len(groups)), sizes)).to(device),
    )


def supervision(release: Grouping, labels: Labels, groups: Int[np.ndarray, "g"], device: torch.device) -> Supervision:
    """Labels and ranking groups of the candidates of some groups, numbered as `model_input` numbers them."""
    candidates = release.candidates_of(groups)
    sizes = release.group_start[groups + 1] - release.group_start[groups]
    ends = np.cumsum(sizes)
    members = [np.arange(end - size, end) for size, end in zip(sizes, ends, strict=True)]
    scenes = release.group_scene[groups]
    joint = []
    for scene in np.unique(scenes):
        mine = np.flatnonzero(scenes == scene)
        if len(mine) == np.count_nonzero(release.group_scene == scene):
            joint.append(np.concatenate([members[k] for k in mine]))
    return Supervision(
        y_plan=torch.from_numpy(labels.y_plan[candidates]).to(device),
        y_pipe=torch.from_numpy(labels.y_pipe[candidates]).to(device),
        ranking_groups=tuple(torch.from_numpy(_padded(rows)).to(device) for rows in (members, joint) if rows),
    )


def _padded(rows: Sequence[Int[np.ndarray, "_k"]]) -> Int[np.ndarray, "g k"]:
    padded = np.full((len(rows), max(len(row) for row in rows)), -1, dtype=np.int64)
    for k, row in enumerate(rows):
        padded[k, : len(row)] = row
    return padded
