"""How many pool grasps a pose allows at first sight: hand above the table, arm long enough; see grasps/admission.py for the rest."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from objects.gripper import gripper_boxes, open_jaw_m
from objects.object_model import ObjectModel
from pipelines.engines.robot.arm import ik


class OpenHands:
    """The open hand at every pool grasp, in the object frame."""

    def __init__(self, object_model: ObjectModel, n_q7: int) -> None:
        boxes = [gripper_boxes(open_jaw_m(grasp.jaw_width_m)) for grasp in object_model.grasps]
        self.T_object_grasp = np.array([grasp.T_object_grasp for grasp in object_model.grasps])
        self.T_object_box = self.T_object_grasp[:, None] @ np.array([T_tcp_box for T_tcp_box, _ in boxes])
        self.half_m = 0.5 * np.array([size_m for _, size_m in boxes])
        self.n_q7 = n_q7

    def allows(self, T_base_object: Float[np.ndarray, "4 4"], n_grasps: int) -> bool:
        """Whether at least `n_grasps` grasps have their open hand above the table and their TCP within the arm's reach."""
        clear = self.T_object_grasp[self.is_above_table(T_base_object)]
        n_found = 0
        for n_tried, T_object_grasp in enumerate(clear):
            if n_found >= n_grasps or n_found + len(clear) - n_tried < n_grasps:
                break
            n_found += len(ik(T_base_object @ T_object_grasp, self.n_q7)) > 0
        return n_found >= n_grasps

    def is_above_table(self, T_base_object: Float[np.ndarray, "4 4"]) -> Bool[np.ndarray, "g"]:
        """Which grasps have their open hand above the table."""
        z_axis, z = T_base_object[2, :3], T_base_object[2, 3]
        reach_m = (np.abs(np.einsum("i,gbij->gbj", z_axis, self.T_object_box[:, :, :3, :3])) * self.half_m).sum(axis=-1)
        lowest_m = (self.T_object_box[:, :, :3, 3] @ z_axis + z - reach_m).min(axis=1)
        return np.asarray(lowest_m > 0.0)

    def n_allowed(self, T_base_object: Float[np.ndarray, "4 4"]) -> int:
        """How many grasps have their open hand above the table and their TCP within the arm's reach."""
        clear = self.T_object_grasp[self.is_above_table(T_base_object)]
        return sum(len(ik(T_base_object @ T_object_grasp, self.n_q7)) > 0 for T_object_grasp in clear)
