"""A finger pad as cells that yield: where they are, how stiff each is, and the lever that follows; the model is hand_model.py.

Pads decide by geometry how much torque about the jaw axis they hold. A pad that presses evenly on a flat face with force F holds
mu F L before it turns, where L is the mean distance of the face's points from its centre: 6.89 mm for 17.5 x 18.5 mm. On a can the
pad touches along a line: L is a quarter of the line's length, 4.4 mm across the pad and 4.6 mm along it. No cell has torsional
friction of its own: a cell is a point of the face.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from objects.gripper import FINGER_BOXES

_PAD = FINGER_BOXES[0]
PAD_SIZE_M = (_PAD[1][0], _PAD[1][2])  # across the finger (x of the hand) and along it (z)
PAD_CENTRE_M = (_PAD[0][0], _PAD[0][2])  # in the finger's frame
PAD_FACE_M = _PAD[0][1] - _PAD[1][1] / 2  # y of the face in the finger's frame, nearly 0


@dataclass(frozen=True, slots=True)
class PadCells:
    """Cells of one pad: points of its face, relative to its centre, and the radius of their caps."""

    points_m: Float[np.ndarray, "c 2"]
    radius_m: float


def even_pressure_lever_m(width_m: float, height_m: float) -> float:
    """Mean distance of a rectangle's points from its centre: torque over (friction x force) of an evenly pressed face that turns."""
    a, b = width_m, height_m
    d = math.hypot(a, b)
    return (d + a * a / (2 * b) * math.log((b + d) / a) + b * b / (2 * a) * math.log((a + d) / b)) / 6


def line_lever_m(length_m: float) -> float:
    """The same of an evenly pressed line: a quarter of its length."""
    return length_m / 4


def pad_cells(cells_per_side: int, lever_scale: float = 1.0) -> PadCells:
    """Cells at the centres of equal rectangles, spread about the pad's centre until n^2 equal forces have the lever of even pressure.

    The spread is 7 % for 3 x 3 cells and 2 % for 5 x 5. The second moments of the face, which decide how it resists tilting, then are
    right within 2 %, lines of contact through the middle within 5 %.
    """
    n = cells_per_side
    width_m, height_m = PAD_SIZE_M
    at = (np.arange(n) + 0.5) / n - 0.5
    points_m = np.stack(np.meshgrid(at * width_m, at * height_m, indexing="ij"), axis=-1).reshape(-1, 2)
    spread = lever_scale * even_pressure_lever_m(width_m, height_m) / float(np.hypot(*points_m.T).mean())
    points_m = points_m * spread
    # Caps may not stand out of the pad's sides: a lower finger would meet the table too early. A wider pad is one with smaller caps.
    room_m = min(width_m / 2 - np.abs(points_m[:, 0]).max(), height_m / 2 - np.abs(points_m[:, 1]).max())
    return PadCells(points_m, max(0.0012, float(room_m)))
