"""The planner's hand is the hand of objects.gripper, which the grasp pool and physics use."""

from __future__ import annotations

import numpy as np
import pytest

from objects.gripper import HAND_BOX, TCP_FROM_HAND_M, gripper_boxes
from pipelines.engines.planning.bodies import hand_body
from pipelines.engines.robot.geometry import box_corners, moved


@pytest.mark.parametrize("jaw_m", [0.0, 0.031, 0.08])
def test_finger_boxes_are_those_of_the_gripper(jaw_m: float) -> None:
    T_tcp_box, size_m = gripper_boxes(jaw_m)
    _, *fingers = hand_body(jaw_m).part_vertices_m
    for T, size, vertices in zip(T_tcp_box[1:], size_m[1:], fingers, strict=True):
        expected = moved(T, box_corners(size))
        np.testing.assert_allclose(vertices[np.lexsort(vertices.T.round(9))], expected[np.lexsort(expected.T.round(9))], atol=1e-9)


def test_hand_hull_fills_the_grippers_hand_box() -> None:
    """The box bounds the mesh; the mesh is 1.8 mm off centre along the jaw."""
    palm = hand_body(0.08).part_vertices_m[0]
    size, centre = np.array(HAND_BOX[1]), np.array(HAND_BOX[0]) - [0.0, 0.0, TCP_FROM_HAND_M]
    np.testing.assert_allclose(np.ptp(palm, axis=0), size, atol=0.002)
    np.testing.assert_allclose((palm.min(axis=0) + palm.max(axis=0)) / 2, centre, atol=0.002)


def test_a_swept_hand_reaches_back_by_the_sweep() -> None:
    still, swept = hand_body(0.05).vertices_m, hand_body(0.05, 0.1).vertices_m
    np.testing.assert_allclose(swept.max(axis=0), still.max(axis=0))
    np.testing.assert_allclose(swept.min(axis=0), still.min(axis=0) - [0.0, 0.0, 0.1])
