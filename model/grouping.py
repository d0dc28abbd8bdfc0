"""Candidates of a release in their groups, whatever a network is shown of them; what that is, stands in batches.py and local_release.py."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Int


@dataclass(frozen=True, slots=True)
class Grouping(ABC):
    """Fixed-target groups of a release, each with its scene and its candidates, in the order of ReleaseInputs."""

    group_scene: Int[np.ndarray, "g"]
    group_start: Int[np.ndarray, "g+1"]  # candidates of group k are group_start[k] ... group_start[k + 1] - 1

    @property
    def n_scenes(self) -> int:
        return int(self.group_scene[-1]) + 1 if len(self.group_scene) else 0

    def groups_of_scenes(self, scenes: Sequence[int]) -> Int[np.ndarray, "g"]:
        return np.concatenate([np.flatnonzero(self.group_scene == scene) for scene in scenes])

    def candidates_of(self, groups: Sequence[int] | Int[np.ndarray, "g"]) -> Int[np.ndarray, "c"]:
        return np.concatenate([np.arange(self.group_start[g], self.group_start[g + 1]) for g in groups])

    @abstractmethod
    def network_input(self, groups: Int[np.ndarray, "g"], device: torch.device) -> Any:
        """What the network of the release's variant reads of all candidates of some groups, on the device."""


def group_starts(candidate_group: Int[np.ndarray, "c"], n_groups: int) -> Int[np.ndarray, "g+1"]:
    """First candidate of each group, and the number of candidates."""
    return np.searchsorted(candidate_group, np.arange(n_groups + 1))
