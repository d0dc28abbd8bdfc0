"""A finger pad as cells that yield: where they are, how much torque each holds by itself, and why; they become bodies in hand_bodies.py.

Pads decide by geometry how much torque about the jaw axis they hold. A pad that presses evenly on a flat face with force F holds
mu F L before it turns, where L is the mean distance of the face's points from its centre: 6.89 mm for 17.5 x 18.5 mm. On a can the
pad touches along a strip and holds less (`winkler_lever_m`: 4.7 to 4.9 mm for 33 mm of radius), at its end less still.

A cell stands for its share of the face, pressed evenly, so it resists turning on the spot, too: with a lever l of its own it gives
mu f sqrt(r^2 + l^2) where the pad turns about a point r away (the elliptic friction cone's answer to sliding and spinning at once).
l follows from the face: the mean of sqrt(r^2 + l^2) over the cells must be L. That is 2.0 mm for 3 x 3 cells, 0.87 of what the
cell's rectangle has alone, and 1.2 mm for 5 x 5. Cells without it would hold a can's end, where one cell touches, like an axle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import brentq

from objects.gripper import FINGER_BOXES

_PAD = FINGER_BOXES[0]
PAD_SIZE_M = (_PAD[1][0], _PAD[1][2])  # across the finger (x of the hand) and along it (z)
PAD_CENTRE_M = (_PAD[0][0], _PAD[0][2])  # in the finger's frame
PAD_FACE_M = _PAD[0][1] - _PAD[1][1] / 2  # y of the face in the finger's frame, nearly 0


@dataclass(frozen=True, slots=True)
class PadCells:
    """Cells of one pad: points of its face relative to its centre, the radius of their caps, and the lever of each by itself."""

    points_m: Float[np.ndarray, "c 2"]
    radius_m: float
    lever_m: float


def pad_cells(cells_per_side: int, lever_scale: float = 1.0) -> PadCells:
    """Cells at the centres of n x n equal rectangles of the face; `lever_scale` spreads them and stretches their own levers alike.

    None for n = 0: the pad is the rigid block behind them.
    """
    if cells_per_side == 0:
        return PadCells(np.empty((0, 2)), 0.0, 0.0)
    at = (np.arange(cells_per_side) + 0.5) / cells_per_side - 0.5
    width_m, height_m = PAD_SIZE_M
    points_m = np.stack(np.meshgrid(at * width_m, at * height_m, indexing="ij"), axis=-1).reshape(-1, 2)
    r2, wanted_m = np.sum(points_m**2, axis=1), even_pressure_lever_m(width_m, height_m)
    lever_m = float(brentq(lambda l: np.sqrt(r2 + l * l).mean() - wanted_m, 0.0, wanted_m, xtol=1e-12))
    points_m = points_m * lever_scale
    # Caps may not stand out of the pad's sides: a lower finger would meet what lies below it too early.
    room_m = min(width_m / 2 - np.abs(points_m[:, 0]).max(), height_m / 2 - np.abs(points_m[:, 1]).max())
    return PadCells(points_m, float(room_m), lever_m * lever_scale)


def even_pressure_lever_m(width_m: float, height_m: float) -> float:
    """Mean distance of a rectangle's points from its centre: torque over (friction x force) of an evenly pressed face that turns."""
    a, b = width_m, height_m
    d = math.hypot(a, b)
    return (d + a * a / (2 * b) * math.log((b + d) / a) + b * b / (2 * a) * math.log((a + d) / b)) / 6


def winkler_lever_m(
    radius_m: float, is_along_finger: bool, force_n: float, stiffness_n_m: float, offset_m: float = 0.0, n: int = 200
) -> float:
    """The same where the pad presses on a cylinder: an elastic foundation of many points, each as deep as the cylinder reaches.

    Args:
        radius_m: of the cylinder.
        is_along_finger: its axis lies along the finger (z of the hand); otherwise across it (x).
        force_n, stiffness_n_m: of the whole pad.
        offset_m: of the line of contact from the pad's centre.
    """
    at = (np.arange(n) + 0.5) / n - 0.5
    x, z = np.meshgrid(at * PAD_SIZE_M[0], at * PAD_SIZE_M[1], indexing="ij")
    gap_m = ((x if is_along_finger else z) - offset_m) ** 2 / (2 * radius_m)
    k = stiffness_n_m / n**2
    depth_m = brentq(lambda depth: k * np.clip(depth - gap_m, 0.0, None).sum() - force_n, 0.0, 0.01)
    pressure = np.clip(depth_m - gap_m, 0.0, None)
    # A free body turns about the point that takes the least torque: the strip's middle.
    u, w = (x - offset_m, z) if is_along_finger else (x, z - offset_m)
    centre = (pressure * u).sum() / pressure.sum(), (pressure * w).sum() / pressure.sum()
    return float((pressure * np.hypot(u - centre[0], w - centre[1])).sum() / pressure.sum())
