"""The ranker's dimensions of hand and arm are those of the gripper that labels are made with, and of the URDF."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from model import hand
from objects import gripper
from pipelines.engines.robot.arm import Q_LOWER_RAD, Q_UPPER_RAD, fk
from pipelines.engines.robot.geometry import panda


@pytest.mark.parametrize("jaw_m", [0.0, 0.031, 0.08])
def test_the_boxes_are_those_of_the_gripper(jaw_m: float) -> None:
    T_tcp_box, size_m = gripper.gripper_boxes(jaw_m)
    centres_m, half_m = hand.hand_boxes(np.array([jaw_m]))
    # Sums of a few decimal numbers, in another order.
    np.testing.assert_allclose(centres_m[0], T_tcp_box[:, :3, 3], rtol=0, atol=1e-16)
    np.testing.assert_allclose(half_m, size_m / 2, rtol=0, atol=0)
    np.testing.assert_array_equal(T_tcp_box[:, :3, :3], np.broadcast_to(np.eye(3), (hand.N_BOXES, 3, 3)))


@pytest.mark.parametrize("width_m", [0.0, 0.02, 0.056, 0.08])
def test_the_jaw_opens_as_the_gripper_does(width_m: float) -> None:
    assert hand.MAX_JAW_M == gripper.MAX_JAW_M
    assert hand.open_jaw_m(np.array([width_m]))[0] == gripper.open_jaw_m(width_m)


def test_shoulder_and_wrist_are_those_of_the_urdf() -> None:
    """At any configuration joint 2 turns about the shoulder, joint 7 about the approach, and joint 6 passes 88 mm beside it."""
    model = panda().model
    data = model.createData()
    for q in np.random.default_rng(2).uniform(Q_LOWER_RAD, Q_UPPER_RAD, (50, 7)):
        T_base_tcp = fk(q)
        pin.forwardKinematics(model, data, np.concatenate([q, [0.0, 0.0]]))
        shoulder_m, joint_6_m, joint_7_m = (data.oMi[k].translation for k in (2, 6, 7))
        approach = T_base_tcp[:3, 2]
        wrist_m = T_base_tcp[:3, 3] - hand.WRIST_FROM_TCP_M * approach
        np.testing.assert_allclose(shoulder_m, hand.SHOULDER_M, atol=1e-9)
        np.testing.assert_allclose(joint_7_m, wrist_m, atol=1e-9)  # joint 7's frame in the URDF is where its axis meets the normal
        offset_m = joint_6_m - wrist_m
        assert np.linalg.norm(offset_m) == pytest.approx(hand.WRIST_OFFSET_M, abs=1e-9)
        assert float(offset_m @ approach) == pytest.approx(0.0, abs=1e-9)
