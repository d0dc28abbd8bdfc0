"""Signed distances between the bodies of one scene by the collision engine of pybullet; the caller says which may overlap.

Nothing is shared with engines/planning: pybullet computes the kinematics from its own URDF and makes the hulls of the links from their
meshes, Bullet measures distances by its GJK. Common are only the inputs: catalogue geometry, the scene and the finger boxes of the
benchmark (the hull of the finger mesh in the URDF sticks out of them by up to 3.6 mm).
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
import pybullet_data
import trimesh
from jaxtyping import Bool, Float, Int

from objects.gripper import FINGER_BOXES, FINGER_FROM_HAND_M, TCP_FROM_HAND_M
from objects.object_model import ObjectModel
from pipelines.engines.bullet import pybullet
from pipelines.proofs.audit.errors import AuditError
from pipelines.values import Scene
from tables.poses import matrix_of, pose_of

# Distances from here on are not told apart.
FAR_M = 0.005
# Bullet adds a ball of this radius to every hull and triangle, and nothing turns it off; it is taken out of every distance again, which
# is exact (tested). Boxes are given as hulls too: Bullet's own box primitive rounds its edges instead.
_PADDING_M = 0.001

LINKS = tuple(f"link{k}" for k in range(8))
FINGERS = ("left_pad", "left_body", "right_pad", "right_body")
ROBOT = (*LINKS, "hand", *FINGERS)
_HAND = 8  # pybullet's number of the hand in the URDF; links 1 to 7 are 0 to 6
_TABLE_M = (4.0, 4.0, 1.0)

# Poses of bodies by name, one a configuration, or one for all.
Placements = Mapping[str, Float[np.ndarray, "n 4 4"]]


@dataclass(frozen=True, slots=True)
class Pair:
    """Two bodies and how far apart they have to be; a negative distance allows that much overlap."""

    a: str
    b: str
    required_m: float = 0.0


@dataclass(frozen=True, slots=True)
class Nearest:
    """The pair with the least room: its distance less what is required, at most FAR_M less that; negative is a collision."""

    room_m: float
    pair: Pair | None
    index: int | None


@dataclass(frozen=True, slots=True)
class _Piece:
    """A convex body in the client, with its bounds in the frame of the body it belongs to, and the mesh that it is the hull of."""

    body: str
    number: int
    centre_m: Float[np.ndarray, "3"]
    half_m: Float[np.ndarray, "3"]
    mesh_number: int | None


class BulletScene:
    """Context manager around one DIRECT client that holds arm, hand, object, table and obstacles as bodies that are put into place.

    Args:
        exact: the object and link6 as the triangle meshes they are instead of their convex parts and hull. A triangle mesh is hollow:
            what is wholly inside is in no collision.
    """

    def __init__(self, scene: Scene, object_model: ObjectModel, *, exact: bool = False) -> None:
        self.scene, self.object_model, self.exact = scene, object_model, exact
        self.obstacles = tuple(f"obstacle {obstacle.obstacle_id}" for obstacle in scene.obstacles)
        self.surroundings = ("table", *self.obstacles)
        self.n_checked = 0
        self._client = -1
        self._pieces: dict[str, list[_Piece]] = {}
        self._at: dict[int, list[float]] = {}

    def __enter__(self) -> Self:
        self._client = pybullet.connect(pybullet.DIRECT)
        if self._client < 0:
            raise AuditError(f"{self.scene.scene_id}: PyBullet gave no client")
        urdf = Path(pybullet_data.getDataPath()) / "franka_panda" / "panda.urdf"
        flags = pybullet.URDF_IGNORE_VISUAL_SHAPES | pybullet.URDF_IGNORE_COLLISION_SHAPES
        self._arm = pybullet.loadURDF(str(urdf), useFixedBase=True, flags=flags, physicsClientId=self._client)
        for name in (*LINKS, "hand"):
            vertices_m, faces = _link_mesh(name)
            # The other links' meshes are their hulls within 0.03 % of volume.
            self._add(name, vertices_m, faces if self.exact and name == "link6" else None)
        for side, sign in (("left", 1.0), ("right", -1.0)):
            for part, (centre, size) in zip(("pad", "body"), FINGER_BOXES, strict=True):
                self._add(f"{side}_{part}", _corners(size) + np.array(centre) * (1.0, sign, 1.0))
        if self.exact and len(self.object_model.parts) > 1:
            self._add("object", self.object_model.mesh.vertices_m, self.object_model.mesh.faces)
        else:
            for convex in self.object_model.parts:
                self._add("object", convex.vertices_m)
        self._fixed = {"table": np.eye(4)[None], "link0": np.eye(4)[None]}
        self._add("table", _corners(_TABLE_M) - (0.0, 0.0, _TABLE_M[2] / 2))
        for name, obstacle in zip(self.obstacles, self.scene.obstacles, strict=True):
            self._add(name, _corners(obstacle.size_m))
            self._fixed[name] = obstacle.T_base_obstacle[None]
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        pybullet.disconnect(physicsClientId=self._client)
        self._client = -1

    def link_poses(self, q: Float[np.ndarray, "n 7"]) -> Float[np.ndarray, "n 8 4 4"]:
        """T_base_link of links 1 to 7 and the hand, by pybullet."""
        poses = np.empty((len(q), 8, 7))
        numbers = [*range(7), _HAND]
        for k, values in enumerate(np.asarray(q, dtype=np.float64)[:, :, None].tolist()):
            pybullet.resetJointStatesMultiDof(self._arm, list(range(7)), values, physicsClientId=self._client)
            states = pybullet.getLinkStates(self._arm, numbers, computeForwardKinematics=True, physicsClientId=self._client)
            poses[k] = [(*state[4], *state[5]) for state in states]
        return matrix_of(poses)

    def arm(self, q: Float[np.ndarray, "n 7"], fingers_m: Float[np.ndarray, "2"]) -> dict[str, Float[np.ndarray, "n 4 4"]]:
        """Placements of arm, hand and fingers, and of the `tcp`."""
        T = self.link_poses(q)
        T_hand_tcp = np.eye(4)
        T_hand_tcp[2, 3] = TCP_FROM_HAND_M
        links = {name: T[:, k] for k, name in enumerate(LINKS[1:])}
        return {**links, **hand(T[:, 7] @ T_hand_tcp, fingers_m)}

    def nearest(self, placements: Placements, pairs: Sequence[Pair], stop_below_m: float = -np.inf) -> Nearest:
        """The pair with the least room over all configurations; with `stop_below_m`, the first one found with less room than that.

        Bodies whose bounds are apart by more than FAR_M are not asked; a pair that never comes nearer is no result. Where meshes are
        exact, room that is not negative may be that of their hulls, a lower bound.
        """
        placed = {**self._fixed, **placements}
        n = max(len(T) for T in placements.values())
        self.n_checked += n
        poses = {name: pose_of(T) for name, T in placed.items() if name in self._pieces}
        asked = [(pair, a, b) for pair in pairs for a, b in itertools.product(self._pieces[pair.a], self._pieces[pair.b])]
        near = _near([(a, b) for _, a, b in asked], placed, n)
        best = Nearest(np.inf, None, None)
        for k in np.flatnonzero(near.any(axis=0)).tolist():
            for number in np.flatnonzero(near[:, k]).tolist():
                pair, a, b = asked[number]
                room_m = self._room_m(pair, a, b, poses, k)
                if room_m < best.room_m:
                    best = Nearest(room_m, pair, k)
                    if room_m < stop_below_m:
                        return best
        return best

    def is_free(self, placements: Placements, pairs: Sequence[Pair]) -> bool:
        """Whether every pair has its room in every configuration."""
        return self.nearest(placements, pairs, stop_below_m=0.0).room_m >= 0.0

    def _room_m(self, pair: Pair, a: _Piece, b: _Piece, poses: Mapping[str, Float[np.ndarray, "n 7"]], k: int) -> float:
        pose_a, pose_b = (poses[piece.body][k if len(poses[piece.body]) > 1 else 0].tolist() for piece in (a, b))
        room_m = self._distance_m(a.number, pose_a, b.number, pose_b) - pair.required_m
        for exact, convex, (pose, other) in ((a, b, (pose_a, pose_b)), (b, a, (pose_b, pose_a))):
            # Bullet tests triangles against convex bodies only; of two meshes each is tested against the hull of the other.
            if room_m < 0.0 and exact.mesh_number is not None:
                room_m = self._distance_m(exact.mesh_number, pose, convex.number, other) - pair.required_m
        return room_m

    def _distance_m(self, a: int, pose_a: list[float], b: int, pose_b: list[float]) -> float:
        for number, pose in ((a, pose_a), (b, pose_b)):
            if self._at.get(number) != pose:
                pybullet.resetBasePositionAndOrientation(number, pose[:3], pose[3:], physicsClientId=self._client)
                self._at[number] = pose
        points = pybullet.getClosestPoints(a, b, FAR_M, physicsClientId=self._client)
        return min(min((point[8] for point in points), default=FAR_M) + 2 * _PADDING_M, FAR_M)

    def _add(self, body: str, vertices_m: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"] | None = None) -> None:
        low, high = vertices_m.min(axis=0), vertices_m.max(axis=0)
        mesh_number = None if faces is None else self._create(vertices=vertices_m.tolist(), indices=faces.ravel().tolist())
        # Without triangles Bullet takes the hull.
        piece = _Piece(body, self._create(vertices=vertices_m.tolist()), (low + high) / 2, (high - low) / 2, mesh_number)
        self._pieces.setdefault(body, []).append(piece)

    def _create(self, **mesh: object) -> int:
        shape = pybullet.createCollisionShape(pybullet.GEOM_MESH, physicsClientId=self._client, **mesh)
        return int(pybullet.createMultiBody(0.0, shape, physicsClientId=self._client))


def hand(T_base_tcp: Float[np.ndarray, "n 4 4"], fingers_m: Float[np.ndarray, "2"]) -> dict[str, Float[np.ndarray, "n 4 4"]]:
    """Placements of hand and fingers, and of the `tcp`, without an arm.

    Args:
        fingers_m: opening of the left and the right finger.
    """
    T_tcp_hand = np.eye(4)
    T_tcp_hand[2, 3] = -TCP_FROM_HAND_M
    T_base_hand = T_base_tcp @ T_tcp_hand
    placed = {"tcp": T_base_tcp, "hand": T_base_hand}
    for side, sign, opening_m in (("left", 1.0, fingers_m[0]), ("right", -1.0, fingers_m[1])):
        T_hand_finger = np.eye(4)
        T_hand_finger[:3, 3] = (0.0, sign * opening_m, FINGER_FROM_HAND_M)
        placed |= {f"{side}_{part}": T_base_hand @ T_hand_finger for part in ("pad", "body")}
    return placed


def _near(pairs: Sequence[tuple[_Piece, _Piece]], placed: Placements, n: int) -> Bool[np.ndarray, "p n"]:
    """Where the axis-aligned boxes around two pieces, in the base frame, are within FAR_M: all that can be nearer than that."""
    pieces = {piece.number: piece for pair in pairs for piece in pair}
    rows = {number: row for row, number in enumerate(pieces)}
    centre_m, half_m = np.empty((2, len(pieces), n, 3))
    for row, piece in enumerate(pieces.values()):
        T = placed[piece.body]
        centre_m[row] = T[:, :3, :3] @ piece.centre_m + T[:, :3, 3]
        half_m[row] = np.abs(T[:, :3, :3]) @ piece.half_m
    a, b = (np.array([rows[pair[side].number] for pair in pairs], dtype=np.int64) for side in (0, 1))
    is_near: Bool[np.ndarray, "p n"] = (np.abs(centre_m[a] - centre_m[b]) - half_m[a] - half_m[b]).max(axis=-1) < FAR_M
    return is_near


@lru_cache(maxsize=16)
def _link_mesh(name: str) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """Collision mesh of a link in pybullet_data, link frame, metres."""
    mesh = trimesh.load_mesh(Path(pybullet_data.getDataPath()) / "franka_panda" / "meshes" / "collision" / f"{name}.obj")
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def _corners(size_m: Sequence[float] | Float[np.ndarray, "3"]) -> Float[np.ndarray, "8 3"]:
    """Corners of a box about its centre."""
    corners_m: Float[np.ndarray, "8 3"] = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * np.asarray(size_m)
    return corners_m
