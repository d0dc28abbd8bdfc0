"""The held object in PyBullet, with rigid box pads, in the frames of HandWorld and with its names; shapes are bullet_bodies.py.

What moves in which frame, what the fingers are told and when a hand has lost its object are HandWorld's, so that whatever the two say
differently is contact and friction. Bullet has no force on anything but what is applied here: gravity and the frame's inertia forces go to
the object alone, every step.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import pybullet
from jaxtyping import Float

from objects.gripper import MAX_JAW_M
from objects.object_model import ObjectModel
from pipelines.engines.physics.errors import PhysicsError
from pipelines.engines.physics.finger_drives import FingerDrives
from pipelines.engines.physics.hand_model import FINGERS, Carrier, fixed_bodies
from pipelines.engines.physics.hand_motion import HandMotion, cross, inertia_load
from pipelines.engines.physics.hand_params import HandWorldParams
from pipelines.engines.physics.hand_world import GRAVITY_M_S2, LOST_TICKS
from pipelines.engines.planning.bodies import bodies_meet, hand_body, object_body
from pipelines.engines.robot.arm import fk
from pipelines.proofs.validity.second_engine import bullet_bodies
from pipelines.values import Obstacle
from tables.poses import inverse, matrix_of, pose_of

_GRAVITY = np.array([0.0, 0.0, -GRAVITY_M_S2])
ITERATIONS = 200
ERP = 0.2


class BulletHandWorld:
    """Context manager around one DIRECT client; call `start_held` or `start_taking` before every run. See HandWorld for every name.

    Args:
        object_model: the object.
        obstacles: box obstacles, fixed to the table.
        params: the physics; pads are rigid boxes whatever it says of cells.
    """

    def __init__(self, object_model: ObjectModel, obstacles: Sequence[Obstacle], params: HandWorldParams) -> None:
        self.object_model, self.obstacles, self.params = object_model, tuple(obstacles), params
        self._names = fixed_bodies(self.obstacles)
        self._client = -1
        self.n_steps = 0
        self.is_lost = self.is_stopped = False

    def __enter__(self) -> Self:
        self._folder = tempfile.TemporaryDirectory(prefix="placebench-second-engine-")
        folder = Path(self._folder.name)
        self._object_urdf, self._T_object_mass = bullet_bodies.write_object(folder, self.object_model)
        self._hand_urdf = bullet_bodies.write_hand(folder, self.params)
        self._fixed = bullet_bodies.write_fixed(folder, self.obstacles, self.params)
        self._T_mass_object = inverse(self._T_object_mass)
        self._client = pybullet.connect(pybullet.DIRECT)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        pybullet.disconnect(physicsClientId=self._client)
        self._folder.cleanup()

    # ---------------------------------------------------------------- starts
    def start_held(self, label: str, q: Float[np.ndarray, "7"], fingers_m: Sequence[float], T_tcp_object: Float[np.ndarray, "4 4"]) -> None:
        """A hold as it was when these numbers were measured."""
        self._begin(label, q, fingers_m, T_tcp_object)
        self._drives.hold_on(self.params)

    def start_taking(
        self, label: str, q: Float[np.ndarray, "7"], finger_m: float, T_tcp_object: Float[np.ndarray, "4 4"], duration_s: float
    ) -> None:
        """Close on an object that floats without weight between the open fingers, and give it its weight back once it is held."""
        self._begin(label, q, [finger_m] * 2, T_tcp_object)
        self._drives.grip(self.params)
        self._is_weightless = True
        for _ in range(max(1, round(duration_s / self.params.dt_s))):
            self.step()
        self._is_weightless = False

    def _begin(self, label: str, q: Float[np.ndarray, "7"], fingers_m: Sequence[float], T_tcp_object: Float[np.ndarray, "4 4"]) -> None:
        self._label, self.n_steps = label, 0
        self.is_lost = self.is_stopped = self._is_weightless = False
        self._q = np.array(q, dtype=np.float64)
        self._T_hand = fk(self._q)
        self._T_base_frame = self._T_hand.copy()
        self._velocity, self._rate = np.zeros(3), np.zeros(3)
        self._extra = np.zeros(6)
        self._carrier = Carrier.REST_FRAME
        self._drives = FingerDrives()
        self._untouched = 0
        self._pressing: set[str] = set()
        self._impulse = dict.fromkeys([(body, other) for body in ("object", "robot") for other in self._names], 0.0)
        c, p = self._client, self.params
        pybullet.resetSimulation(physicsClientId=c)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=p.step_s,
            numSolverIterations=ITERATIONS,
            solverResidualThreshold=0.0,
            erp=ERP,
            contactERP=ERP,
            frictionERP=ERP,
            contactBreakingThreshold=0.002,
            enableSAT=1,
            enableConeFriction=1,
            deterministicOverlappingPairs=1,
            physicsClientId=c,
        )
        pybullet.setGravity(0.0, 0.0, 0.0, physicsClientId=c)
        self._fixed_ids = {bullet_bodies.add_fixed(c, path, self.object_model, p): name for (path, _), name in zip(self._fixed, self._names, strict=True)}
        self._object = bullet_bodies.add_object(c, self._object_urdf, self.object_model, p)
        self._hand: bullet_bodies.HandIds | None = bullet_bodies.add_hand(c, self._hand_urdf, self.object_model, p)
        self._part_of = {link: name for name, link in self._hand.links.items()}
        for joint, value in zip(self._hand.fingers, fingers_m, strict=True):
            pybullet.resetJointState(self._hand.body, joint, float(value), 0.0, physicsClientId=c)
        self._put_object(T_tcp_object, np.zeros(3), np.zeros(3))
        self._place_environment(inverse(self._T_base_frame))

    # ---------------------------------------------------------------- frames
    def _put_object(self, T_frame_object: Float[np.ndarray, "4 4"], v: Float[np.ndarray, "3"], w: Float[np.ndarray, "3"]) -> None:
        """Pose of the object, velocity of its centre of mass and rate of turn, all in the frame's axes."""
        pose = pose_of(T_frame_object @ self._T_object_mass)
        pybullet.resetBasePositionAndOrientation(self._object, pose[:3].tolist(), pose[3:].tolist(), physicsClientId=self._client)
        pybullet.resetBaseVelocity(self._object, v.tolist(), w.tolist(), physicsClientId=self._client)

    def _place_environment(self, T_frame_base: Float[np.ndarray, "4 4"]) -> None:
        for body, (_, T) in zip(self._fixed_ids, self._fixed, strict=True):
            pose = pose_of(T_frame_base @ T)
            pybullet.resetBasePositionAndOrientation(body, pose[:3].tolist(), pose[3:].tolist(), physicsClientId=self._client)

    def _change(self, carrier: Carrier) -> None:
        if carrier is self._carrier:
            return
        T = self._object_in_frame()
        v, w = self._object_velocity()
        if carrier is Carrier.NO_HAND:
            r = (T @ self._T_object_mass)[:3, 3]
            v, w = v + self._velocity + cross(self._rate, r), w + self._rate
            T_frame_now, self._T_base_frame = self._T_base_frame, np.eye(4)
            R = T_frame_now[:3, :3]
            assert self._hand is not None
            pybullet.removeBody(self._hand.body, physicsClientId=self._client)
            self._hand = None
            self._pressing = set()
            self._put_object(T_frame_now @ T, R @ v, R @ w)
        elif self._carrier is Carrier.REST_FRAME:
            # The hand has slid; from now on the frame is where the hand is.
            T_tcp_object = self.inhand_pose()
            self._T_base_frame = self._T_hand.copy()
            self._set_slides(np.zeros(3), np.zeros(3))
            self._put_object(T_tcp_object, v, w)
        self._velocity = self._rate = np.zeros(3)
        self._carrier = carrier
        self._place_environment(inverse(self._T_base_frame))

    def remove_hand(self) -> None:
        """Take the hand out of the world."""
        self._change(Carrier.NO_HAND)

    def _set_slides(self, at_m: Float[np.ndarray, "3"], v_m_s: Float[np.ndarray, "3"]) -> None:
        assert self._hand is not None
        for joint, x, v in zip(self._hand.slides, at_m.tolist(), v_m_s.tolist(), strict=True):
            pybullet.resetJointState(self._hand.body, joint, x, v, physicsClientId=self._client)

    # ---------------------------------------------------------------- commands
    def command_fingers(self, speed_m_s: float) -> None:
        """Speed of each finger, positive opens."""
        self._drives.command(speed_m_s)

    def grip(self) -> None:
        """Close, and press once both fingers touch."""
        self._drives.grip(self.params)

    def load(self, force_n: Float[np.ndarray, "3"], torque_n_m: Float[np.ndarray, "3"], *, is_weightless: bool) -> None:
        """Load the object from outside until the next call: a force at the TCP and a torque, in the hand's axes."""
        r = (self._object_in_frame() @ self._T_object_mass)[:3, 3]
        self._extra = np.concatenate([force_n, torque_n_m - cross(r, np.asarray(force_n))])
        self._is_weightless = is_weightless

    def step(self) -> None:
        """One tick with the hand at rest."""
        self._velocity = self._rate = np.zeros(3)
        if self._hand is not None and self._carrier is Carrier.REST_FRAME:
            slide = self._T_base_frame[:3, :3].T @ (self._T_hand[:3, 3] - self._T_base_frame[:3, 3])
            self._set_slides(slide, np.zeros(3))
        self._tick(self._weight(self._T_base_frame[:3, :3]) + self._extra, np.zeros(3))

    def begin_motion(self, motion: HandMotion) -> None:
        """Choose the frame in which a motion of the hand runs."""
        miss = float(np.abs(motion.T_base_tcp[0] - self._T_hand).max())
        if miss > 1e-4:
            raise PhysicsError(f"{self._label}: a motion starts {miss:.2g} (m or sine) from where the hand is, must be at most 1e-4")
        self._change(Carrier.HAND_FRAME if motion.is_turning else Carrier.REST_FRAME)

    def step_along(self, motion: HandMotion, k: int, q: Float[np.ndarray, "7"]) -> None:
        """Tick k of a motion."""
        T_before = self._T_hand
        self._q, self._T_hand = q, motion.T_base_tcp[k + 1]
        if self._carrier is Carrier.HAND_FRAME:
            self._set_slides(np.zeros(3), np.zeros(3))
            T, (v, w) = self._object_in_frame(), self._object_velocity()
            v = v - cross(w, T[:3, :3] @ self.object_model.com_m)
            load = inertia_load(motion, k, self.object_model, T[:3, :3], T[:3, 3], np.concatenate([v, T[:3, :3].T @ w]))
            self._tick(self._weight(motion.R_mid[k]) + load, np.zeros(3))
            self._T_base_frame = self._T_hand
            self._velocity, self._rate = motion.end_velocity_m_s[k], motion.end_rate_rad_s[k]
            self._place_environment(matrix_of(motion.tcp_base_pose[k]))
            self._untouched = 0 if self._pressing else self._untouched + 1
            if self._untouched >= LOST_TICKS:
                self.is_lost = True
                self.remove_hand()
        else:
            R, a = self._T_base_frame[:3, :3], motion.base_acceleration_m_s2[k]
            self._set_slides(
                R.T @ (T_before[:3, 3] - self._T_base_frame[:3, 3]),
                R.T @ (motion.start_velocity_m_s[k] - a * (self.params.step_s / 2)),
            )
            self._tick(self._weight(R), R.T @ a)

    def _weight(self, R_base_frame: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "6"]:
        g = np.zeros(3) if self._is_weightless else self.object_model.mass_kg * (R_base_frame.T @ _GRAVITY)
        return np.concatenate([g, np.zeros(3)])

    def _tick(self, load: Float[np.ndarray, "6"], acceleration: Float[np.ndarray, "3"]) -> None:
        """The steps of a tick under a constant load on the object (at its centre of mass) and acceleration of the hand, frame axes."""
        c, p, hand = self._client, self.params, self._hand
        force, torque = load[:3].tolist(), load[3:].tolist()
        gain = p.finger_mass_kg / p.finger_lag_s
        if hand is not None:
            speed_m_s, press_n = self._drives.tick(all(map(self.touching, FINGERS)), p)
            slide_n = (bullet_bodies.carried_kg(p) * acceleration).tolist()
        total_n = 0.0
        for _ in range(p.steps_per_tick):
            if hand is not None:
                v = [state[1] for state in pybullet.getJointStates(hand.body, hand.fingers, physicsClientId=c)]
                drive_n = [min(p.finger_force_n, max(-p.finger_force_n, gain * (speed_m_s - x))) - press_n for x in v]
                pybullet.setJointMotorControlArray(
                    hand.body, hand.joints, pybullet.TORQUE_CONTROL, forces=[*slide_n, *drive_n], physicsClientId=c
                )
            at, _q = pybullet.getBasePositionAndOrientation(self._object, physicsClientId=c)
            pybullet.applyExternalForce(self._object, -1, force, at, pybullet.WORLD_FRAME, physicsClientId=c)
            pybullet.applyExternalTorque(self._object, -1, torque, pybullet.WORLD_FRAME, physicsClientId=c)
            pybullet.stepSimulation(physicsClientId=c)
            total_n += self._read_contacts()
        self.n_steps += 1
        if hand is not None:
            self.is_stopped = self.is_stopped or total_n > p.protective_stop_n * p.steps_per_tick

    def _read_contacts(self) -> float:
        """Add the last step's impulses; returns the size of the net force on the hand."""
        nets: dict[tuple[str, str], Any] = {}
        on_hand = np.zeros(3)
        self._pressing = set()
        for point in pybullet.getContactPoints(physicsClientId=self._client) or ():
            if point[9] <= 0.0 and point[10] == 0.0 and point[12] == 0.0:
                continue
            a, b = point[1], point[2]
            on_a = point[9] * np.array(point[7]) + point[10] * np.array(point[11]) + point[12] * np.array(point[13])
            hand = self._hand.body if self._hand is not None else -1
            if hand in (a, b):
                on_hand += on_a if a == hand else -on_a
            for body, name in ((self._object, "object"), (hand, "robot")):
                other = b if a == body else a if b == body else None
                if other in self._fixed_ids:
                    sign = 1.0 if a == body else -1.0
                    key = (name, self._fixed_ids[other])
                    nets[key] = nets.get(key, 0.0) + sign * on_a
            if {a, b} == {hand, self._object}:
                self._pressing.add(self._part_of[point[3] if a == hand else point[4]])
        for key, net in nets.items():
            self._impulse[key] += float(np.linalg.norm(net)) * self.params.step_s
        return float(np.linalg.norm(on_hand))

    # ---------------------------------------------------------------- measurements
    def _object_in_frame(self) -> Float[np.ndarray, "4 4"]:
        position, quaternion = pybullet.getBasePositionAndOrientation(self._object, physicsClientId=self._client)
        pose = np.array([*position, *quaternion])
        if not np.all(np.isfinite(pose)) or np.abs(pose[:3]).max() > 1e3:
            raise PhysicsError(f"{self._label}: object pose {pose.tolist()} after {self.n_steps} ticks, must be finite and within 1000 m")
        return np.asarray(matrix_of(pose) @ self._T_mass_object)

    def _object_velocity(self) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
        """Of the centre of mass, and rate of turn, in the frame's axes."""
        v, w = pybullet.getBaseVelocity(self._object, physicsClientId=self._client)
        return np.array(v), np.array(w)

    def object_pose(self) -> Float[np.ndarray, "4 4"]:
        """T_base_object."""
        return np.asarray(self._T_base_frame @ self._object_in_frame())

    def tcp_pose(self) -> Float[np.ndarray, "4 4"]:
        """T_base_tcp; where the hand was last, once it has left."""
        T: Float[np.ndarray, "4 4"] = self._T_hand.copy()
        if self._carrier is Carrier.REST_FRAME:
            T[:3, :3] = self._T_base_frame[:3, :3]
        return T

    def inhand_pose(self) -> Float[np.ndarray, "4 4"]:
        """T_tcp_object."""
        return np.asarray(inverse(self.tcp_pose()) @ self.object_pose())

    def arm_state(self) -> tuple[Float[np.ndarray, "7"], Float[np.ndarray, "2"]]:
        """Arm configuration in radians and opening of each finger in metres."""
        assert self._hand is not None
        states = pybullet.getJointStates(self._hand.body, self._hand.fingers, physicsClientId=self._client)
        return self._q.copy(), np.array([state[0] for state in states])

    def impulse_n_s(self, body: str, other: str) -> float:
        """Contact impulse between "object" or "robot" and table or an obstacle since the start."""
        return self._impulse[body, other]

    def touching(self, part: str) -> bool:
        """Whether a part of the hand pressed on the object in the last step."""
        return part in self._pressing

    @property
    def has_robot(self) -> bool:
        """Whether the hand is in the world."""
        return self._hand is not None

    @property
    def fixed_bodies(self) -> tuple[str, ...]:
        """Names of the table and the obstacles."""
        return self._names

    def is_clear(self, gap_m: float) -> bool:
        """Whether hand and object are further apart than a gap."""
        # Bullet's closest points of boxes and of hulls whose faces it keeps are those that touch.
        jaw_m = round(min(MAX_JAW_M, max(0.0, float(self.arm_state()[1].sum()))), 5)
        return not bodies_meet(hand_body(jaw_m).parts, object_body(self.object_model).parts, self.inhand_pose(), gap_m)
