"""Where and how hard pads press in a hold, from geometry alone: the elastic foundation of the pads under an object's faces.

Both fingers press with the same force, each pad on what it touches of the object. Where an object is held askew, the pads touch opposite
ends of it, and friction alone keeps it from turning upright: such a grip has spent a part of its friction before any load comes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import brentq
from scipy.spatial import ConvexHull

from objects.gripper import FINGER_FROM_HAND_M, TCP_FROM_HAND_M
from objects.object_model import ObjectModel
from pipelines.engines.physics.hand_params import HandWorldParams
from pipelines.engines.physics.pads import PAD_CENTRE_M, PAD_SIZE_M

POINTS_PER_SIDE = 24
_FLAT = 1e-9  # components of a normal below this do not bound the object along the jaw
_DEEPEST_M = 1.0  # beyond any depth that a pad can be pressed in


@dataclass(frozen=True, slots=True)
class ContactPatch:
    """The pressure of both pads on an object, in the hand's axes with the TCP as origin.

    Attributes:
        centre_m: midway between the two centres of pressure.
        levers_m: of each pad: mean distance of its pressure from its centre in the pad's plane, the torque about the jaw axis that it
            holds over its friction x force.
        preload_n: friction of the pad at +y in the pad's plane (x and z) that keeps the grip from turning; the other pad's is opposite.
    """

    centre_m: Float[np.ndarray, "3"]
    levers_m: tuple[float, float]
    preload_n: Float[np.ndarray, "2"]


def contact_patch(object_model: ObjectModel, T_tcp_object: Float[np.ndarray, "4 4"], params: HandWorldParams) -> ContactPatch | None:
    """The patch of a hold at rest without load; None where a pad's face does not meet the object."""
    force_n = params.finger_force_n
    found = [_pad(object_model, T_tcp_object, side, force_n, params.pad_stiffness_n_m) for side in (1.0, -1.0)]
    (left_m, left_lever_m), (right_m, right_lever_m) = found
    apart_m = left_m - right_m
    if not np.isfinite(apart_m).all():
        return None
    # The normal forces are a couple of arm `apart` in the pads' plane; friction across the object's width balances it.
    preload_n = force_n * apart_m[[0, 2]] / apart_m[1]
    scale = params.pad_lever_scale
    return ContactPatch((left_m + right_m) / 2, (scale * left_lever_m, scale * right_lever_m), preload_n)


def _pad(
    object_model: ObjectModel, T_tcp_object: Float[np.ndarray, "4 4"], side: float, force_n: float, stiffness_n_m: float
) -> tuple[Float[np.ndarray, "3"], float]:
    """Centre of pressure of the pad at +y or -y and its lever; not finite where it meets nothing."""
    at = (np.arange(POINTS_PER_SIDE) + 0.5) / POINTS_PER_SIDE - 0.5
    middle_z_m = PAD_CENTRE_M[1] + FINGER_FROM_HAND_M - TCP_FROM_HAND_M
    x, z = np.meshgrid(PAD_CENTRE_M[0] + at * PAD_SIZE_M[0], middle_z_m + at * PAD_SIZE_M[1], indexing="ij")
    reach_m = _reach_m(object_model, T_tcp_object, side, x, z)
    furthest_m = float(reach_m.max())
    if not np.isfinite(furthest_m):
        return np.full(3, np.nan), np.nan
    gap_m, k = furthest_m - reach_m, stiffness_n_m / POINTS_PER_SIDE**2
    depth_m = brentq(lambda depth: k * np.clip(depth - gap_m, 0.0, None).sum() - force_n, 0.0, _DEEPEST_M)
    share = np.clip(depth_m - gap_m, 0.0, None)
    share /= share.sum()
    centre_x, centre_z = float((share * x).sum()), float((share * z).sum())
    return np.array([centre_x, side * furthest_m, centre_z]), float((share * np.hypot(x - centre_x, z - centre_z)).sum())


def _reach_m(
    object_model: ObjectModel, T: Float[np.ndarray, "4 4"], side: float, x: Float[np.ndarray, "n n"], z: Float[np.ndarray, "n n"]
) -> Float[np.ndarray, "n n"]:
    """How far the object reaches along +y (side 1) or -y (side -1) at points of the pad's plane; minus infinity where it is not."""
    furthest = np.full(x.shape, -np.inf)
    for part in object_model.parts:
        vertices_m = (part.vertices_m @ T[:3, :3].T + T[:3, 3]) * np.array([1.0, side, 1.0])
        planes = ConvexHull(vertices_m).equations
        normals, room = planes[:, :3], -planes[:, 3] - x[..., None] * planes[:, 0] - z[..., None] * planes[:, 2]
        up, down = normals[:, 1] > _FLAT, normals[:, 1] < -_FLAT
        top, bottom = (room[..., up] / normals[up, 1]).min(axis=-1), (room[..., down] / normals[down, 1]).max(axis=-1)
        is_inside = (bottom <= top) & (room[..., ~(up | down)] >= 0.0).all(axis=-1)
        furthest = np.where(is_inside, np.maximum(furthest, top), furthest)
    return furthest
