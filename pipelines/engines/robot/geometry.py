"""Collision shapes of the Panda for pinocchio and coal, made once a process; see planning/collision.py for which of them may overlap.

Links and hand are convex hulls of the collision meshes in pybullet_data, fingers are the boxes of objects.gripper, so that grasp pool,
planning and physics close the same fingers.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import coal
import numpy as np
import pinocchio as pin
import trimesh
from jaxtyping import Float

from objects.gripper import FINGER_BOXES, TCP_FROM_HAND_M
from pipelines.engines.robot.description import collision_mesh, panda_urdf

N_LINKS = 8  # link0 (the base) to link7
LAST_LINK = 7


@dataclass(frozen=True, slots=True)
class Shape:
    """A convex body fixed to a joint of the kinematic model; vertices in the joint frame bound it exactly."""

    name: str
    joint: int
    T_joint_shape: Float[np.ndarray, "4 4"]
    geometry: coal.CollisionGeometry
    vertices_m: Float[np.ndarray, "v 3"]


@dataclass(frozen=True, slots=True)
class Panda:
    """Kinematic model (7 arm joints, then the left and right finger) and its shapes, arm first, then hand, then fingers."""

    model: pin.Model
    links: tuple[Shape, ...]
    hand: Shape
    fingers: tuple[Shape, ...]
    T_link7_tcp: Float[np.ndarray, "4 4"]
    T_link7_fingers: tuple[Float[np.ndarray, "4 4"], Float[np.ndarray, "4 4"]]

    def T_link7_finger(self, side: int, opening_m: float) -> Float[np.ndarray, "4 4"]:
        """Pose of a finger's joint frame (0 left, 1 right) at a joint position."""
        T = self.T_link7_fingers[side].copy()
        T[:3, 3] += (1.0 - 2.0 * side) * opening_m * T[:3, 1]
        return T

    @property
    def shapes(self) -> tuple[Shape, ...]:
        return (*self.links, self.hand, *self.fingers)


@lru_cache(maxsize=1)
def panda() -> Panda:
    """The robot of the URDF in pybullet_data."""
    model = pin.buildModelFromUrdf(str(panda_urdf()))
    T_link7_hand = model.frames[model.getFrameId("panda_hand")].placement.homogeneous
    links = tuple(_hull(f"link{k}", k, np.eye(4)) for k in range(N_LINKS))
    hand = _hull("hand", LAST_LINK, T_link7_hand)
    fingers = tuple(
        _finger_box(f"{side}_finger_{part}", model.getJointId(f"panda_finger_joint{number}"), sign, box)
        for number, side, sign in ((1, "left", 1.0), (2, "right", -1.0))
        for part, box in zip(("pad", "body"), FINGER_BOXES, strict=True)
    )
    T_hand_tcp = np.eye(4)
    T_hand_tcp[2, 3] = TCP_FROM_HAND_M
    T_link7_fingers = tuple(model.jointPlacements[model.getJointId(f"panda_finger_joint{k}")].homogeneous for k in (1, 2))
    return Panda(model, links, hand, fingers, T_link7_hand @ T_hand_tcp, T_link7_fingers)


def convex(vertices_m: Float[np.ndarray, "v 3"]) -> coal.CollisionGeometry:
    """Convex hull of points as a coal shape."""
    points = coal.StdVec_Vec3s()
    for vertex in vertices_m:
        points.append(vertex)
    return coal.Convex.convexHull(points, True, "Qt")


def convex_box(size_m: Float[np.ndarray, "3"]) -> coal.CollisionGeometry:
    """A box about its centre, as a hull: what coal.Box answers depends on the first query of the process (coal issue 894)."""
    return convex(box_corners(size_m))


def box_corners(size_m: Float[np.ndarray, "3"]) -> Float[np.ndarray, "8 3"]:
    """Corners of a box about its centre."""
    signs = np.array(np.meshgrid([-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0])).reshape(3, -1).T
    corners_m: Float[np.ndarray, "8 3"] = signs * np.asarray(size_m) / 2
    return corners_m


def moved(T: Float[np.ndarray, "*t 4 4"], points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "*t n 3"]:
    """Points of frame b in frame a, for T_a_b."""
    # einsum, not @: BLAS adds in another order when it has another number of threads, and labels must not.
    in_a: Float[np.ndarray, "*t n 3"] = np.einsum("...ij,nj->...ni", T[..., :3, :3], points) + T[..., None, :3, 3]
    return in_a


def lowest_m(T: Float[np.ndarray, "*t 4 4"], points: Float[np.ndarray, "n 3"]) -> float:
    """Smallest z of points of frame b in frame a, over all T_a_b."""
    return float((np.einsum("...j,nj->...n", T[..., 2, :3], points) + T[..., 2, 3:]).min())


def _hull(name: str, joint: int, T_joint_shape: Float[np.ndarray, "4 4"]) -> Shape:
    mesh = trimesh.load_mesh(collision_mesh(name))
    vertices = np.asarray(mesh.convex_hull.vertices)
    return Shape(name, joint, T_joint_shape, convex(vertices), moved(T_joint_shape, vertices))


def _finger_box(name: str, joint: int, sign: float, box: tuple[tuple[float, ...], tuple[float, ...]]) -> Shape:
    (x, y, z), size = box
    T = np.eye(4)
    T[:3, 3] = (x, sign * y, z)
    return Shape(name, joint, T, convex_box(np.array(size)), moved(T, box_corners(np.array(size))))
