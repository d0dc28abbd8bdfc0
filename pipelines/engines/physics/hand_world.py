"""What a hand holds, simulated in the hand's frame (MuJoCo): ticks and what is measured.

Where hand and object are is hand_state.py, motions are hand_rollout.py.

While the hand turns, its frame is the frame of the simulation: the object feels gravity and the frame's inertia forces (linear, Euler,
centrifugal, Coriolis), table and obstacles go by, nothing drifts and no contact normal lags behind. While the hand only translates, the
frame rests and the hand slides in it. An object that the hand has lost goes on in the base frame, alone. Fingers do not feel the
inertia forces: one belt couples them, so what acts on both alike moves neither, and what does not is below a thousandth of the grip.

Contacts remember nothing, so a hold is restarted from the arm's configuration, both finger openings and the object's pose in the hand:
nothing else has to be saved. Every run has a fresh mjData and the same bits in any order and process.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import TracebackType
from typing import Self

import mujoco
import numpy as np
from jaxtyping import Float

from objects.object_model import ObjectModel
from pipelines.engines.physics.errors import PhysicsError
from pipelines.engines.physics.finger_drives import FingerDrives
from pipelines.engines.physics.hand_bodies import FINGERS, HAND_MASS_KG, fixed_bodies
from pipelines.engines.physics.hand_model import Carrier
from pipelines.engines.physics.hand_motion import HandMotion, check_start, cross, inertia_load
from pipelines.engines.physics.hand_params import HandWorldParams
from pipelines.engines.physics.hand_state import GRAVITY, HandState
from pipelines.engines.robot.arm import fk
from pipelines.values import GRAVITY_M_S2, Obstacle
from tables.poses import inverse

__all__ = ["GRAVITY_M_S2", "LOST_TICKS", "HandWorld"]

# Ticks without any contact between hand and object after which the object is lost: 12 ms, in which it falls a millimetre.
LOST_TICKS = 3
_WARNINGS = [str(mujoco.mjtWarning(k).name) for k in range(int(mujoco.mjtWarning.mjNWARNING))]


class HandWorld:
    """Context manager around the models of one object among its obstacles; call one of the `start` methods before every run.

    Args:
        object_model: the object.
        obstacles: box obstacles, fixed to the table.
        params: the physics.

    Attributes:
        n_steps: ticks since the start.
        is_lost: the hand lost the object while it turned; the hand has left the world.
        is_stopped: the hand met more than it bears and stopped for good.
    """

    def __init__(self, object_model: ObjectModel, obstacles: Sequence[Obstacle], params: HandWorldParams) -> None:
        self.object_model, self.obstacles, self.params = object_model, tuple(obstacles), params
        self._state = HandState(object_model, self.obstacles, params)
        self._label = object_model.object_id
        self.n_steps = 0

    def __enter__(self) -> Self:
        # Warnings are counted and raised as errors; MuJoCo's own handler would write them to a file in the working directory.
        mujoco.set_mju_user_warning(_no_log)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._state.forget_models()
        mujoco.set_mju_user_warning(None)

    # ---------------------------------------------------------------- starts
    def start_open(self, label: str, q: Float[np.ndarray, "7"], finger_m: float, T_base_object: Float[np.ndarray, "4 4"]) -> None:
        """The open hand, each finger at `finger_m`, and the object at rest somewhere; `label` names the run in errors."""
        self._begin(label, q)
        self._state.data.qpos[self._state.at.finger_q,] = finger_m
        self._state.put_object(inverse(self._state.T_base_frame) @ T_base_object)
        self.command_fingers(0.0)

    def start_held(self, label: str, q: Float[np.ndarray, "7"], fingers_m: Sequence[float], T_tcp_object: Float[np.ndarray, "4 4"]) -> None:
        """A hold as it was when these numbers were measured."""
        self._begin(label, q)
        self._state.data.qpos[self._state.at.finger_q,] = fingers_m
        self._state.put_object(T_tcp_object)
        self._drives.hold_on(self.params)

    def start_taking(
        self, label: str, q: Float[np.ndarray, "7"], finger_m: float, T_tcp_object: Float[np.ndarray, "4 4"], duration_s: float
    ) -> None:
        """Close on an object that floats without weight at a pose between the open fingers, and give it its weight back once it is held."""
        self._begin(label, q)
        self._state.data.qpos[self._state.at.finger_q,] = finger_m
        self._state.put_object(T_tcp_object)
        self.grip()
        self._state.at.model.opt.gravity[:] = 0.0
        for _ in range(max(1, round(duration_s / self.params.dt_s))):
            self.step()
        self._state.turn_gravity()

    def _begin(self, label: str, q: Float[np.ndarray, "7"]) -> None:
        self._label, self.n_steps = label, 0
        self.is_lost = self.is_stopped = False
        self._q = np.array(q, dtype=np.float64)
        self._state.T_base_hand = fk(self._q)
        self._state.enter(Carrier.REST_FRAME)
        self._drives = FingerDrives()
        self._untouched = 0
        self._names = fixed_bodies(self.obstacles)
        self._impulse = dict.fromkeys([(body, other) for body in ("object", "robot") for other in self._names], 0.0)
        self._impulse["robot", "anything"] = 0.0
        self.most_iterations = 0

    def begin_landing(self) -> None:
        """Go on in the finer steps of a landing; the hand is at rest."""
        self._change(Carrier.LANDING)

    def remove_hand(self) -> None:
        """Take the hand out of the world: what the object does from here on is its own affair, at a third of the cost."""
        self._change(Carrier.NO_HAND)

    def _change(self, carrier: Carrier) -> None:
        self.object_pose()  # it must be finite: MuJoCo would go on without a word
        self._state.change(carrier)

    # ---------------------------------------------------------------- commands
    def command_fingers(self, speed_m_s: float) -> None:
        """Speed of each finger, positive opens; a grip is let go first."""
        self._drives.command(speed_m_s)

    def grip(self) -> None:
        """Close at rated speed, and press with the grip force once both fingers touch the object."""
        self._drives.grip(self.params)

    def _drive_fingers(self) -> None:
        speed_m_s, force_n = self._drives.tick(all(map(self.touching, FINGERS)), self.params)
        self._state.data.ctrl[:] = speed_m_s
        self._state.data.qfrc_applied[self._state.at.finger_v,] = -force_n

    def load(self, force_n: Float[np.ndarray, "3"], torque_n_m: Float[np.ndarray, "3"], *, is_weightless: bool) -> None:
        """Load the object from outside for the next tick of a hand at rest: a force at the TCP and a torque, in the hand's axes.

        For tests of what a grip bears; `is_weightless` takes gravity away until the next start or motion.
        """
        T = self._state.object_in_frame()
        r = T[:3, :3] @ self.object_model.com_m + T[:3, 3]
        self._state.data.xfrc_applied[self._state.at.object_body] = [*force_n, *(torque_n_m - cross(r, np.asarray(force_n)))]
        if is_weightless:
            self._state.at.model.opt.gravity[:] = 0.0

    def step(self) -> None:
        """One tick with the hand at rest."""
        data, at = self._state.data, self._state.at
        if at.slide_q:
            data.qvel[at.slide_v,] = 0.0
            data.qfrc_applied[at.slide_v,] = 0.0
        self._tick()

    def begin_motion(self, motion: HandMotion) -> None:
        """Choose the frame in which a motion of the hand runs; it starts where the hand is, at rest.

        Raises:
            PhysicsError: it starts elsewhere.
        """
        check_start(self._label, motion, self._state.T_base_hand)
        if motion.is_turning:
            self._change(Carrier.HAND_FRAME)
        elif not self._state.at.carrier.is_sliding:
            self._change(Carrier.REST_FRAME)
        self._state.data.xfrc_applied[:] = 0.0
        if motion.is_turning:
            self._gravity = np.einsum("nji,j->ni", motion.R_mid, GRAVITY)
        else:
            R, a = self._state.T_base_frame[:3, :3], motion.base_acceleration_m_s2
            self._slide_m = (motion.T_base_tcp[:-1, :3, 3] - self._state.T_base_frame[:3, 3]) @ R
            # Half a step's acceleration less: the engine's steps then end where the path is.
            self._slide_m_s = (motion.start_velocity_m_s - a * (self._state.at.step_s / 2)) @ R
            self._slide_n = (HAND_MASS_KG + 2 * self.params.finger_mass_kg) * (a @ R)

    def step_along(self, motion: HandMotion, k: int, q: Float[np.ndarray, "7"]) -> None:
        """Tick k of a motion; `q` is the arm's configuration at its end."""
        state, data, at = self._state, self._state.data, self._state.at
        self._q, state.T_base_hand = q, motion.T_base_tcp[k + 1]
        if at.carrier is Carrier.HAND_FRAME:
            self._drive_fingers()
            at.model.opt.gravity[:] = self._gravity[k]
            r_v = data.qpos[at.object_q : at.object_q + 3], data.qvel[at.object_v : at.object_v + 6]
            data.xfrc_applied[at.object_body] = inertia_load(motion, k, self.object_model, state.object_rotation(), *r_v)
            mujoco.mj_step(at.model, data, at.n_steps)
            data.xfrc_applied[at.object_body] = 0.0
            state.T_base_frame = state.T_base_hand
            state.velocity_m_s, state.rate_rad_s = motion.end_velocity_m_s[k], motion.end_rate_rad_s[k]
            state.place_environment(motion.tcp_base_pose[k])
            self._tick_done()
            self._untouched = 0 if state.forces.is_touched(data) else self._untouched + 1
            if self._untouched >= LOST_TICKS:
                self.is_lost = True
                self.remove_hand()
        else:
            self._drive_fingers()
            slides, v = slice(at.slide_q[0], at.slide_q[0] + 3), slice(at.slide_v[0], at.slide_v[0] + 3)
            data.qpos[slides], data.qvel[v], data.qfrc_applied[v] = self._slide_m[k], self._slide_m_s[k], self._slide_n[k]
            mujoco.mj_step(at.model, data, at.n_steps)
            self._tick_done()

    def _tick(self) -> None:
        """One tick of a resting frame: what the frame did is over."""
        state = self._state
        state.velocity_m_s = state.rate_rad_s = np.zeros(3)
        if state.at.carrier is Carrier.HAND_FRAME:
            state.turn_gravity()
        if self.has_robot:
            self._drive_fingers()
        mujoco.mj_step(state.at.model, state.data, state.at.n_steps)
        self._tick_done()

    def _tick_done(self) -> None:
        """Sum up the tick's contact forces, and see whether the engine, the hand or the hold has failed."""
        data, params = self._state.data, self.params
        self.n_steps += 1
        sums_n = self._state.forces.sums_n(data)
        for pair, total_n in zip(self._state.forces.pairs, sums_n, strict=True):
            if total_n:
                self._impulse[pair] += total_n * self._state.at.step_s
        self.most_iterations = max(self.most_iterations, int(data.solver_niter[0]))
        if data.warning.number.any():
            numbers = {kind: n for kind, n in zip(_WARNINGS, data.warning.number.tolist(), strict=True) if n}
            raise PhysicsError(f"{self._label}: MuJoCo warned after {self.n_steps} ticks: {numbers}, must not")
        if self._state.at.carrier is Carrier.NO_HAND:
            return
        self.is_stopped = self.is_stopped or sums_n[-1] > params.protective_stop_n * self._state.at.n_steps

    # ---------------------------------------------------------------- measurements
    def object_pose(self) -> Float[np.ndarray, "4 4"]:
        """T_base_object.

        Raises:
            PhysicsError: it is not finite.
        """
        q = self._state.data.qpos
        if not np.isfinite(q).all():
            raise PhysicsError(f"{self._label}: state {q.tolist()} after {self.n_steps} ticks, must be finite")
        return self._state.object_pose()

    def tcp_pose(self) -> Float[np.ndarray, "4 4"]:
        """T_base_tcp; where the hand was last, once it has left."""
        return self._state.tcp_pose()

    def inhand_pose(self) -> Float[np.ndarray, "4 4"]:
        """T_tcp_object."""
        return np.asarray(inverse(self.tcp_pose()) @ self.object_pose())

    def arm_state(self) -> tuple[Float[np.ndarray, "7"], Float[np.ndarray, "2"]]:
        """Arm configuration in radians and opening of each finger in metres, as the hand left with once it has."""
        return self._q.copy(), self._state.fingers_m()

    def impulse_n_s(self, body: str, other: str) -> float:
        """Contact impulse between "object" or "robot" and table or an obstacle since the start: the force's size summed over every step."""
        return self._impulse[body, other]

    def force_n(self, body: str, other: str) -> float:
        """Size of the net contact force of the last step: of "object" or "robot" with table or an obstacle, or of "robot" with "object"."""
        return self._state.forces.last_n(self._state.data, body, other)

    def touching(self, part: str) -> bool:
        """Whether a part of the hand ("panda_hand" or a finger) pressed on the object in the last step."""
        return self._state.forces.presses(self._state.data, part)

    @property
    def has_robot(self) -> bool:
        """Whether the hand is in the world."""
        return self._state.at.carrier is not Carrier.NO_HAND

    @property
    def fixed_bodies(self) -> tuple[str, ...]:
        """Names of the table and the obstacles."""
        return self._names

    def is_clear(self, gap_m: float) -> bool:
        """Whether hand and object are further apart than a gap."""
        return self._state.is_clear(gap_m)


def _no_log(message: str) -> None:
    """Say nothing."""
