"""Hand, object, table and obstacles as PyBullet is given them, the same shapes and frictions as in MuJoCo's models; see bullet_world.py.

Everything is URDF: only `loadURDF` takes the flag with which Bullet keeps the faces of its hulls, and only a hull whose faces it knows gets
a whole patch of contacts at once. Without, each step adds one point, and a can that lies in the pads rolls from point to point.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pybullet
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

from objects.gripper import FINGER_BOXES, FINGER_FROM_HAND_M, MAX_JAW_M, TCP_FROM_HAND_M
from objects.object_model import ObjectModel
from pipelines.engines.physics.bodies import hull_mesh, link_mesh_vertices
from pipelines.engines.physics.hand_model import FINGERS, HAND_MASS_KG, HAND_PARTS, SLIDES, box_of
from pipelines.engines.physics.hand_params import HandWorldParams
from pipelines.values import Obstacle
from tables.poses import pose_of
from tables.vocabulary import Symmetry

_FLAGS = pybullet.URDF_USE_INERTIA_FROM_FILE | pybullet.URDF_INITIALIZE_SAT_FEATURES
# Of the links between base and palm, which carry nothing but a sliding joint.
_SLIDER_KG = 1.0
_SPIN_M = 1e-5  # MuJoCo's torsional friction of contacts that are points


@dataclass(frozen=True, slots=True)
class HandIds:
    """The numbers by which a client knows the hand: its body, its slides and finger joints in order, its parts' links by name."""

    body: int
    slides: tuple[int, int, int]
    fingers: tuple[int, int]
    links: dict[str, int]

    @property
    def joints(self) -> tuple[int, ...]:
        """Slides, then fingers."""
        return (*self.slides, *self.fingers)


# What the slides x, y, z have to move: themselves and all links after them.
def carried_kg(params: HandWorldParams) -> Float[np.ndarray, "3"]:
    """Mass that each slide moves."""
    return HAND_MASS_KG + 2 * params.finger_mass_kg + _SLIDER_KG * np.array([2.0, 1.0, 0.0])


def write_object(folder: Path, object_model: ObjectModel) -> tuple[Path, Float[np.ndarray, "4 4"]]:
    """The object's URDF, and T_object_mass: Bullet's base frame is that of the principal inertia."""
    moments, R = _principal(object_model.inertia_kg_m2)
    T_object_mass = np.eye(4)
    T_object_mass[:3, :3], T_object_mass[:3, 3] = R, object_model.com_m
    com = object_model.com_m
    shapes = []
    for k, part in enumerate(object_model.parts):
        # Shapes are written in the mass frame, so that the inertial frame of the URDF is the link's own.
        box = box_of(part.vertices_m)
        if box is not None:
            T_mass_box = np.eye(4)
            T_mass_box[:3, :3], T_mass_box[:3, 3] = R.T, R.T @ (box[0] - com)
            shapes.append(_collision(f'<box size="{_text(2 * box[1])}"/>', T_mass_box))
        else:
            shapes.append(_hull(folder, f"part_{k}", (part.vertices_m - com) @ R))
    inertial = _inertial(object_model.mass_kg, moments)
    path = folder / "object.urdf"
    path.write_text(f'<robot name="object"><link name="object">{inertial}{"".join(shapes)}</link></robot>')
    return path, T_object_mass


def write_hand(folder: Path, params: HandWorldParams) -> Path:
    """The hand's URDF: three slides, palm and fingers; the TCP is the origin. The pads are rigid boxes."""
    palm_z, finger_z = np.array([0.0, 0.0, -TCP_FROM_HAND_M]), np.array([0.0, 0.0, FINGER_FROM_HAND_M])
    links = [f'<link name="frame">{_inertial(1.0, np.ones(3))}</link>']
    for name in SLIDES[:2]:
        links.append(f'<link name="{name}">{_inertial(_SLIDER_KG, np.ones(3))}</link>')
    palm = _hull(folder, "palm", link_mesh_vertices("panda_hand"))
    links.append(f'<link name="panda_hand">{_inertial(HAND_MASS_KG, np.ones(3))}{palm}</link>')
    for parent, child, axis in zip(("frame", *SLIDES[:2]), (*SLIDES[:2], "panda_hand"), np.eye(3), strict=True):
        links.append(_slide(parent, child, palm_z if child == "panda_hand" else np.zeros(3), axis, (-10.0, 10.0)))
    for side, name in zip((1.0, -1.0), FINGERS, strict=True):
        shapes = []
        for k, ((x, y, z), (sx, sy, sz)) in enumerate(FINGER_BOXES):
            back_m = params.pad_protrusion_m if k == 0 else 0.0
            T = np.eye(4)
            T[:3, 3] = x, side * (y + back_m / 2), z
            shapes.append(_collision(f'<box size="{_text([sx, sy - back_m, sz])}"/>', T))
        links.append(f'<link name="{name}">{_inertial(params.finger_mass_kg, np.full(3, 1e-4))}{"".join(shapes)}</link>')
        links.append(_slide("panda_hand", name, finger_z, np.array([0.0, side, 0.0]), (0.0, MAX_JAW_M / 2)))
    path = folder / "hand.urdf"
    path.write_text(f'<robot name="hand">{"".join(links)}</robot>')
    return path


def write_fixed(folder: Path, obstacles: Sequence[Obstacle], params: HandWorldParams) -> list[tuple[Path, Float[np.ndarray, "4 4"]]]:
    """URDF and pose in the base frame of the table and of each obstacle, boxes that never move."""
    (x0, x1), (y0, y1), thickness = params.table_x_m, params.table_y_m, params.table_thickness_m
    T_table = np.eye(4)
    T_table[:3, 3] = (x0 + x1) / 2, (y0 + y1) / 2, -thickness / 2
    boxes = [(np.array([x1 - x0, y1 - y0, thickness]), T_table)] + [(o.size_m, o.T_base_obstacle) for o in obstacles]
    fixed = []
    for k, (size_m, T) in enumerate(boxes):
        path = folder / f"fixed_{k}.urdf"
        shape = _collision(f'<box size="{_text(size_m)}"/>', np.eye(4))
        path.write_text(f'<robot name="fixed"><link name="fixed">{_inertial(0.0, np.zeros(3))}{shape}</link></robot>')
        fixed.append((path, T))
    return fixed


def add_fixed(client: int, path: Path, object_model: ObjectModel, params: HandWorldParams) -> int:
    """Table or an obstacle, where its frame is the simulation's."""
    body = int(pybullet.loadURDF(str(path), useFixedBase=True, flags=_FLAGS, physicsClientId=client))
    # Bullet multiplies rolling and spinning friction, lengths, with the other body's sliding friction; MuJoCo takes the contact's.
    rolls_m = params.rolling_friction_m if object_model.symmetry is not Symmetry.BOX else 0.0
    scaled = object_model.friction * params.friction_scale
    _set_surface(client, body, -1, params.table_friction, _SPIN_M / scaled if rolls_m else 0.0, rolls_m / scaled)
    _set_yield(client, body, -1, yield_of((0.0042, 1.0), 0.9, 1.0 / object_model.mass_kg))
    return body


def add_object(client: int, path: Path, object_model: ObjectModel, params: HandWorldParams) -> int:
    """The object, a free rigid body that nothing damps."""
    body = int(pybullet.loadURDF(str(path), useMaximalCoordinates=True, flags=_FLAGS, physicsClientId=client))
    _set_surface(client, body, -1, object_model.friction * params.friction_scale, 0.0, 0.0)
    pybullet.changeDynamics(body, -1, linearDamping=0.0, angularDamping=0.0, physicsClientId=client)
    return body


def add_hand(client: int, path: Path, object_model: ObjectModel, params: HandWorldParams) -> HandIds:
    """The hand with its fingers coupled by a belt and no motor but the forces that it is given each step."""
    body = int(pybullet.loadURDF(str(path), useFixedBase=True, flags=_FLAGS, physicsClientId=client))
    infos = [pybullet.getJointInfo(body, k, physicsClientId=client) for k in range(pybullet.getNumJoints(body, physicsClientId=client))]
    links = {info[12].decode(): int(info[0]) for info in infos}
    hand = HandIds(
        body, (links["hand_x"], links["hand_y"], links["panda_hand"]), (links[FINGERS[0]], links[FINGERS[1]]), {n: links[n] for n in HAND_PARTS}
    )
    for name, link in links.items():
        # The pad and the bare finger are one link and Bullet knows one friction a link: the bare sides are as the pads are.
        _set_surface(client, body, link, params.pad_friction if name in FINGERS else params.table_friction, 0.0, 0.0)
        pybullet.changeDynamics(body, link, linearDamping=0.0, angularDamping=0.0, jointDamping=0.0, physicsClientId=client)
        finger_1_kg = 1.0 / (3.0 * params.finger_mass_kg) if name in FINGERS else 0.0
        stiffness_n_m, damping = yield_of((0.0021, 1.0), 0.98, 1.0 / object_model.mass_kg + finger_1_kg)
        _set_yield(client, body, link, (stiffness_n_m, 0.1 * damping))
    pybullet.setJointMotorControlArray(body, hand.joints, pybullet.VELOCITY_CONTROL, forces=[0.0] * 5, physicsClientId=client)
    belt = pybullet.createConstraint(body, hand.fingers[0], body, hand.fingers[1], pybullet.JOINT_GEAR, [0, 1, 0], [0] * 3, [0] * 3, physicsClientId=client)  # fmt: skip
    pybullet.changeConstraint(belt, gearRatio=-1, erp=0.2, maxForce=1e3, physicsClientId=client)
    return hand


def yield_of(solref: tuple[float, float], d: float, inverse_mass_1_kg: float) -> tuple[float, float]:
    """Stiffness and damping of a MuJoCo contact in newton, metres and seconds: its reference spring over its regularisation."""
    time_s, ratio = solref
    R = (1.0 - d) / d * inverse_mass_1_kg
    return 1.0 / (d * time_s * ratio) ** 2 / R, 2.0 / (d * time_s) / R


def _set_yield(client: int, body: int, link: int, stiffness_damping: tuple[float, float]) -> None:
    pybullet.changeDynamics(
        body, link, contactStiffness=stiffness_damping[0], contactDamping=stiffness_damping[1], physicsClientId=client
    )


def _set_surface(client: int, body: int, link: int, sliding: float, spinning_m: float, rolling_m: float) -> None:
    pybullet.changeDynamics(
        body,
        link,
        lateralFriction=sliding,
        spinningFriction=spinning_m,
        rollingFriction=rolling_m,
        restitution=0.0,
        physicsClientId=client,
    )


def _principal(inertia_kg_m2: Float[np.ndarray, "3 3"]) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """Principal moments and axes, these as near to the frame's as can be: a box then stays as it is, and no angle of it is 90 degrees."""
    moments, axes = np.linalg.eigh(inertia_kg_m2)
    _, order = linear_sum_assignment(-np.abs(axes))
    moments, axes = moments[order], axes[:, order]
    axes = axes * np.sign(np.diag(axes))
    # Three axes that each lean the right way may still be mirrored where none is near to the frame's.
    return moments, axes * np.array([1.0, 1.0, np.sign(np.linalg.det(axes))])


def _inertial(mass_kg: float, moments: Float[np.ndarray, "3"]) -> str:
    x, y, z = (repr(float(value)) for value in moments)
    return f'<inertial><mass value="{mass_kg!r}"/><inertia ixx="{x}" iyy="{y}" izz="{z}" ixy="0" ixz="0" iyz="0"/></inertial>'


def _slide(parent: str, child: str, at_m: Float[np.ndarray, "3"], axis: Float[np.ndarray, "3"], range_m: tuple[float, float]) -> str:
    return (
        f'<joint name="{child} slide" type="prismatic"><parent link="{parent}"/><child link="{child}"/><origin xyz="{_text(at_m)}"/>'
        f'<axis xyz="{_text(axis)}"/><limit lower="{range_m[0]}" upper="{range_m[1]}" effort="1e6" velocity="1e3"/></joint>'
    )


def _collision(geometry: str, T_link_shape: Float[np.ndarray, "4 4"]) -> str:
    rpy = Rotation.from_matrix(T_link_shape[:3, :3]).as_euler("xyz")
    return f'<collision><origin xyz="{_text(T_link_shape[:3, 3])}" rpy="{_text(rpy)}"/><geometry>{geometry}</geometry></collision>'


def _hull(folder: Path, name: str, vertices_m: Float[np.ndarray, "v 3"]) -> str:
    mesh = hull_mesh(vertices_m)
    lines = [f"o {name}", *(f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices_m.tolist())]
    lines += [f"f {a} {b} {c}" for a, b, c in (mesh.faces + 1).tolist()]
    (folder / f"{name}.obj").write_text("\n".join(lines) + "\n")
    return _collision(f'<mesh filename="{name}.obj"/>', np.eye(4))


def _text(values: Sequence[float] | Float[np.ndarray, "..."]) -> str:
    return " ".join(repr(float(value)) for value in values)


__all__ = ["HandIds", "add_fixed", "add_hand", "add_object", "carried_kg", "pose_of", "write_fixed", "write_hand", "write_object"]
