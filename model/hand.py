"""Published dimensions of the Panda's hand and arm that geometry needs; the boxes repeat objects/gripper.py, which no ranker may import.

TCP frame: origin between the finger pads, z along the approach, y along the jaw. Base frame: z up, the shoulder above its origin.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

MAX_JAW_M = 0.08
OPEN_CLEARANCE_M = 0.012  # room of each pad when the jaw opens for a grasp or a release

# Centre and edge lengths in the TCP frame of the shut hand: the hand's body, then pad and finger body of the finger at +y.
_BODY = ((0.0, 0.0, -0.0834), (0.0632, 0.2055, 0.0920))
_FINGER = (((0.0, 0.00758, 0.00025), (0.0175, 0.01512, 0.0185)), ((0.0, 0.01420, -0.02700), (0.0220, 0.02360, 0.0360)))
N_BOXES = 1 + 2 * len(_FINGER)  # the body is the first

# Denavit-Hartenberg lengths of the Panda, Franka Control Interface documentation ("Robot and interface specifications").
SHOULDER_M = (0.0, 0.0, 0.333)
WRIST_FROM_TCP_M = 0.1034 + 0.107  # back along the approach from the TCP to where the axis of joint 7 meets its common normal with joint 6
WRIST_OFFSET_M = 0.088  # between the axes of joints 6 and 7, in a direction that joint 7 is free to choose

PAD_HALF_M = (_FINGER[0][1][0] / 2, MAX_JAW_M / 2, _FINGER[0][1][2] / 2)  # half of the space between the pads of a fully open jaw


def hand_boxes(jaw_m: Float[np.ndarray, "*c"]) -> tuple[Float[np.ndarray, "*c 5 3"], Float[np.ndarray, "5 3"]]:
    """(centres, half edge lengths) of the boxes of hand and fingers in the TCP frame, whose axes they share.

    Args:
        jaw_m: distance between the pads.
    """
    jaw_m = np.asarray(jaw_m, dtype=np.float64)
    centres = np.zeros((*jaw_m.shape, N_BOXES, 3))
    half = np.zeros((N_BOXES, 3))
    centres[..., 0, :], half[0] = _BODY[0], np.array(_BODY[1]) / 2
    for side, sign in enumerate((1.0, -1.0)):
        for k, ((x, y, z), size) in enumerate(_FINGER):
            box = 1 + side * len(_FINGER) + k
            centres[..., box, 0], centres[..., box, 2] = x, z
            centres[..., box, 1] = sign * (y + jaw_m / 2)
            half[box] = np.array(size) / 2
    return centres, half


def folded_hand_boxes() -> tuple[tuple[tuple[float | None, float], tuple[float, ...]], ...]:
    """((y, z) of the centre for a shut jaw, half edge lengths) of body, pad and finger on the side of +y.

    The hand is its own mirror image in x and y, so these three tell the distance of |x|, |y|, z from all five boxes; y of the body is None:
    the middle, whatever the jaw does.
    """
    parts = ((_BODY, True), *((finger, False) for finger in _FINGER))
    return tuple(((None if is_body else y, z), tuple(edge / 2 for edge in size)) for ((_, y, z), size), is_body in parts)


def open_jaw_m(width_m: Float[np.ndarray, "*c"]) -> Float[np.ndarray, "*c"]:
    """Opening of the jaw around something of a width: 12 mm more on both sides, at most fully open."""
    opening: Float[np.ndarray, "*c"] = np.minimum(MAX_JAW_M, np.asarray(width_m) + 2 * OPEN_CLEARANCE_M)
    return opening
