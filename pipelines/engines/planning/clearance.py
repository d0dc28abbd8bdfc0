"""How close a carried path comes to table and obstacles; see collision.py for whether it collides."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import coal
import numpy as np
import pinocchio as pin
from jaxtyping import Float

from pipelines.engines.planning.bodies import transform_of
from pipelines.engines.planning.collision import LINKS_ON_TABLE, CollisionModel
from pipelines.engines.robot.geometry import LAST_LINK, lowest_m, moved, panda


def path_clearance_m(model: CollisionModel, path: Float[np.ndarray, "n 7"]) -> float:
    """Smallest distance of arm (from link2), hand, fingers or attached object to the table plane or an obstacle.

    Exact at the configurations given. Bounding spheres give a lower bound of every distance to an obstacle; distances are computed
    in the order of those bounds until none can be smaller than the smallest found.
    """
    T = model.T_link7_object
    parts = zip(model.object.parts, model.object.part_vertices_m, strict=True)
    bodies = (*_robot_bodies(), *(_body(LAST_LINK, T, part, moved(T, vertices)) for part, vertices in parts))
    T_base_joint = _placements(path, model.held_fingers_m)
    best = min(lowest_m(T_base_joint[body.joint], body.vertices_m) for body in bodies)
    if not model.surroundings.obstacles:
        return best
    centres = np.stack([T_base_joint[body.joint] @ body.centre_m for body in bodies])[..., :3]
    radii_m = np.array([body.radius_m for body in bodies])[:, None]
    for obstacle in model.surroundings.obstacles:
        bounds_m = obstacle.gap_m(centres) - radii_m
        for pick in np.argsort(bounds_m, axis=None, kind="stable"):
            k_body, k = divmod(int(pick), len(path))
            if bounds_m[k_body, k] >= best:
                break
            placement = transform_of(T_base_joint[bodies[k_body].joint, k] @ bodies[k_body].T_joint_shape)
            result = coal.DistanceResult()
            coal.distance(bodies[k_body].geometry, placement, obstacle.geometry, obstacle.placement, coal.DistanceRequest(), result)
            best = min(best, result.min_distance)
    return best


@dataclass(frozen=True, slots=True)
class _Body:
    """A convex shape fixed to a joint; vertices and bounding sphere in the joint frame."""

    joint: int
    T_joint_shape: Float[np.ndarray, "4 4"]
    geometry: coal.CollisionGeometry
    vertices_m: Float[np.ndarray, "v 3"]
    centre_m: Float[np.ndarray, "4"]
    radius_m: float


def _body(
    joint: int, T_joint_shape: Float[np.ndarray, "4 4"], geometry: coal.CollisionGeometry, vertices_m: Float[np.ndarray, "v 3"]
) -> _Body:
    centre = (vertices_m.min(axis=0) + vertices_m.max(axis=0)) / 2
    radius = float(np.linalg.norm(vertices_m - centre, axis=1).max())
    return _Body(joint, T_joint_shape, geometry, vertices_m, np.append(centre, 1.0), radius)


@lru_cache(maxsize=1)
def _robot_bodies() -> tuple[_Body, ...]:
    return tuple(_body(s.joint, s.T_joint_shape, s.geometry, s.vertices_m) for s in panda().shapes if s.name not in LINKS_ON_TABLE)


def _placements(path: Float[np.ndarray, "n 7"], fingers_m: Float[np.ndarray, "2"]) -> Float[np.ndarray, "j n 4 4"]:
    """T_base_joint of every joint at every configuration."""
    model = panda().model
    data = model.createData()
    T = np.empty((model.njoints, len(path), 4, 4))
    q = np.concatenate([np.zeros(7), fingers_m])
    for k, arm_q in enumerate(path):
        q[:7] = arm_q
        pin.forwardKinematics(model, data, q)
        for joint in range(1, model.njoints):
            T[joint, k] = data.oMi[joint].homogeneous
    return T
