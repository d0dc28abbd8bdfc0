"""Where hand and object are in Bullet, in which frame, and how the state changes frames; ticks are bullet_world.py's.

Frames are HandWorld's: the hand's own while it turns, one at rest in which the hand slides while it only translates, the base frame once
the hand has left. One simulation serves all three: the frame in which the hand rests is the hand's frame.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from objects.object_model import ObjectModel
from pipelines.engines.bullet import pybullet
from pipelines.engines.physics.hand_bodies import fixed_bodies
from pipelines.engines.physics.hand_model import Carrier, build_model
from pipelines.engines.physics.hand_motion import cross
from pipelines.engines.physics.hand_params import HandWorldParams
from pipelines.proofs.validity.second_engine import bullet_bodies
from pipelines.proofs.validity.second_engine.contact_law import contact_law
from pipelines.values import Obstacle
from tables.poses import inverse, matrix_of, pose_of

# Friction is solved by iterations that start from nothing in every step: with 200 a held can creeps 0.1 degrees in two seconds of
# transport at 1/1920 s, with 300 at 1/960 s two degrees.
ITERATIONS = 200
# Share of an overlap that a step takes back where a contact has no yield of its own.
_ERP = 0.2


class BulletState:
    """One DIRECT client with object, table, obstacles and hand; call `begin` before every run and `close` at the end.

    Attributes:
        client: the client.
        T_base_frame: the frame of the simulation; `T_base_hand` is the TCP.
        velocity_m_s, rate_rad_s: of the frame, in its axes.
        carrier: what moves with respect to the frame.
        hand: None once it has left.
    """

    def __init__(self, object_model: ObjectModel, obstacles: Sequence[Obstacle], params: HandWorldParams) -> None:
        self._object_model, self._params = object_model, params
        self._names = fixed_bodies(obstacles)
        self._folder = tempfile.TemporaryDirectory(prefix="placebench-second-engine-")
        folder = Path(self._folder.name)
        self._object_urdf, self.T_object_mass = bullet_bodies.write_object(folder, object_model)
        self._hand_urdf = bullet_bodies.write_hand(folder, params)
        self._fixed = bullet_bodies.write_fixed(folder, obstacles, params)
        self._law = contact_law(build_model(object_model, obstacles, params, Carrier.REST_FRAME))
        self.client = pybullet.connect(pybullet.DIRECT)

    def close(self) -> None:
        """End the client."""
        pybullet.disconnect(physicsClientId=self.client)
        self._folder.cleanup()

    def begin(self, T_base_hand: Float[np.ndarray, "4 4"], fingers_m: Sequence[float], T_tcp_object: Float[np.ndarray, "4 4"]) -> None:
        """Build everything anew, always in the same order: what follows has the same bits in any order of runs."""
        c, params = self.client, self._params
        pybullet.resetSimulation(physicsClientId=c)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=params.step_s,
            numSolverIterations=ITERATIONS,
            solverResidualThreshold=0.0,  # it is a squared speed: what looks small leaves a creep of tenths of a millimetre a second
            erp=_ERP,
            contactERP=_ERP,
            frictionERP=_ERP,
            contactSlop=0.0,  # 10 um otherwise
            contactBreakingThreshold=0.002,
            enableSAT=1,
            enableConeFriction=1,
            deterministicOverlappingPairs=1,
            physicsClientId=c,
        )
        pybullet.setGravity(0.0, 0.0, 0.0, physicsClientId=c)  # the object's weight is applied with the frame's inertia forces
        bodies = [bullet_bodies.add_fixed(c, path, self._object_model, params, self._law) for path, _ in self._fixed]
        self.fixed = dict(zip(bodies, self._names, strict=True))
        self.object = bullet_bodies.add_object(c, self._object_urdf, self._object_model, params)
        self.hand: bullet_bodies.HandIds | None = bullet_bodies.add_hand(c, self._hand_urdf, params, self._law)
        for joint, value in zip(self.hand.fingers, fingers_m, strict=True):
            pybullet.resetJointState(self.hand.body, joint, float(value), 0.0, physicsClientId=c)
        self.carrier = Carrier.REST_FRAME
        self.T_base_hand = T_base_hand.copy()
        self.T_base_frame = T_base_hand.copy()
        self.velocity_m_s, self.rate_rad_s = np.zeros(3), np.zeros(3)
        self._put_object(T_tcp_object, np.zeros(3), np.zeros(3))
        self.place_environment(inverse(self.T_base_frame))

    def change(self, carrier: Carrier) -> None:
        """Go on in another frame; the hand is at rest, or leaves."""
        if carrier is self.carrier:
            return
        T, (v, w) = self.object_in_frame(), self.object_velocity()
        if carrier is Carrier.NO_HAND:
            r = (T @ self.T_object_mass)[:3, 3]
            v, w = v + self.velocity_m_s + cross(self.rate_rad_s, r), w + self.rate_rad_s
            T, R = self.T_base_frame @ T, self.T_base_frame[:3, :3]
            v, w, self.T_base_frame = R @ v, R @ w, np.eye(4)
            if self.hand is not None:
                pybullet.removeBody(self.hand.body, physicsClientId=self.client)
                self.hand = None
        elif self.carrier is Carrier.REST_FRAME:
            # The hand may have slid: the frame goes where it is.
            T = inverse(self.tcp_pose()) @ self.T_base_frame @ T
            self.T_base_frame = self.T_base_hand.copy()
            self.slide(np.zeros(3), np.zeros(3))
        self._put_object(T, v, w)
        self.velocity_m_s = self.rate_rad_s = np.zeros(3)
        self.carrier = carrier
        self.place_environment(inverse(self.T_base_frame))

    def slide(self, at_m: Float[np.ndarray, "3"], velocity_m_s: Float[np.ndarray, "3"]) -> None:
        """Put the hand where it is in the frame."""
        if self.hand is not None:
            for joint, x, v in zip(self.hand.slides, at_m.tolist(), velocity_m_s.tolist(), strict=True):
                pybullet.resetJointState(self.hand.body, joint, x, v, physicsClientId=self.client)

    def place_environment(self, T_frame_base: Float[np.ndarray, "4 4"]) -> None:
        """Put table and obstacles where they are in the frame."""
        for body, (_, T_base_box) in zip(self.fixed, self._fixed, strict=True):
            _put(self.client, body, T_frame_base @ T_base_box)

    def _put_object(self, T: Float[np.ndarray, "4 4"], v: Float[np.ndarray, "3"], w: Float[np.ndarray, "3"]) -> None:
        """Pose, velocity of the centre of mass and rate of turn, in the frame's axes. Putting a body stops it."""
        _put(self.client, self.object, T @ self.T_object_mass)
        pybullet.resetBaseVelocity(self.object, v.tolist(), w.tolist(), physicsClientId=self.client)

    def object_in_frame(self) -> Float[np.ndarray, "4 4"]:
        """T_frame_object."""
        position, quaternion = pybullet.getBasePositionAndOrientation(self.object, physicsClientId=self.client)
        return np.asarray(matrix_of(np.array([*position, *quaternion])) @ inverse(self.T_object_mass))

    def object_velocity(self) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
        """Of the centre of mass, and rate of turn, in the frame's axes."""
        v, w = pybullet.getBaseVelocity(self.object, physicsClientId=self.client)
        return np.array(v), np.array(w)

    def tcp_pose(self) -> Float[np.ndarray, "4 4"]:
        """T_base_tcp; a line keeps the orientation with which it began."""
        T: Float[np.ndarray, "4 4"] = self.T_base_hand.copy()
        if self.carrier is Carrier.REST_FRAME:
            T[:3, :3] = self.T_base_frame[:3, :3]
        return T


def _put(client: int, body: int, T: Float[np.ndarray, "4 4"]) -> None:
    pose = pose_of(T)
    pybullet.resetBasePositionAndOrientation(body, pose[:3].tolist(), pose[3:].tolist(), physicsClientId=client)
