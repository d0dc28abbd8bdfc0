"""What stands in a scene of the held object's engine, as MuJoCo's XML: table and obstacles, the object, palm and fingers with their pads.

Models are compiled in hand_model.py.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from objects.gripper import FINGER_BOXES, FINGER_FROM_HAND_M, MAX_JAW_M, TCP_FROM_HAND_M
from objects.object_model import ObjectModel
from pipelines.engines.physics.hand_params import HandWorldParams
from pipelines.engines.physics.pads import PAD_FACE_M, PadCells, pad_cells
from pipelines.engines.robot.description import collision_vertices
from pipelines.values import Obstacle
from tables.poses import pose_of
from tables.vocabulary import Symmetry

Attributes = dict[str, Any]  # of an XML element: all are text; its type stubs want no narrower dictionary

FINGERS = ("panda_leftfinger", "panda_rightfinger")
HAND_PARTS = ("panda_hand", *FINGERS)
SLIDES = ("hand_x", "hand_y", "hand_z")
# The hand that slides is driven, not pushed: this heavy, contacts move it by nanometres in a tick, and each tick starts on the path.
HAND_MASS_KG = 1e4

# Contacts of MuJoCo are springs and dampers per mass. Of the palm and the bare fingers: as stiff as a step of a millisecond bears.
# Of table and obstacles: an object sinks in by 16 um over the number of its contacts, and a hand that presses it down a millimetre
# is met by hundreds of newton, not thousands, before it stops.
_HARD: Attributes = {"solref": "0.0021 1", "solimp": "0.98 0.98 0.001 0.5 2"}
_TABLE: Attributes = {"solref": "0.0042 1", "solimp": "0.9 0.9 0.001 0.5 2"}
# Collision groups: environment, object, hand. The object meets both others, the hand the environment, nothing itself.
_ENVIRONMENT: Attributes = {"contype": "1", "conaffinity": "0"}
_OBJECT: Attributes = {"contype": "2", "conaffinity": "5"}
_HAND: Attributes = {"contype": "4", "conaffinity": "1"}


def fixed_bodies(obstacles: Sequence[Obstacle]) -> tuple[str, ...]:
    """Names of the table and the obstacles."""
    return ("table", *(f"obstacle {obstacle.obstacle_id}" for obstacle in obstacles))


def add_environment(world: ET.Element, object_model: ObjectModel, obstacles: Sequence[Obstacle], params: HandWorldParams) -> None:
    """Table and obstacles in the base frame, which is the frame of their mocap body."""
    body = ET.SubElement(world, "body", name="environment", mocap="true")
    mu = params.table_friction * object_model.friction * params.friction_scale
    rolls = object_model.symmetry is not Symmetry.BOX
    surface = {
        "condim": "6" if rolls else "3",
        "friction": _text([mu, 1e-5, params.rolling_friction_m]),
        "priority": "1",
        **_ENVIRONMENT,
        **_TABLE,
    }
    (x0, x1), (y0, y1), thickness = params.table_x_m, params.table_y_m, params.table_thickness_m
    ET.SubElement(
        body,
        "geom",
        name="table",
        type="box",
        pos=_text([(x0 + x1) / 2, (y0 + y1) / 2, -thickness / 2]),
        size=_text([(x1 - x0) / 2, (y1 - y0) / 2, thickness / 2]),
        **surface,
    )
    for obstacle in obstacles:
        pose = pose_of(obstacle.T_base_obstacle)
        name = f"obstacle {obstacle.obstacle_id}"
        ET.SubElement(
            body, "geom", name=name, type="box", pos=_text(pose[:3]), quat=_wxyz(pose), size=_text(obstacle.size_m / 2), **surface
        )


def add_object(asset: ET.Element, world: ET.Element, object_model: ObjectModel, *, are_rounds_hulls: bool = False) -> None:
    """A free body of the exact convex parts, with the catalogue's mass, centre of mass and inertia.

    A can, a prism of 48 sides elsewhere, is a cylinder here: a released prism rolls by whole facets of 4 mm, and pulled across its axis it
    wedges between the pads by half a facet.
    """
    body = ET.SubElement(world, "body", name="object")
    ET.SubElement(body, "freejoint", name="object")
    I = object_model.inertia_kg_m2
    ET.SubElement(
        body,
        "inertial",
        pos=_text(object_model.com_m),
        mass=repr(float(object_model.mass_kg)),
        fullinertia=_text([I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]]),
    )
    for k, part in enumerate(object_model.parts):
        vertices_m = part.vertices_m
        box, cylinder = box_of(vertices_m), None if are_rounds_hulls else cylinder_of(vertices_m)
        if box is not None:
            ET.SubElement(body, "geom", name=f"part {k}", type="box", pos=_text(box[0]), size=_text(box[1]), **_OBJECT)
        elif cylinder is not None:
            centre_m, size_m = _text(cylinder[0]), _text(cylinder[1:])
            ET.SubElement(body, "geom", name=f"part {k}", type="cylinder", pos=centre_m, size=size_m, **_OBJECT)
        else:
            # MuJoCo moves a mesh to its own centre and axes and gives the geom the pose that undoes it; mass properties are given above.
            ET.SubElement(asset, "mesh", name=f"part {k}", vertex=_text(vertices_m), inertia="convex")
            ET.SubElement(body, "geom", name=f"part {k}", type="mesh", mesh=f"part {k}", **_OBJECT)


def add_hand(
    root: ET.Element, asset: ET.Element, world: ET.Element, object_model: ObjectModel, params: HandWorldParams, is_sliding: bool
) -> None:
    """Palm and fingers; the TCP is the origin. Drives are servos of speed; the grip force is applied on top of them.

    Args:
        is_sliding: the hand moves along x, y and z of the frame; otherwise it is at rest in it.
    """
    body = ET.SubElement(world, "body", name="panda_hand", pos=_text([0.0, 0.0, -TCP_FROM_HAND_M]), gravcomp="1")
    if is_sliding:
        for name, axis in zip(SLIDES, np.eye(3), strict=True):
            ET.SubElement(body, "joint", name=name, type="slide", axis=_text(axis))
    ET.SubElement(body, "inertial", pos="0 0 0", mass=repr(HAND_MASS_KG), diaginertia="1 1 1")
    scaled = object_model.friction * params.friction_scale
    bare: Attributes = {"friction": _text([params.table_friction * scaled, 1e-5, 1e-5]), "priority": "2", "condim": "3", **_HAND, **_HARD}
    mu_pad = params.pad_friction * scaled
    pad: Attributes = {**bare, "friction": _text([mu_pad, 1e-5, 1e-5])}
    ET.SubElement(asset, "mesh", name="panda_hand", vertex=_text(collision_vertices("hand")), inertia="convex")
    ET.SubElement(body, "geom", name="panda_hand 0", type="mesh", mesh="panda_hand", **bare)
    cells = pad_cells(params.cells_per_side, params.pad_lever_scale)
    cell: Attributes = {**bare, "friction": _text([mu_pad, mu_pad * cells.lever_m, 1e-5]), "condim": "4"}
    drives = ET.SubElement(root, "actuator")
    gain = params.finger_mass_kg / params.finger_lag_s
    for side, name in zip((1.0, -1.0), FINGERS, strict=True):
        finger = ET.SubElement(body, "body", name=name, pos=_text([0.0, 0.0, FINGER_FROM_HAND_M]), gravcomp="1")
        ET.SubElement(finger, "joint", name=name, type="slide", axis=_text([0.0, side, 0.0]), range=_text([0.0, MAX_JAW_M / 2]), **_limit())
        inertia = _text([1e-4] * 3)
        ET.SubElement(finger, "inertial", pos="0 0 0", mass=repr(params.finger_mass_kg), diaginertia=inertia)
        _add_finger_geoms(finger, name, side, cells, params.pad_protrusion_m, {"cell": cell, "pad": pad, "bare": bare})
        ET.SubElement(
            drives,
            "general",
            name=name,
            joint=name,
            gainprm=_text([gain, 0.0, 0.0]),
            biastype="affine",
            biasprm=_text([0.0, 0.0, -gain]),
            forcerange=_text([-params.finger_force_n, params.finger_force_n]),
        )
    # One drive moves both fingers by a belt.
    equality = ET.SubElement(root, "equality")
    ET.SubElement(equality, "joint", joint1=FINGERS[0], joint2=FINGERS[1], polycoef="0 1 0 0 0", **_HARD)


def _limit() -> Attributes:
    return {"solreflimit": _HARD["solref"], "solimplimit": _HARD["solimp"]}


def _add_finger_geoms(
    finger: ET.Element, name: str, side: float, cells: PadCells, protrusion_m: float, surfaces: Mapping[str, Attributes]
) -> None:
    """The pad's cells, the rigid block behind them, and the bare finger."""
    for k, ((x, y, z), (sx, sy, sz)) in enumerate(FINGER_BOXES):
        is_pad = k == 0
        if is_pad:
            for c, (u, w) in enumerate(cells.points_m):
                centre = _text([x + u, side * (PAD_FACE_M + cells.radius_m), z + w])
                ET.SubElement(
                    finger, "geom", name=f"{name} cell {c}", type="sphere", size=repr(cells.radius_m), pos=centre, **surfaces["cell"]
                )
            y, sy = y + protrusion_m / 2, sy - protrusion_m
        box: Attributes = {"pos": _text([x, side * y, z]), "size": _text([sx / 2, sy / 2, sz / 2])}
        ET.SubElement(finger, "geom", name=f"{name} {k}", type="box", **box, **surfaces["pad" if is_pad else "bare"])


def box_of(vertices_m: Float[np.ndarray, "v 3"]) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]] | None:
    """Centre and half-extents of the axis-aligned box whose eight corners the vertices are, or None."""
    low, high = vertices_m.min(axis=0), vertices_m.max(axis=0)
    off_corner_m = np.minimum(np.abs(vertices_m - low), np.abs(vertices_m - high)).max()
    if len(vertices_m) != 8 or off_corner_m > 1e-7 or len(np.unique(vertices_m > (low + high) / 2, axis=0)) != 8:
        return None
    return (low + high) / 2, (high - low) / 2


def cylinder_of(vertices_m: Float[np.ndarray, "v 3"]) -> tuple[Float[np.ndarray, "3"], float, float] | None:
    """Centre, radius and half height of the upright cylinder that a convex part with these vertices stands for, or None.

    All vertices lie on its two ends, and at least 24 on each rim.
    """
    low, high = vertices_m.min(axis=0), vertices_m.max(axis=0)
    centre_m, half_m = (low + high) / 2, float(high[2] - low[2]) / 2
    from_axis_m = np.hypot(*(vertices_m[:, :2] - centre_m[:2]).T)
    radius_m, above_m = float(from_axis_m.max()), vertices_m[:, 2] - centre_m[2]
    is_on_rim = from_axis_m > radius_m - 1e-6
    n_on_rims = [int(np.count_nonzero(is_on_rim & (above_m * side > 0.0))) for side in (1.0, -1.0)]
    is_inside = from_axis_m < 0.9 * radius_m  # the middle of an end, which is no corner of the part
    if min(n_on_rims) < 24 or np.abs(np.abs(above_m) - half_m).max() > 1e-7 or not np.all(is_on_rim | is_inside):
        return None
    return centre_m, radius_m, half_m


def _text(values: Sequence[float] | Float[np.ndarray, "..."]) -> str:
    return " ".join(repr(float(value)) for value in np.ravel(np.asarray(values)))


def _wxyz(pose: Float[np.ndarray, "7"]) -> str:
    return _text([pose[6], *pose[3:6]])
