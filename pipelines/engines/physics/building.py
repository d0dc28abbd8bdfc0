"""Puts table, boxes, object and Panda into a PyBullet client, with the materials and motors of the recipe; see world.py for the world."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pybullet
from jaxtyping import Float

from pipelines.engines.physics.bodies import ObjectBody
from pipelines.engines.physics.params import PhysicsParams
from tables.poses import pose_of


@dataclass(frozen=True, slots=True)
class RobotIds:
    """The numbers by which a client knows the robot: its body, its arm and finger joints in order, its links by name."""

    body: int
    arm: tuple[int, ...]
    fingers: tuple[int, int]
    links: dict[str, int]

    @property
    def joints(self) -> tuple[int, ...]:
        """Arm joints, then finger joints."""
        return (*self.arm, *self.fingers)


def add_table(client: int, params: PhysicsParams) -> int:
    """The table, top at z = 0; the links near the robot's base do not collide, so it may lie under them."""
    (x0, x1), (y0, y1), thickness = params.table_x_m, params.table_y_m, params.table_thickness_m
    T = np.eye(4)
    T[:3, 3] = (x0 + x1) / 2, (y0 + y1) / 2, -thickness / 2
    table = add_box(client, params, np.array([x1 - x0, y1 - y0, thickness]) / 2, T)
    pybullet.changeDynamics(table, -1, rollingFriction=params.rolling_friction, physicsClientId=client)
    return table


def add_box(client: int, params: PhysicsParams, half_extents_m: Float[np.ndarray, "3"], T_base_box: Float[np.ndarray, "4 4"]) -> int:
    """A box that never moves."""
    pose = pose_of(T_base_box)
    shape = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=half_extents_m.tolist(), physicsClientId=client)
    position, quaternion = pose[:3].tolist(), pose[3:].tolist()
    body = int(pybullet.createMultiBody(0.0, shape, basePosition=position, baseOrientation=quaternion, physicsClientId=client))
    pybullet.changeDynamics(
        body,
        -1,
        lateralFriction=params.table_friction,
        spinningFriction=params.spinning_friction,
        restitution=0.0,
        physicsClientId=client,
    )
    return body


def add_object(client: int, body: ObjectBody, mass_kg: float, friction: float, hulls_obj: str) -> int:
    """The object at the origin.

    Args:
        hulls_obj: file with the text of `body.hulls_obj`.
    """
    parts: list[tuple[int, list[float], str, list[float]]] = [
        (pybullet.GEOM_BOX, box.half_extents_m.tolist(), "", box.centre_m.tolist()) for box in body.boxes
    ]
    if body.hulls_obj:
        parts.append((pybullet.GEOM_MESH, [1.0] * 3, hulls_obj, [0.0] * 3))
    names = ("shapeTypes", "halfExtents", "fileNames", "collisionFramePositions")
    columns: dict[str, list[Any]] = {name: [part[k] for part in parts] for k, name in enumerate(names)}
    number = int(
        pybullet.createMultiBody(
            mass_kg,
            pybullet.createCollisionShapeArray(**columns, physicsClientId=client),
            baseInertialFramePosition=body.mass_pose[:3].tolist(),
            baseInertialFrameOrientation=body.mass_pose[3:].tolist(),
            # A plain rigid body is cheaper than a multibody without joints.
            useMaximalCoordinates=True,
            physicsClientId=client,
        )
    )
    pybullet.changeDynamics(
        number,
        -1,
        # Bullet takes a rigid body's mass for 0 where only its inertia is given.
        mass=mass_kg,
        localInertiaDiagonal=body.principal_inertia_kg_m2.tolist(),
        lateralFriction=friction,
        spinningFriction=0.0,
        rollingFriction=0.0,
        restitution=0.0,
        physicsClientId=client,
    )
    return number


def add_robot(client: int, params: PhysicsParams, arm_urdf: str) -> RobotIds:
    """The Panda at the origin, its fingers coupled."""
    flags = pybullet.URDF_USE_INERTIA_FROM_FILE
    body = int(pybullet.loadURDF(arm_urdf, useFixedBase=True, flags=flags, physicsClientId=client))
    infos = [pybullet.getJointInfo(body, k, physicsClientId=client) for k in range(pybullet.getNumJoints(body, physicsClientId=client))]
    joints = {info[1].decode(): k for k, info in enumerate(infos)}
    left, right = (joints[f"panda_finger_joint{k}"] for k in (1, 2))
    for link in (left, right, joints["panda_hand_joint"]):
        pybullet.changeDynamics(
            body,
            link,
            lateralFriction=params.finger_friction,
            spinningFriction=params.spinning_friction,
            restitution=0.0,
            # Without it a held object creeps, some micrometres a step: friction alone stops speeds, an anchor remembers the place. It
            # gives way where Coulomb's bound is reached.
            frictionAnchor=1,
            physicsClientId=client,
        )
    gear = pybullet.createConstraint(body, left, body, right, pybullet.JOINT_GEAR, [0, 1, 0], [0] * 3, [0] * 3, physicsClientId=client)
    pybullet.changeConstraint(gear, gearRatio=-1, erp=params.gear_erp, maxForce=params.gear_force_n, physicsClientId=client)
    arm = tuple(joints[f"panda_joint{k}"] for k in range(1, 8))
    return RobotIds(body, arm, (left, right), {info[12].decode(): k for k, info in enumerate(infos)})
