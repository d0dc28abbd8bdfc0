"""What a grasp is called, by where its fingers close on the object and where the hand comes from."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from objects.catalogue import MugShape, ObjectSpec
from objects.contacts import ContactPairs
from tables.vocabulary import Category

# A pair that nobody would hold the object by, such as the handle of a mug from end to end.
NO_KIND = "none"
# Within this of the axis of the object an approach is from the top or from the bottom.
AXIAL_APPROACH_RAD = np.radians(35.0)


def grasp_kinds(spec: ObjectSpec, T_object_grasp: Float[np.ndarray, "n 4 4"], pairs: ContactPairs) -> list[str]:
    """Kind of each grasp.

    A can: `side` across its round side, `top` and `bottom` the same with the hand over an end, `caps` end to end. A mug: `handle`
    with both contacts on the handle, `rim` with one finger in the cavity, `body` around the outside. A cuboid: `face_x`, `face_y`,
    `face_z` by the faces held. The mesh of a user: `grip`.
    """
    axis, approach_z = np.abs(pairs.axis), T_object_grasp[:, 2, 2]
    if spec.category is Category.CAN:
        caps, axial = axis[:, 2] > 0.7, np.cos(AXIAL_APPROACH_RAD)
        return _names(np.select([caps, approach_z < -axial, approach_z > axial], ["caps", "top", "bottom"], "side"))
    if spec.category is Category.CUBOID:
        return [f"face_{'xyz'[k]}" for k in axis.argmax(axis=1)]
    if isinstance(spec.shape, MugShape):
        on_handle = [_beyond_body(points, spec.shape) for points in (pairs.a_m, pairs.b_m)]
        in_cavity = [_in_cavity(points, spec.shape) for points in (pairs.a_m, pairs.b_m)]
        across_bar = pairs.width_m < 2.0 * max(spec.shape.handle_width_m, spec.shape.handle_thickness_m)
        conditions = [on_handle[0] & on_handle[1] & across_bar, on_handle[0] | on_handle[1], in_cavity[0] | in_cavity[1]]
        return _names(np.select(conditions, ["handle", NO_KIND, "rim"], "body"))
    return ["grip"] * len(T_object_grasp)


def _names(kinds: np.ndarray) -> list[str]:
    return [str(kind) for kind in kinds]


def _body_radius(z: Float[np.ndarray, "n"], shape: MugShape) -> Float[np.ndarray, "n"]:
    return np.asarray((shape.base_diameter_m + (shape.diameter_m - shape.base_diameter_m) * (z / shape.height_m + 0.5)) / 2)


def _beyond_body(points_m: Float[np.ndarray, "n 3"], shape: MugShape) -> np.ndarray:
    """Outside the body of revolution by more than the error of its facets."""
    return np.asarray(np.hypot(points_m[:, 0], points_m[:, 1]) > _body_radius(points_m[:, 2], shape) + 5e-4)


def _in_cavity(points_m: Float[np.ndarray, "n 3"], shape: MugShape) -> np.ndarray:
    """On the inner wall or the floor of the cavity: nearer to the axis than the middle of the wall, and above the base."""
    inside = np.hypot(points_m[:, 0], points_m[:, 1]) < _body_radius(points_m[:, 2], shape) - shape.wall_m / 2
    return np.asarray(inside & (points_m[:, 2] > -shape.height_m / 2 + shape.base_m / 2))
