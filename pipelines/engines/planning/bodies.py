"""Rigid bodies without an arm: the hand, the object, and the table and obstacles around them; see collision.py for the arm."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import coal
import numpy as np
from jaxtyping import Float

from objects.object_model import ObjectModel
from pipelines.engines.robot.geometry import convex, convex_box, lowest_m, moved, panda
from pipelines.values import Scene
from tables.poses import inverse

# Arm, hand and a carried object keep this far from table and obstacles: the arm follows its path within 1 mm, and the hulls of physics are
# up to 1 mm thick. Plans that graze by a hair would be failures of the engines, not of the task.
CLEARANCE_M = 0.001


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A rigid union of convex parts in its own frame, with a bounding sphere. Equal only to itself, so that caches can hold it."""

    parts: tuple[coal.CollisionGeometry, ...]
    part_vertices_m: tuple[Float[np.ndarray, "v 3"], ...]
    vertices_m: Float[np.ndarray, "n 3"]
    centre_m: Float[np.ndarray, "3"]
    radius_m: float


@lru_cache(maxsize=4096)
def hand_body(jaw_m: float, sweep_m: float = 0.0) -> Body:
    """Palm (part 0) and finger boxes (left pad, left body, right pad, right body) in the TCP frame.

    Args:
        jaw_m: distance between the pads.
        sweep_m: the parts are swept this far back along the approach: the hull of a convex part at both ends of a straight line is
            the whole line, so one test stands for every step of it.
    """
    robot = panda()
    T_tcp_link7 = inverse(robot.T_link7_tcp)
    palm, palm_vertices = _palm(sweep_m)
    fingers = []
    for shape in robot.fingers:
        side = 0 if shape.name.startswith("left") else 1
        fingers.append(_swept(moved(T_tcp_link7 @ robot.T_link7_finger(side, jaw_m / 2), shape.vertices_m), sweep_m))
    return _body((palm, *map(convex, fingers)), (palm_vertices, *fingers))


@lru_cache(maxsize=16)
def _palm(sweep_m: float) -> tuple[coal.CollisionGeometry, Float[np.ndarray, "v 3"]]:
    """The same for every opening, and its hull costs five times those of the fingers."""
    robot = panda()
    vertices = _swept(moved(inverse(robot.T_link7_tcp), robot.hand.vertices_m), sweep_m)
    return convex(vertices), vertices


def _swept(vertices_m: Float[np.ndarray, "v 3"], sweep_m: float) -> Float[np.ndarray, "w 3"]:
    return np.concatenate([vertices_m, vertices_m - [0.0, 0.0, sweep_m]]) if sweep_m > 0.0 else vertices_m


def object_body(object_model: ObjectModel) -> Body:
    """Convex parts of an object in its frame; equal geometry gives the same body without building it again."""
    return _object_body(tuple(np.ascontiguousarray(part.vertices_m, dtype=np.float64).tobytes() for part in object_model.parts))


@lru_cache(maxsize=64)
def _object_body(blobs: tuple[bytes, ...]) -> Body:
    vertices = tuple(np.frombuffer(blob).reshape(-1, 3) for blob in blobs)
    return _body(tuple(map(convex, vertices)), vertices)


def _body(parts: tuple[coal.CollisionGeometry, ...], part_vertices_m: tuple[Float[np.ndarray, "v 3"], ...]) -> Body:
    vertices = np.concatenate(part_vertices_m)
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    radius = float(np.linalg.norm(vertices - centre, axis=1).max())
    return Body(parts, part_vertices_m, vertices, centre, radius)


class Box:
    """An obstacle in the base frame."""

    def __init__(self, T_base_box: Float[np.ndarray, "4 4"], size_m: Float[np.ndarray, "3"]) -> None:
        self.T_base_box = T_base_box
        self.half_m = np.asarray(size_m) / 2
        self.geometry = convex_box(size_m)
        self.placement = transform_of(T_base_box)

    def gap_m(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n"]:
        """Distance of points from the box; 0 inside."""
        local = np.einsum("...i,ij->...j", points - self.T_base_box[:3, 3], self.T_base_box[:3, :3])
        outside = np.maximum(np.abs(local) - self.half_m, 0.0)
        gap_m: Float[np.ndarray, "*n"] = np.sqrt((outside * outside).sum(axis=-1))
        return gap_m


class Surroundings:
    """Table and obstacles of a scene."""

    def __init__(self, scene: Scene) -> None:
        self.obstacles = tuple(Box(o.T_base_obstacle, o.size_m) for o in scene.obstacles)

    def in_collision(self, body: Body, T_base_body: Float[np.ndarray, "4 4"], table_clearance_m: float = CLEARANCE_M) -> bool:
        """Whether a body in a pose is lower above the table than a clearance, or nearer to an obstacle than CLEARANCE_M."""
        if lowest_m(T_base_body, body.vertices_m) < table_clearance_m:
            return True
        if not self.obstacles:
            return False
        centre = T_base_body[:3, :3] @ body.centre_m + T_base_body[:3, 3]
        near = [obstacle for obstacle in self.obstacles if obstacle.gap_m(centre) <= body.radius_m + CLEARANCE_M]
        placement = transform_of(T_base_body)
        return any(_meet(part, placement, obstacle.geometry, obstacle.placement, CLEARANCE_M) for obstacle in near for part in body.parts)


def bodies_meet(
    parts: tuple[coal.CollisionGeometry, ...], others: tuple[coal.CollisionGeometry, ...], T_a_b: Float[np.ndarray, "4 4"], margin_m: float
) -> bool:
    """Whether parts (in frame a) and others (in frame b) come closer than a margin; a negative one tolerates that much overlap."""
    at_origin, placement = coal.Transform3s(), transform_of(T_a_b)
    return any(_meet(part, at_origin, other, placement, margin_m) for part in parts for other in others)


def transform_of(T: Float[np.ndarray, "4 4"]) -> coal.Transform3s:
    return coal.Transform3s(T[:3, :3], T[:3, 3])


def _meet(a: coal.CollisionGeometry, T_a: coal.Transform3s, b: coal.CollisionGeometry, T_b: coal.Transform3s, margin_m: float) -> bool:
    request = coal.CollisionRequest()
    request.security_margin = margin_m
    return bool(coal.collide(a, T_a, b, T_b, request, coal.CollisionResult()))
