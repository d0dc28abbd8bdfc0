"""What an arm is doing, who watches it, and how far apart two poses are: the words that engines and stages share."""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum

import numpy as np
from jaxtyping import Float

from tables.poses import rotation_angle_rad


class Phase(StrEnum):
    """What the arm is doing."""

    APPROACH = "approach"
    CLOSE = "close"
    LIFT = "lift"
    HOLD = "hold"
    TRANSPORT = "transport"
    DESCEND = "descend"
    OPEN = "open"
    RETREAT = "retreat"
    SETTLE = "settle"


# Called every `check_every_steps` steps; True ends the motion.
Watch = Callable[[Phase], bool]


def no_watch(phase: Phase) -> bool:
    """Watch nothing."""
    return False


def pose_difference(T_a: Float[np.ndarray, "4 4"], T_b: Float[np.ndarray, "4 4"]) -> tuple[float, float]:
    """Distance of the origins in metres and angle between the axes in radians."""
    return float(np.linalg.norm(T_a[:3, 3] - T_b[:3, 3])), float(rotation_angle_rad(T_a[:3, :3], T_b[:3, :3]))
