"""What tests measure in a physics world that no stage asks for: penetration and speed, by pybullet's own calls."""

from __future__ import annotations

import numpy as np
import pybullet

from pipelines.engines.physics.world import PhysicsWorld


def deepest_contact_m(world: PhysicsWorld, body: str, other: str) -> float:
    """Largest penetration between two bodies in the last step, in metres; 0 without contact."""
    points = pybullet.getContactPoints(bodyA=world._ids[body], bodyB=world._ids[other], physicsClientId=world._client) or ()
    return max((-point[8] for point in points), default=0.0)


def object_speed_m_s(world: PhysicsWorld) -> float:
    """Speed of the centre of mass of the object."""
    return float(np.linalg.norm(pybullet.getBaseVelocity(world._ids["object"], physicsClientId=world._client)[0]))
