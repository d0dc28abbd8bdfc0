"""Hand, object, table and obstacles as PyBullet is given them, the same shapes and frictions as in MuJoCo's models; see bullet_state.py.

Everything is URDF: only `loadURDF` takes the flag with which Bullet keeps the faces of its hulls, and only hulls whose faces it knows get
a whole patch of contacts at once and no margin around them. Without, each step adds one point, and a can rolls from point to point.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

from objects.gripper import FINGER_BOXES, FINGER_FROM_HAND_M, MAX_JAW_M, TCP_FROM_HAND_M
from objects.object_model import ObjectModel
from pipelines.engines.bullet import pybullet
from pipelines.engines.physics.bodies import hull_mesh
from pipelines.engines.physics.hand_bodies import FINGERS, SLIDES, box_of
from pipelines.engines.physics.hand_params import HandWorldParams
from pipelines.engines.robot.description import collision_vertices
from pipelines.proofs.validity.second_engine.contact_law import ContactLaw, ContactYield
from pipelines.values import Obstacle
from tables.vocabulary import Symmetry

PALM = "panda_hand"
_FLAGS = pybullet.URDF_USE_INERTIA_FROM_FILE | pybullet.URDF_INITIALIZE_SAT_FEATURES
# The hand that slides is driven, not pushed: contacts move it by nanometres in a tick. Links before the palm carry nothing but a joint.
_HAND_MASS_KG, _SLIDER_KG = 1e4, 1.0
_BARE = " bare"  # of a finger: a link of its own, for Bullet knows one friction a link
_SPIN_M = 1e-5  # torsional friction of round objects on table and obstacles, as in MuJoCo's model


@dataclass(frozen=True, slots=True)
class HandIds:
    """The numbers by which a client knows the hand: its body, its slides and finger joints in order, and the part that each link is of."""

    body: int
    slides: tuple[int, int, int]
    fingers: tuple[int, int]
    part_of: dict[int, str]

    @property
    def joints(self) -> tuple[int, ...]:
        """Slides, then fingers."""
        return (*self.slides, *self.fingers)


def carried_kg(params: HandWorldParams) -> Float[np.ndarray, "3"]:
    """What each slide has to move: itself and all links after it."""
    return _HAND_MASS_KG + 2 * params.finger_mass_kg + _SLIDER_KG * np.array([2.0, 1.0, 0.0])


def write_object(folder: Path, object_model: ObjectModel) -> tuple[Path, Float[np.ndarray, "4 4"]]:
    """The object's URDF, and T_object_mass: Bullet's base frame is that of the principal inertia."""
    moments, R = _principal(object_model.inertia_kg_m2)
    T_object_mass = np.eye(4)
    T_object_mass[:3, :3], T_object_mass[:3, 3] = R, object_model.com_m
    shapes = []
    for k, part in enumerate(object_model.parts):
        box = box_of(part.vertices_m)
        if box is not None:
            T_mass_box = np.eye(4)
            T_mass_box[:3, :3], T_mass_box[:3, 3] = R.T, R.T @ (box[0] - object_model.com_m)
            shapes.append(_box(2 * box[1], T_mass_box))
        else:
            shapes.append(_hull(folder, f"part_{k}", (part.vertices_m - object_model.com_m) @ R))
    path = folder / "object.urdf"
    path.write_text(f'<robot name="object">{_link("object", object_model.mass_kg, moments, shapes)}</robot>')
    return path, T_object_mass


def write_hand(folder: Path, params: HandWorldParams) -> Path:
    """The hand's URDF: three slides, palm and fingers; the TCP is the origin. The pads are rigid boxes."""
    unit, origin = np.ones(3), np.zeros(3)
    palm_m, finger_m = np.array([0.0, 0.0, -TCP_FROM_HAND_M]), np.array([0.0, 0.0, FINGER_FROM_HAND_M])
    elements = [_link("frame", 1.0, unit, []), *(_link(name, _SLIDER_KG, unit, []) for name in SLIDES[:2])]
    elements.append(_link(PALM, _HAND_MASS_KG, unit, [_hull(folder, "palm", collision_vertices(PALM.removeprefix("panda_")))]))
    for parent, child, axis in zip(("frame", *SLIDES[:2]), (*SLIDES[:2], PALM), np.eye(3), strict=True):
        elements.append(_joint(parent, child, palm_m if child == PALM else origin, axis, (-10.0, 10.0)))
    for side, name in zip((1.0, -1.0), FINGERS, strict=True):
        for (centre, size), link in zip(FINGER_BOXES, (name, name + _BARE), strict=True):
            back_m = params.pad_protrusion_m if link == name else 0.0
            T = np.eye(4)
            T[:3, 3] = np.array(centre) * [1.0, side, 1.0] + [0.0, side * back_m / 2, 0.0]
            shape = _box(np.array(size) - [0.0, back_m, 0.0], T)
            elements.append(_link(link, params.finger_mass_kg / 2, np.full(3, 5e-5), [shape]))
        elements.append(_joint(PALM, name, finger_m, np.array([0.0, side, 0.0]), (0.0, MAX_JAW_M / 2)))
        elements.append(_joint(name, name + _BARE, origin, None, (0.0, 0.0)))
    path = folder / "hand.urdf"
    path.write_text(f'<robot name="hand">{"".join(elements)}</robot>')
    return path


def write_fixed(folder: Path, obstacles: Sequence[Obstacle], params: HandWorldParams) -> list[tuple[Path, Float[np.ndarray, "4 4"]]]:
    """URDF and pose in the base frame of the table and of each obstacle, boxes that never move."""
    (x0, x1), (y0, y1), thickness = params.table_x_m, params.table_y_m, params.table_thickness_m
    T_table = np.eye(4)
    T_table[:3, 3] = (x0 + x1) / 2, (y0 + y1) / 2, -thickness / 2
    boxes = [(np.array([x1 - x0, y1 - y0, thickness]), T_table), *((o.size_m, o.T_base_obstacle) for o in obstacles)]
    fixed = []
    for k, (size_m, T) in enumerate(boxes):
        path = folder / f"fixed_{k}.urdf"
        path.write_text(f'<robot name="fixed">{_link("fixed", 0.0, np.zeros(3), [_box(size_m, np.eye(4))])}</robot>')
        fixed.append((path, T))
    return fixed


def add_fixed(client: int, path: Path, object_model: ObjectModel, params: HandWorldParams, law: ContactLaw) -> int:
    """Table or an obstacle, at the origin."""
    body = int(pybullet.loadURDF(str(path), useFixedBase=True, flags=_FLAGS, physicsClientId=client))
    rolls = object_model.symmetry is not Symmetry.BOX
    # Bullet multiplies rolling and spinning friction, which are lengths, with the other body's sliding friction; MuJoCo does not.
    scaled = object_model.friction * params.friction_scale
    spin_m, roll_m = (_SPIN_M / scaled, params.rolling_friction_m / scaled) if rolls else (0.0, 0.0)
    _set_surface(client, body, -1, params.table_friction, law.fixed, spin_m, roll_m)
    return body


def add_object(client: int, path: Path, object_model: ObjectModel, params: HandWorldParams) -> int:
    """The object, a free rigid body that nothing damps; how its contacts yield is said by what it meets."""
    body = int(pybullet.loadURDF(str(path), useMaximalCoordinates=True, flags=_FLAGS, physicsClientId=client))
    _set_surface(client, body, -1, object_model.friction * params.friction_scale, None)
    pybullet.changeDynamics(body, -1, linearDamping=0.0, angularDamping=0.0, physicsClientId=client)
    return body


def add_hand(client: int, path: Path, params: HandWorldParams, law: ContactLaw) -> HandIds:
    """The hand, its fingers coupled by a belt, with no motor but the forces that it is given each step."""
    body = int(pybullet.loadURDF(str(path), useFixedBase=True, flags=_FLAGS, physicsClientId=client))
    infos = [pybullet.getJointInfo(body, k, physicsClientId=client) for k in range(pybullet.getNumJoints(body, physicsClientId=client))]
    links = {info[12].decode(): int(info[0]) for info in infos}
    for name, link in links.items():
        friction = params.pad_friction if name in FINGERS else params.table_friction
        _set_surface(client, body, link, friction, law.palm if name == PALM else law.finger)
        pybullet.changeDynamics(body, link, linearDamping=0.0, angularDamping=0.0, jointDamping=0.0, physicsClientId=client)
    hand = HandIds(
        body,
        (links[SLIDES[0]], links[SLIDES[1]], links[PALM]),
        (links[FINGERS[0]], links[FINGERS[1]]),
        {link: name.removesuffix(_BARE) for name, link in links.items()},
    )
    pybullet.setJointMotorControlArray(body, hand.joints, pybullet.VELOCITY_CONTROL, forces=[0.0] * 5, physicsClientId=client)
    left, right = hand.fingers
    belt = pybullet.createConstraint(body, left, body, right, pybullet.JOINT_GEAR, [0, 1, 0], [0] * 3, [0] * 3, physicsClientId=client)
    pybullet.changeConstraint(belt, gearRatio=-1, erp=0.2, maxForce=1e3, physicsClientId=client)
    return hand


def _set_surface(
    client: int, body: int, link: int, friction: float, yields: ContactYield | None, spin_m: float = 0.0, roll_m: float = 0.0
) -> None:
    surface = {"lateralFriction": friction, "spinningFriction": spin_m, "rollingFriction": roll_m, "restitution": 0.0}
    if yields is not None:
        surface |= {"contactStiffness": yields.stiffness_n_m, "contactDamping": yields.damping_n_s_m}
    pybullet.changeDynamics(body, link, physicsClientId=client, **surface)


def _principal(inertia_kg_m2: Float[np.ndarray, "3 3"]) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """Principal moments and axes, these as near to the frame's as can be: a box that is aligned stays so."""
    moments, axes = np.linalg.eigh(inertia_kg_m2)
    _, order = linear_sum_assignment(-np.abs(axes))
    moments, axes = moments[order], axes[:, order]
    axes = axes * np.sign(np.diag(axes))
    # Three axes that each lean the right way may still be mirrored where none is near to the frame's.
    return moments, axes * np.array([1.0, 1.0, np.sign(np.linalg.det(axes))])


def _link(name: str, mass_kg: float, moments: Float[np.ndarray, "3"], shapes: Sequence[str]) -> str:
    x, y, z = (repr(float(value)) for value in moments)
    inertia = f'<inertia ixx="{x}" iyy="{y}" izz="{z}" ixy="0" ixz="0" iyz="0"/>'
    return f'<link name="{name}"><inertial><mass value="{mass_kg!r}"/>{inertia}</inertial>{"".join(shapes)}</link>'


def _joint(parent: str, child: str, at_m: Float[np.ndarray, "3"], axis: Float[np.ndarray, "3"] | None, range_m: tuple[float, float]) -> str:
    """A slide, or a fixed joint where there is no axis."""
    kind = "fixed" if axis is None else "prismatic"
    slide = (
        "" if axis is None else f'<axis xyz="{_text(axis)}"/><limit lower="{range_m[0]}" upper="{range_m[1]}" effort="1e6" velocity="1e3"/>'
    )
    ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="{_text(at_m)}"/>'
    return f'<joint name="{child} joint" type="{kind}">{ends}{slide}</joint>'


def _box(size_m: Float[np.ndarray, "3"], T_link_box: Float[np.ndarray, "4 4"]) -> str:
    return _collision(f'<box size="{_text(size_m)}"/>', T_link_box)


def _hull(folder: Path, name: str, vertices_m: Float[np.ndarray, "v 3"]) -> str:
    mesh = hull_mesh(vertices_m)
    lines = [f"o {name}", *(f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices_m.tolist())]
    lines += [f"f {a} {b} {c}" for a, b, c in (mesh.faces + 1).tolist()]
    (folder / f"{name}.obj").write_text("\n".join(lines) + "\n")
    return _collision(f'<mesh filename="{name}.obj"/>', np.eye(4))


def _collision(geometry: str, T_link_shape: Float[np.ndarray, "4 4"]) -> str:
    rpy = Rotation.from_matrix(T_link_shape[:3, :3]).as_euler("xyz")
    return f'<collision><origin xyz="{_text(T_link_shape[:3, 3])}" rpy="{_text(rpy)}"/><geometry>{geometry}</geometry></collision>'


def _text(values: Sequence[float] | Float[np.ndarray, "..."]) -> str:
    return " ".join(repr(float(value)) for value in values)
