"""A release as a torch Dataset, for whoever trains a network of their own; our own networks read it through batches.py."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch.utils.data import Dataset

from model.errors import InputError
from model.geometry import place_pose
from model.inputs import InputReader, read_inputs, scenes_of_split
from model.labels import read_labels
from model.release_tables import is_left_out, published_sha256
from model.settings import scheme_named
from tables.vocabulary import Split, SplitScheme

Item = dict[str, torch.Tensor]


class PlacementDataset(Dataset[Item]):
    """Candidates of a release, an item each, in (scene_id, target_id, grasp_id) order.

    An item maps names to tensors; all frames are those of the tables, metres, z up:

    - `points_m` [n, 3] and `point_types` [n]: the cloud of the initial scene, base frame; types count as in `inputs.TYPE_NAMES`
      (0 environment, 1 object, 3 obstacle). A light release has none, and `has_points=False` asks for none;
    - `T_base_object`, `T_base_grasp`, `T_base_target`, `T_grasp_object` [4, 4]: the initial object, the TCP at the grasp, the object at the
      target, the initial object in the TCP frame; and `T_base_place`, the TCP when the object is at the target, which follows from them;
    - `y_plan`, `y_pipe`, `success`: the labels, never an input. `y_pipe` means nothing where `y_plan` is false;
    - `scene`, `group`, `candidate`: numbers of the joint group, the fixed-target group and the item; names stand in `candidate_ids`.

    Nothing that only planning or physics knows is read but the labels. Scenes share one tensor of points: don't write into it.

    Args:
        release_dir: folder of a release, whole or light.
        split: `train`, `validation` or `test`; all scenes without it.
        scheme: by what scenes are dealt to the splits.
        has_points: whether items have points; without them a light release is enough.

    Raises:
        InputError: a table is missing, changed after it was published or holds an impossible value, no such split, or no candidates.
    """

    def __init__(
        self, release_dir: Path | str, split: str | None = None, scheme: str = SplitScheme.SCENE.value, *, has_points: bool = True
    ) -> None:
        release_dir = Path(release_dir)
        reader = InputReader(release_dir, scheme_named(scheme))
        if split is not None and split not in set(Split):
            raise InputError(f"split {split!r}, must be one of {[s.value for s in Split]}")
        if has_points and is_left_out(release_dir, "scene_points"):
            again = f"`make points RELEASE={release_dir}` makes it again, has_points=False does without"
            raise InputError(f"{release_dir / 'scene_points.parquet'}: missing, as from a light release; {again}")
        self.has_points = has_points
        inputs = read_inputs(reader, None if split is None else scenes_of_split(reader, split), self.has_points)
        if not inputs.candidate_ids:
            raise InputError(f"{release_dir}: the {split or 'whole'} split has 0 candidates, must have at least 1")
        published_sha256(release_dir, reader.selected)
        labels = read_labels(release_dir, inputs.candidate_ids)

        self.candidate_ids = inputs.candidate_ids
        self.scene_ids = tuple(cloud.scene_id for cloud in inputs.clouds)
        self.group = torch.from_numpy(inputs.candidate_group)
        self.scene = torch.from_numpy(inputs.group_scene[inputs.candidate_group])
        self._points_m = [torch.from_numpy(cloud.points_m) for cloud in inputs.clouds]
        self._point_types = [torch.from_numpy(cloud.point_types) for cloud in inputs.clouds]
        T_base_object = np.stack([cloud.T_base_object for cloud in inputs.clouds])[self.scene.numpy()]
        T_base_target = inputs.T_base_target[inputs.candidate_group]
        self._poses = {
            "T_base_object": _pose(T_base_object),
            "T_base_grasp": _pose(inputs.T_base_grasp),
            "T_base_target": _pose(T_base_target),
            "T_grasp_object": _pose(inputs.T_grasp_object),
            "T_base_place": _pose(place_pose(T_base_target, T_base_object, inputs.T_base_grasp)),
        }
        self._labels = {name: torch.from_numpy(getattr(labels, name)) for name in ("y_plan", "y_pipe", "success")}

    def __len__(self) -> int:
        return len(self.candidate_ids)

    def __getitem__(self, candidate: int) -> Item:
        if not 0 <= candidate < len(self):
            raise IndexError(f"candidate {candidate}, must be in [0, {len(self)})")
        scene = int(self.scene[candidate])
        item = {name: values[candidate] for name, values in (self._poses | self._labels).items()}
        item |= {"scene": self.scene[candidate], "group": self.group[candidate], "candidate": torch.tensor(candidate)}
        if self.has_points:
            item |= {"points_m": self._points_m[scene], "point_types": self._point_types[scene]}
        return item

    def groups(self, task: str) -> list[list[int]]:
        """Candidates of each group of `joint` (a scene) or `fixed` (a scene and a target), as DataLoader takes for `batch_sampler`."""
        if task not in ("joint", "fixed"):
            raise InputError(f"task {task!r}, must be joint or fixed")
        number = (self.scene if task == "joint" else self.group).numpy()
        return [rows.tolist() for rows in np.split(np.arange(len(self)), np.flatnonzero(np.diff(number)) + 1)]


def _pose(T: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(T.astype(np.float32))
