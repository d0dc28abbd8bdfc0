"""The slow twin of pipelines.engines.planning.collision: signed distances by pybullet's getClosestPoints, every pair, nothing cached."""

from __future__ import annotations

from types import TracebackType

import numpy as np
import pybullet
import pybullet_data
from jaxtyping import Float
from pybullet_utils.bullet_client import BulletClient

from objects.gripper import FINGER_BOXES
from objects.object_model import ObjectModel
from pipelines.engines.planning.bodies import CLEARANCE_M
from pipelines.engines.planning.collision import HELD_TOLERANCE_M, LINKS_BY_OBJECT, LINKS_ON_TABLE, SELF_COLLISION_PAIRS
from pipelines.values import Scene
from tables.poses import matrix_of, pose_of

FAR_M = 0.5
_HAND = 8


class BulletReference:
    """A scene in pybullet whose bodies are teleported; `with` closes the client."""

    def __init__(self, scene: Scene, object_model: ObjectModel) -> None:
        self.client = BulletClient(pybullet.DIRECT)
        self.robot = self.client.loadURDF(f"{pybullet_data.getDataPath()}/franka_panda/panda.urdf", useFixedBase=True)
        self.names = {f"link{k}": k - 1 for k in range(8)} | {"hand": _HAND}
        self.fingers = {
            f"{side}_finger_{part}": (sign, box, self._body(pybullet.GEOM_BOX, halfExtents=[edge / 2 for edge in box[1]]))
            for side, sign in (("left", 1.0), ("right", -1.0))
            for part, box in zip(("pad", "body"), FINGER_BOXES, strict=True)
        }
        self.table = self._body(pybullet.GEOM_BOX, halfExtents=[2.0, 2.0, 0.5])
        self._put(self.table, matrix_of(np.array([0.0, 0.0, -0.5, 0, 0, 0, 1])))
        self.obstacles = [self._body(pybullet.GEOM_BOX, halfExtents=(o.size_m / 2).tolist()) for o in scene.obstacles]
        for body, obstacle in zip(self.obstacles, scene.obstacles, strict=True):
            self._put(body, obstacle.T_base_obstacle)
        self.parts = [self._body(pybullet.GEOM_MESH, vertices=part.vertices_m.tolist()) for part in object_model.parts]

    def __enter__(self) -> BulletReference:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.client.disconnect()

    def carrying_m(self, q: Float[np.ndarray, "7"], fingers_m: Float[np.ndarray, "2"], T_tcp_object: Float[np.ndarray, "4 4"]) -> float:
        """Smallest signed distance of the pairs that `in_collision_holding` tests, each less its margin: negative is a collision."""
        T_base_tcp = self._move(q, fingers_m)
        partners = [(body, -1, CLEARANCE_M) for body in (self.table, *self.obstacles)]
        partners += [(*self._link(name), 0.0) for name in LINKS_BY_OBJECT]
        return min(self._robot_m(), self._object_m(T_base_tcp @ T_tcp_object, partners))

    def open_m(self, q: Float[np.ndarray, "7"], jaw_m: float, T_base_object: Float[np.ndarray, "4 4"]) -> float:
        """Smallest signed distance of the pairs that `in_collision_open` tests, each less its margin: negative is a collision."""
        self._move(q, np.array([jaw_m / 2, jaw_m / 2]))
        partners = [(*self._link(name), -HELD_TOLERANCE_M) for name in (*self.names, *self.fingers) if name not in LINKS_ON_TABLE]
        return min(self._robot_m(), self._object_m(T_base_object, partners))

    def _move(self, q: Float[np.ndarray, "7"], fingers_m: Float[np.ndarray, "2"]) -> Float[np.ndarray, "4 4"]:
        for joint in range(7):
            self.client.resetJointState(self.robot, joint, float(q[joint]))
        state = self.client.getLinkState(self.robot, _HAND, computeForwardKinematics=True)
        T_base_hand = matrix_of(np.array([*state[4], *state[5]]))
        for sign, ((x, y, z), _), body in self.fingers.values():
            T_hand_box = np.eye(4)
            T_hand_box[:3, 3] = (x, sign * (y + fingers_m[0 if sign > 0 else 1]), z + 0.0584)
            self._put(body, T_base_hand @ T_hand_box)
        T_hand_tcp = np.eye(4)
        T_hand_tcp[2, 3] = 0.1034
        return T_base_hand @ T_hand_tcp

    def _robot_m(self) -> float:
        distances = [self._distance_m(self._link(a), self._link(b)) for a, b in SELF_COLLISION_PAIRS]
        moving = [self._link(name) for name in (*self.names, *self.fingers) if name not in LINKS_ON_TABLE]
        distances += [self._distance_m(link, (self.table, -1)) - CLEARANCE_M for link in moving]
        by_obstacles = [self._link("link1"), *moving]
        distances += [self._distance_m(link, (body, -1)) - CLEARANCE_M for link in by_obstacles for body in self.obstacles]
        return min(distances)

    def _object_m(self, T_base_object: Float[np.ndarray, "4 4"], partners: list[tuple[int, int, float]]) -> float:
        for part in self.parts:
            self._put(part, T_base_object)
        return min(self._distance_m((body, link), (part, -1)) - margin_m for body, link, margin_m in partners for part in self.parts)

    def _link(self, name: str) -> tuple[int, int]:
        return (self.fingers[name][2], -1) if name in self.fingers else (self.robot, self.names[name])

    def _distance_m(self, a: tuple[int, int], b: tuple[int, int]) -> float:
        points = self.client.getClosestPoints(a[0], b[0], FAR_M, a[1], b[1])
        return min((point[8] for point in points), default=FAR_M)

    def _body(self, kind: int, **shape: object) -> int:
        return self.client.createMultiBody(0.0, self.client.createCollisionShape(kind, **shape))

    def _put(self, body: int, T: Float[np.ndarray, "4 4"]) -> None:
        pose = pose_of(T)
        self.client.resetBasePositionAndOrientation(body, pose[:3].tolist(), pose[3:].tolist())
