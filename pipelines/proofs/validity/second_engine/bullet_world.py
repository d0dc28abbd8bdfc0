"""The held object in PyBullet, with rigid box pads: HandWorld's frames, drives and names, another engine's contacts.

What moves in which frame, what the fingers are told, and when a hand has lost its object or stops, is as in HandWorld; so whatever the two
say differently is contact and friction. Gravity and the frame's inertia forces are applied to the object alone, every step.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import TracebackType
from typing import Self

import numpy as np
from jaxtyping import Float

from objects.gripper import MAX_JAW_M
from objects.object_model import ObjectModel
from pipelines.engines.bullet import pybullet
from pipelines.engines.physics.errors import PhysicsError
from pipelines.engines.physics.finger_drives import FingerDrives
from pipelines.engines.physics.hand_bodies import FINGERS, fixed_bodies
from pipelines.engines.physics.hand_model import Carrier
from pipelines.engines.physics.hand_motion import HandMotion, check_start, cross, inertia_load
from pipelines.engines.physics.hand_params import HandWorldParams
from pipelines.engines.physics.hand_world import GRAVITY_M_S2, LOST_TICKS
from pipelines.engines.planning.bodies import bodies_meet, hand_body, object_body
from pipelines.engines.robot.arm import fk
from pipelines.proofs.validity.second_engine.bullet_bodies import carried_kg
from pipelines.proofs.validity.second_engine.bullet_contacts import read_contacts
from pipelines.proofs.validity.second_engine.bullet_state import BulletState
from pipelines.values import Obstacle
from tables.poses import inverse, matrix_of

_GRAVITY = np.array([0.0, 0.0, -GRAVITY_M_S2])


class BulletHandWorld:
    """Context manager around one client; call one of the `start` methods before every run. HandWorld says what each name means.

    Args:
        object_model: the object.
        obstacles: box obstacles, fixed to the table.
        params: the physics.

    Raises:
        ValueError: pads of cells that yield, which only MuJoCo has.
    """

    def __init__(self, object_model: ObjectModel, obstacles: Sequence[Obstacle], params: HandWorldParams) -> None:
        if params.cells_per_side != 0:
            raise ValueError(f"{object_model.object_id}: cells_per_side = {params.cells_per_side}, must be 0: pads are rigid boxes here")
        self.object_model, self.obstacles, self.params = object_model, tuple(obstacles), params
        self._label = object_model.object_id
        self.n_steps = 0

    def __enter__(self) -> Self:
        self._state = BulletState(self.object_model, self.obstacles, self.params)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._state.close()

    # ---------------------------------------------------------------- starts
    def start_held(self, label: str, q: Float[np.ndarray, "7"], fingers_m: Sequence[float], T_tcp_object: Float[np.ndarray, "4 4"]) -> None:
        """A hold as it was when these numbers were measured."""
        self._begin(label, q, fingers_m, T_tcp_object)
        self._drives.hold_on(self.params)

    def start_taking(
        self, label: str, q: Float[np.ndarray, "7"], finger_m: float, T_tcp_object: Float[np.ndarray, "4 4"], duration_s: float
    ) -> None:
        """Close on an object that floats without weight at a pose between the open fingers, and give it its weight back once it is held."""
        self._begin(label, q, [finger_m] * 2, T_tcp_object)
        self.grip()
        self._is_weightless = True
        for _ in range(max(1, round(duration_s / self.params.dt_s))):
            self.step()
        self._is_weightless = False

    def _begin(self, label: str, q: Float[np.ndarray, "7"], fingers_m: Sequence[float], T_tcp_object: Float[np.ndarray, "4 4"]) -> None:
        self._label, self.n_steps = label, 0
        self.is_lost = self.is_stopped = self._is_weightless = False
        self._q = np.array(q, dtype=np.float64)
        self._state.begin(fk(self._q), fingers_m, T_tcp_object)
        self._drives = FingerDrives()
        self._load = np.zeros(6)
        self._untouched = 0
        self._pressing: frozenset[str] = frozenset()
        self._impulse = dict.fromkeys([(body, other) for body in ("object", "robot") for other in self.fixed_bodies], 0.0)

    def begin_landing(self) -> None:
        """Nothing changes: all steps are fine enough for a landing."""

    def remove_hand(self) -> None:
        """Take the hand out of the world."""
        self.object_pose()  # it must be finite
        self._state.change(Carrier.NO_HAND)
        self._pressing = frozenset()

    # ---------------------------------------------------------------- commands
    def command_fingers(self, speed_m_s: float) -> None:
        """Speed of each finger, positive opens; a grip is let go first."""
        self._drives.command(speed_m_s)

    def grip(self) -> None:
        """Close at rated speed, and press with the grip force once both fingers touch the object."""
        self._drives.grip(self.params)

    def load(self, force_n: Float[np.ndarray, "3"], torque_n_m: Float[np.ndarray, "3"], *, is_weightless: bool) -> None:
        """Load the object from outside for the next tick of a hand at rest: a force at the TCP and a torque, in the hand's axes."""
        r = (self._state.object_in_frame() @ self._state.T_object_mass)[:3, 3]
        self._load = np.concatenate([force_n, torque_n_m - cross(r, np.asarray(force_n))])
        self._is_weightless = is_weightless

    # ---------------------------------------------------------------- ticks
    def step(self) -> None:
        """One tick with the hand at rest."""
        state, R = self._state, self._state.T_base_frame[:3, :3]
        state.velocity_m_s = state.rate_rad_s = np.zeros(3)
        state.slide(R.T @ (state.T_base_hand[:3, 3] - state.T_base_frame[:3, 3]), np.zeros(3))
        self._tick(self._weight(R) + self._load, np.zeros(3))

    def begin_motion(self, motion: HandMotion) -> None:
        """Choose the frame in which a motion of the hand runs; it starts where the hand is, at rest.

        Raises:
            PhysicsError: it starts elsewhere.
        """
        check_start(self._label, motion, self._state.T_base_hand)
        self._state.change(Carrier.HAND_FRAME if motion.is_turning else Carrier.REST_FRAME)

    def step_along(self, motion: HandMotion, k: int, q: Float[np.ndarray, "7"]) -> None:
        """Tick k of a motion; `q` is the arm's configuration at its end."""
        state = self._state
        at_m = state.T_base_hand[:3, 3]
        self._q, state.T_base_hand = q, motion.T_base_tcp[k + 1]
        if state.carrier is Carrier.HAND_FRAME:
            state.slide(np.zeros(3), np.zeros(3))
            self._tick(self._weight(motion.R_mid[k]) + self._inertia_load(motion, k), np.zeros(3))
            state.T_base_frame = state.T_base_hand
            state.velocity_m_s, state.rate_rad_s = motion.end_velocity_m_s[k], motion.end_rate_rad_s[k]
            state.place_environment(matrix_of(motion.tcp_base_pose[k]))
            self._untouched = 0 if self._pressing else self._untouched + 1
            if self._untouched >= LOST_TICKS:
                self.is_lost = True
                self.remove_hand()
        else:
            R, a = state.T_base_frame[:3, :3], motion.base_acceleration_m_s2[k]
            # Half a step's acceleration less: the engine's steps then end where the path is.
            velocity_m_s = motion.start_velocity_m_s[k] - a * (self.params.step_s / 2)
            state.slide(R.T @ (at_m - state.T_base_frame[:3, 3]), R.T @ velocity_m_s)
            self._tick(self._weight(R), R.T @ a)

    def _weight(self, R_base_frame: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "6"]:
        share = 0.0 if self._is_weightless else self.object_model.mass_kg
        return np.concatenate([share * (R_base_frame.T @ _GRAVITY), np.zeros(3)])

    def _inertia_load(self, motion: HandMotion, k: int) -> Float[np.ndarray, "6"]:
        T, (v, w) = self._state.object_in_frame(), self._state.object_velocity()
        R = T[:3, :3]
        of_origin = v - cross(w, R @ self.object_model.com_m)
        return inertia_load(motion, k, self.object_model, R, T[:3, 3], np.concatenate([of_origin, R.T @ w]))

    def _tick(self, load: Float[np.ndarray, "6"], acceleration_m_s2: Float[np.ndarray, "3"]) -> None:
        """The steps of a tick under a constant load on the object (at its centre of mass) and acceleration of the hand, frame axes."""
        c, state, params = self._state.client, self._state, self.params
        force_n, torque_n_m = load[:3].tolist(), load[3:].tolist()
        slides_n = (carried_kg(params) * acceleration_m_s2).tolist()
        speed_m_s, press_n = self._drives.tick(all(map(self.touching, FINGERS)), params)
        on_hand_n = 0.0
        for _ in range(params.steps_per_tick):
            if state.hand is not None:
                forces_n = [*slides_n, *self._drive_n(speed_m_s, press_n)]
                control = pybullet.TORQUE_CONTROL
                pybullet.setJointMotorControlArray(state.hand.body, state.hand.joints, control, forces=forces_n, physicsClientId=c)
            at_m, _ = pybullet.getBasePositionAndOrientation(state.object, physicsClientId=c)
            pybullet.applyExternalForce(state.object, -1, force_n, at_m, pybullet.WORLD_FRAME, physicsClientId=c)
            pybullet.applyExternalTorque(state.object, -1, torque_n_m, pybullet.WORLD_FRAME, physicsClientId=c)
            pybullet.stepSimulation(physicsClientId=c)
            contacts = read_contacts(c, state.object, state.hand, state.fixed)
            self._pressing = contacts.pressing
            on_hand_n += contacts.on_hand_n
            for pair, net_n in contacts.fixed_n.items():
                self._impulse[pair] += net_n * params.step_s
        self.n_steps += 1
        self.is_stopped = self.is_stopped or on_hand_n > params.protective_stop_n * params.steps_per_tick

    def _drive_n(self, speed_m_s: float, press_n: float) -> list[float]:
        """Force of each finger's drive: a servo of speed, bounded, and the grip on top of it."""
        gain, most_n = self.params.finger_mass_kg / self.params.finger_lag_s, self.params.finger_force_n
        return [min(most_n, max(-most_n, gain * (speed_m_s - v))) - press_n for _, v in self._fingers()]

    def _fingers(self) -> list[tuple[float, float]]:
        """Opening and speed of each finger."""
        state = self._state
        if state.hand is None:
            raise PhysicsError(f"{self._label}: the hand has left after {self.n_steps} ticks, must be in the world")
        return [s[:2] for s in pybullet.getJointStates(state.hand.body, state.hand.fingers, physicsClientId=state.client)]

    # ---------------------------------------------------------------- measurements
    def object_pose(self) -> Float[np.ndarray, "4 4"]:
        """T_base_object.

        Raises:
            PhysicsError: it is not finite.
        """
        T = np.asarray(self._state.T_base_frame @ self._state.object_in_frame())
        if not np.isfinite(T).all() or np.abs(T).max() > 1e3:
            raise PhysicsError(f"{self._label}: pose {T.tolist()} after {self.n_steps} ticks, must be finite and within 1000 m")
        return T

    def tcp_pose(self) -> Float[np.ndarray, "4 4"]:
        """T_base_tcp; where the hand was last, once it has left."""
        return self._state.tcp_pose()

    def inhand_pose(self) -> Float[np.ndarray, "4 4"]:
        """T_tcp_object."""
        return np.asarray(inverse(self.tcp_pose()) @ self.object_pose())

    def arm_state(self) -> tuple[Float[np.ndarray, "7"], Float[np.ndarray, "2"]]:
        """Arm configuration in radians and opening of each finger in metres."""
        return self._q.copy(), np.array([opening_m for opening_m, _ in self._fingers()])

    def impulse_n_s(self, body: str, other: str) -> float:
        """Contact impulse between "object" or "robot" and table or an obstacle since the start: the force's size summed over every step."""
        return self._impulse[body, other]

    def touching(self, part: str) -> bool:
        """Whether a part of the hand ("panda_hand" or a finger) pressed on the object in the last step."""
        return part in self._pressing

    @property
    def has_robot(self) -> bool:
        """Whether the hand is in the world."""
        return self._state.carrier is not Carrier.NO_HAND

    @property
    def fixed_bodies(self) -> tuple[str, ...]:
        """Names of the table and the obstacles."""
        return fixed_bodies(self.obstacles)

    def is_clear(self, gap_m: float) -> bool:
        """Whether hand and object are further apart than a gap."""
        # Not Bullet's closest points: of boxes, and of hulls whose faces it keeps, it finds only those that touch.
        jaw_m = round(min(MAX_JAW_M, max(0.0, float(self.arm_state()[1].sum()))), 5)
        return not bodies_meet(hand_body(jaw_m).parts, object_body(self.object_model).parts, self.inhand_pose(), gap_m)
