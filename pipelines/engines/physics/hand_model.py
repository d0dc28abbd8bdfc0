"""Builds the MuJoCo models of one scene: the hand at rest in its own frame, the hand that slides, no hand; stepping is hand_world.py.

All three hold the object as a free body of its exact convex parts with the catalogue's mass, centre of mass and inertia, and table and
obstacles as one mocap body. Links 5 to 7 of the arm do not collide here: the planner keeps them off everything and the path audit
rechecks the executed path; so does the palm against table and obstacles while the hand turns.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float

from objects.gripper import FINGER_BOXES, FINGER_FROM_HAND_M, MAX_JAW_M, TCP_FROM_HAND_M
from objects.object_model import ObjectModel
from pipelines.engines.physics.bodies import link_mesh_vertices
from pipelines.engines.physics.errors import PhysicsError
from pipelines.engines.physics.hand_params import HandWorldParams
from pipelines.engines.physics.pads import PAD_FACE_M, PadCells, pad_cells
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
# How fast a pad's contact takes up speed, 1/s: below 1 / step. With stiffness and relaxation given it moves nothing else but the condition
# of the solver's matrix.
PAD_RATE_PER_S = 800.0
# Collision groups: environment, object, hand. The object meets both others, the hand the environment, nothing itself.
_ENVIRONMENT: Attributes = {"contype": "1", "conaffinity": "0"}
_OBJECT: Attributes = {"contype": "2", "conaffinity": "5"}
_HAND: Attributes = {"contype": "4", "conaffinity": "1"}


class Carrier(StrEnum):
    """What moves with respect to the frame of the simulation."""

    HAND_FRAME = "hand_frame"  # the frame is the hand's: the hand is at rest in it, table and obstacles go by
    REST_FRAME = "rest_frame"  # the frame is at rest: the hand slides in it
    NO_HAND = "no_hand"  # the base frame, the object alone


@dataclass(frozen=True, slots=True)
class SceneModel:
    """A compiled model, and where its parts are in MuJoCo's arrays."""

    model: mujoco.MjModel
    carrier: Carrier
    object_body: int
    object_q: int
    object_v: int
    finger_q: tuple[int, ...]
    finger_v: tuple[int, ...]
    slide_q: tuple[int, ...]
    slide_v: tuple[int, ...]
    sensor_adr: dict[str, int]
    object_geoms: frozenset[int]
    hand_geoms: frozenset[int]


def build_model(object_model: ObjectModel, obstacles: Sequence[Obstacle], params: HandWorldParams, carrier: Carrier) -> SceneModel:
    """Compile one model.

    Raises:
        PhysicsError: MuJoCo refuses it; names the object.
    """
    try:
        model = mujoco.MjModel.from_xml_string(_xml(object_model, obstacles, params, carrier))
    except ValueError as error:
        raise PhysicsError(f"{object_model.object_id} with {len(object_model.parts)} convex parts, {carrier.value}: {error}") from error
    _set_pad_yield(model, params)
    names = [model.geom(k).name for k in range(model.ngeom)]
    has_hand = carrier is not Carrier.NO_HAND
    slides = SLIDES if carrier is Carrier.REST_FRAME else ()

    def at(field: str, joints: Sequence[str]) -> tuple[int, ...]:
        return tuple(int(getattr(model.joint(name), field)[0]) for name in joints)

    return SceneModel(
        model=model,
        carrier=carrier,
        object_body=int(model.body("object").id),
        object_q=at("qposadr", ["object"])[0],
        object_v=at("dofadr", ["object"])[0],
        finger_q=at("qposadr", FINGERS if has_hand else ()),
        finger_v=at("dofadr", FINGERS if has_hand else ()),
        slide_q=at("qposadr", slides),
        slide_v=at("dofadr", slides),
        sensor_adr={model.sensor(k).name: k for k in range(model.nsensor)},
        object_geoms=frozenset(k for k, name in enumerate(names) if name.startswith("part ")),
        hand_geoms=frozenset(k for k, name in enumerate(names) if name.startswith("panda_")),
    )


def fixed_bodies(obstacles: Sequence[Obstacle]) -> tuple[str, ...]:
    """Names of the table and the obstacles."""
    return ("table", *(f"obstacle {obstacle.obstacle_id}" for obstacle in obstacles))


def _xml(object_model: ObjectModel, obstacles: Sequence[Obstacle], params: HandWorldParams, carrier: Carrier) -> str:
    root = ET.Element("mujoco")
    ET.SubElement(root, "compiler", angle="radian", autolimits="true", inertiafromgeom="false")
    option = ET.SubElement(
        root,
        "option",
        timestep=repr(params.step_s),
        # Whatever is damped implicitly outside of the constraint solver (implicitfast) is not what the solver reckoned with: pads
        # then stay pressed in by 0.3 mm under forces that belong to 0.04. Here nothing is.
        integrator="Euler",
        cone="elliptic",
        solver="Newton",
        # MuJoCo 4.0.0 factorises sparse Hessians wrongly (its issue 3767); a dozen degrees of freedom are dense anyway.
        jacobian="dense",
        impratio=repr(params.friction_stiffness_ratio),
        iterations=str(params.solver_iterations),
        tolerance=repr(params.solver_tolerance),
    )
    # A diverged state must stay visible: MuJoCo would start again from the initial one.
    ET.SubElement(option, "flag", multiccd="enable", nativeccd="enable", autoreset="disable")
    ET.SubElement(root, "size", memory="32M")
    asset, world = ET.SubElement(root, "asset"), ET.SubElement(root, "worldbody")
    _add_environment(world, object_model, obstacles, params)
    _add_object(asset, world, object_model)
    sensors = ET.SubElement(root, "sensor")
    history = str(params.steps_per_tick)
    for name in fixed_bodies(obstacles):
        _add_force(sensors, f"object {name}", history, body1="object", geom2=name)
    if carrier is not Carrier.NO_HAND:
        _add_hand(root, asset, world, object_model, params, carrier)
        for name in fixed_bodies(obstacles):
            _add_force(sensors, f"robot {name}", history, subtree1="panda_hand", geom2=name)
        _add_force(sensors, "robot anything", history, subtree1="panda_hand")
        for name in HAND_PARTS:
            _add_force(sensors, name, "0", body1=name, body2="object")
    return ET.tostring(root, encoding="unicode")


def _add_force(sensors: ET.Element, name: str, history: str, **between: Any) -> None:
    """Net contact force between two things; `history` steps of it are kept: no step's force is lost to whoever looks once a tick."""
    ET.SubElement(sensors, "contact", name=name, data="force", reduce="netforce", nsample=history, **between)


def _add_environment(world: ET.Element, object_model: ObjectModel, obstacles: Sequence[Obstacle], params: HandWorldParams) -> None:
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


def _add_object(asset: ET.Element, world: ET.Element, object_model: ObjectModel) -> None:
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
        box = box_of(part.vertices_m)
        if box is not None:
            ET.SubElement(body, "geom", name=f"part {k}", type="box", pos=_text(box[0]), size=_text(box[1]), **_OBJECT)
        else:
            # MuJoCo moves a mesh to its own centre and axes and gives the geom the pose that undoes it; mass properties are given above.
            ET.SubElement(asset, "mesh", name=f"part {k}", vertex=_text(part.vertices_m), inertia="convex")
            ET.SubElement(body, "geom", name=f"part {k}", type="mesh", mesh=f"part {k}", **_OBJECT)


def _add_hand(
    root: ET.Element, asset: ET.Element, world: ET.Element, object_model: ObjectModel, params: HandWorldParams, carrier: Carrier
) -> None:
    """Palm and fingers; the TCP is the origin. Drives are servos of speed; the grip force is applied on top of them."""
    body = ET.SubElement(world, "body", name="panda_hand", pos=_text([0.0, 0.0, -TCP_FROM_HAND_M]), gravcomp="1")
    if carrier is Carrier.REST_FRAME:
        for name, axis in zip(SLIDES, np.eye(3), strict=True):
            ET.SubElement(body, "joint", name=name, type="slide", axis=_text(axis))
    ET.SubElement(body, "inertial", pos="0 0 0", mass=repr(HAND_MASS_KG), diaginertia="1 1 1")
    scaled = object_model.friction * params.friction_scale
    bare: Attributes = {"friction": _text([params.table_friction * scaled, 1e-5, 1e-5]), "priority": "2", "condim": "3", **_HAND, **_HARD}
    mu_pad = params.pad_friction * scaled
    pad: Attributes = {**bare, "friction": _text([mu_pad, 1e-5, 1e-5])}
    ET.SubElement(asset, "mesh", name="panda_hand", vertex=_text(link_mesh_vertices("panda_hand")), inertia="convex")
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


def _set_pad_yield(model: mujoco.MjModel, params: HandWorldParams) -> None:
    """Give every cell its share of the pad's stiffness and damping, in newton and metres whatever the object weighs.

    MuJoCo's contact force f obeys  a + R f = -b v - k r  with R = (1 - d) / d x A and A the two bodies' inverse masses: where a is small,
    the cell is a spring of k / R and a damper of b / R. Its direct format takes k d and b d (for constant d).
    """
    object_body = model.body("object").id
    n_cells = params.cells_per_side**2
    if n_cells == 0:
        return
    b = PAD_RATE_PER_S
    k = b / params.pad_relaxation_s
    R = k / (params.pad_stiffness_n_m / n_cells)
    for geom in range(model.ngeom):
        if " cell " in model.geom(geom).name:
            A = float(model.body_invweight0[object_body, 0] + model.body_invweight0[model.geom_bodyid[geom], 0])
            d = A / (A + R)
            model.geom_solref[geom] = -k * d, -b * d
            model.geom_solimp[geom] = d, d, 0.001, 0.5, 2.0


def box_of(vertices_m: Float[np.ndarray, "v 3"]) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]] | None:
    """Centre and half-extents of the axis-aligned box whose eight corners the vertices are, or None."""
    low, high = vertices_m.min(axis=0), vertices_m.max(axis=0)
    off_corner_m = np.minimum(np.abs(vertices_m - low), np.abs(vertices_m - high)).max()
    if len(vertices_m) != 8 or off_corner_m > 1e-7 or len(np.unique(vertices_m > (low + high) / 2, axis=0)) != 8:
        return None
    return (low + high) / 2, (high - low) / 2


def _text(values: Sequence[float] | Float[np.ndarray, "..."]) -> str:
    return " ".join(repr(float(value)) for value in np.ravel(np.asarray(values)))


def _wxyz(pose: Float[np.ndarray, "7"]) -> str:
    return _text([pose[6], *pose[3:6]])
