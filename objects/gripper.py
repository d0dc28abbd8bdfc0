"""The Panda gripper as a grasp sees it: jaw limits and boxes around hand and fingers; see pipelines/engines/robot for the arm.

TCP frame: origin between the finger pads, 0.1034 m from the hand frame, z along the approach, y along the jaw. Finger boxes are the
collision primitives of franka_description (Apache-2.0), the pad exactly, the three boxes behind it joined to one.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from objects.errors import GripperError
from tables.poses import matrix_of

TCP_FROM_HAND_M = 0.1034
FINGER_FROM_HAND_M = 0.0584
MAX_JAW_M = 0.08
# Room of each pad when the jaw opens for a grasp: more than the pose errors of a lift, less than what the handle of a mug leaves.
OPEN_CLEARANCE_M = 0.012

# (centre, size) in a frame whose origin is the finger joint at zero opening; +y is the opening direction of the finger.
FINGER_BOXES = (
    ((0.0, 0.00758, 0.04525), (0.0175, 0.01512, 0.0185)),
    ((0.0, 0.01420, 0.01800), (0.0220, 0.02360, 0.0360)),
)
# Bounds of the collision mesh of the hand in the hand frame.
HAND_BOX = ((0.0, 0.0, 0.0200), (0.0632, 0.2055, 0.0920))


def gripper_boxes(jaw_m: float) -> tuple[Float[np.ndarray, "n 4 4"], Float[np.ndarray, "n 3"]]:
    """Boxes of hand (first) and both fingers at an opening, in the TCP frame.

    Args:
        jaw_m: distance between the pads, in [0, 0.08] m.

    Returns:
        T_tcp_box of each of the 5 boxes, and their edge lengths in metres.

    Raises:
        GripperError: the opening is outside the range of the jaw.
    """
    if not 0.0 <= jaw_m <= MAX_JAW_M + 1e-9:
        raise GripperError(f"jaw opening {jaw_m:.4f} m, must be in [0, {MAX_JAW_M}]")
    poses = [(*HAND_BOX[0][:2], HAND_BOX[0][2] - TCP_FROM_HAND_M, 0.0, 0.0, 0.0, 1.0)]
    sizes = [HAND_BOX[1]]
    for side in (1.0, -1.0):
        for (x, y, z), size in FINGER_BOXES:
            poses.append((x, side * (y + jaw_m / 2), z + FINGER_FROM_HAND_M - TCP_FROM_HAND_M, 0.0, 0.0, 0.0, 1.0))
            sizes.append(size)
    return matrix_of(np.array(poses)), np.array(sizes)


def open_jaw_m(jaw_width_m: float) -> float:
    """Opening at which the hand approaches, and to which it opens for release: the grasped width plus 12 mm a side, at most 80 mm.

    A hand that always opened fully would push a finger in the handle of a mug into the mug.
    """
    return min(MAX_JAW_M, jaw_width_m + 2 * OPEN_CLEARANCE_M)
