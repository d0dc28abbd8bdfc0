"""What tests measure in a physics world that no stage asks for: contacts, penetration and speed, by pybullet's own calls."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pybullet

from pipelines.engines.physics.world import PhysicsWorld


def deepest_contact_m(world: PhysicsWorld, other: str) -> float:
    """Largest penetration of the object into a body in the last step, in metres; 0 without contact."""
    return max((-point[8] for point in _points(world, other)), default=0.0)


def n_contacts(world: PhysicsWorld, other: str) -> int:
    """Contact points between the object and a body in the last step."""
    return len(_points(world, other))


def object_speed_m_s(world: PhysicsWorld) -> float:
    """Speed of the centre of mass of the object."""
    return float(np.linalg.norm(pybullet.getBaseVelocity(world._ids["object"], physicsClientId=world._client)[0]))


def _points(world: PhysicsWorld, other: str) -> Sequence[Any]:
    return pybullet.getContactPoints(bodyA=world._ids["object"], bodyB=world._ids[other], physicsClientId=world._client) or ()
