"""Puts table, boxes and object into a PyBullet client, with the materials of the recipe; see world.py for the world."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

from pipelines.engines.bullet import pybullet
from pipelines.engines.physics.bodies import ObjectBody
from pipelines.engines.physics.params import PhysicsParams
from tables.poses import pose_of


def add_table(client: int, params: PhysicsParams) -> int:
    """The table, top at z = 0."""
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
