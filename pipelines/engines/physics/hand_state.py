"""State of hand and object in the model in charge, in the frame that it has; what happens in time is hand_world.py's."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from jaxtyping import Float

from objects.object_model import ObjectModel
from pipelines.engines.physics.contact_forces import ContactForces
from pipelines.engines.physics.hand_model import Carrier, SceneModel, build_model
from pipelines.engines.physics.hand_motion import cross
from pipelines.engines.physics.hand_params import HandWorldParams
from pipelines.values import GRAVITY_M_S2, Obstacle
from tables.poses import inverse, pose_of

GRAVITY = np.array([0.0, 0.0, -GRAVITY_M_S2])
_WXYZ = np.array([6, 3, 4, 5])


class HandState:
    """One object, its hand and its obstacles; models are compiled when they are first needed and kept, every `enter` has a fresh mjData.

    Attributes:
        T_base_hand: where the hand is, or was when it left.
        left_fingers_m: opening of each finger when the hand left.

    Attributes from the first `enter` on:
        at: the model in charge.
        data: its MuJoCo state.
        forces: reads its contact forces.
        T_base_frame: the frame of the simulation.
        velocity_m_s, rate_rad_s: of that frame with respect to the base, in its own axes.
    """

    def __init__(self, object_model: ObjectModel, obstacles: Sequence[Obstacle], params: HandWorldParams) -> None:
        self._object_model, self._obstacles, self._params = object_model, obstacles, params
        self._scenes: dict[Carrier, SceneModel] = {}
        self.T_base_hand: Float[np.ndarray, "4 4"] = np.eye(4)
        self.left_fingers_m: Float[np.ndarray, "2"] = np.zeros(2)

    def forget_models(self) -> None:
        """Free the compiled models."""
        self._scenes.clear()

    # ---------------------------------------------------------------- frames
    def enter(self, carrier: Carrier) -> None:
        """Go on in another model, in the frame that the hand has now (or the base frame); fingers stay, the object must be put."""
        if carrier not in self._scenes:
            self._scenes[carrier] = build_model(self._object_model, self._obstacles, self._params, carrier)
        self.at = at = self._scenes[carrier]
        self.data = mujoco.MjData(at.model)
        self.T_base_frame = np.eye(4) if carrier is Carrier.NO_HAND else self.T_base_hand.copy()
        self.velocity_m_s, self.rate_rad_s = np.zeros(3), np.zeros(3)
        self.turn_gravity()
        self.place_environment(pose_of(inverse(self.T_base_frame)))
        self.forces = ContactForces(at, at.n_steps)

    def change(self, carrier: Carrier) -> None:
        """Carry the state over to another model; the hand is at rest, or leaves."""
        if carrier is self.at.carrier:
            return
        T_base_object, T_tcp_object = self.object_pose(), None
        before, data = self.at, self.data
        v, w = self.object_twist()
        if carrier is Carrier.NO_HAND:
            self.left_fingers_m = self.fingers_m()
        else:
            T_tcp_object = inverse(self.tcp_pose()) @ T_base_object
            fingers = data.qpos[before.finger_q,], data.qvel[before.finger_v,]
        R = self.T_base_frame[:3, :3]
        self.enter(carrier)
        if T_tcp_object is None:
            self.put_object(T_base_object)
        else:
            self.put_object(T_tcp_object)
            self.data.qpos[self.at.finger_q,], self.data.qvel[self.at.finger_v,] = fingers
        at, to = self.at, self.T_base_frame[:3, :3].T @ R
        # Turn rates of a free body are in its own axes.
        self.data.qvel[at.object_v : at.object_v + 6] = [*(to @ v), *w]

    def turn_gravity(self) -> None:
        """Give the model in charge gravity in its frame's axes."""
        self.at.model.opt.gravity[:] = self.T_base_frame[:3, :3].T @ GRAVITY

    def place_environment(self, frame_base_pose: Float[np.ndarray, "7"]) -> None:
        """Put table and obstacles where the base is in the frame."""
        self.data.mocap_pos[0], self.data.mocap_quat[0] = frame_base_pose[:3], frame_base_pose[_WXYZ]

    # ---------------------------------------------------------------- the object and the hand
    def put_object(self, T_frame_object: Float[np.ndarray, "4 4"]) -> None:
        """Put the object somewhere in the frame; its velocity stays."""
        pose, a = pose_of(T_frame_object), self.at.object_q
        self.data.qpos[a : a + 7] = [*pose[:3], pose[6], *pose[3:6]]

    def fingers_m(self) -> Float[np.ndarray, "2"]:
        """Opening of each finger; as the hand left with, once it has."""
        if self.at.carrier is Carrier.NO_HAND:
            return self.left_fingers_m.copy()
        return np.asarray(self.data.qpos[self.at.finger_q,].copy())

    def object_rotation(self) -> Float[np.ndarray, "3 3"]:
        """R_frame_object."""
        R, a = np.empty(9), self.at.object_q
        mujoco.mju_quat2Mat(R, self.data.qpos[a + 3 : a + 7])
        return R.reshape(3, 3)

    def object_in_frame(self) -> Float[np.ndarray, "4 4"]:
        """T_frame_object."""
        T, a = np.eye(4), self.at.object_q
        T[:3, :3], T[:3, 3] = self.object_rotation(), self.data.qpos[a : a + 3]
        return T

    def object_pose(self) -> Float[np.ndarray, "4 4"]:
        """T_base_object."""
        return np.asarray(self.T_base_frame @ self.object_in_frame())

    def object_twist(self) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
        """Velocity of the object's origin with respect to the base, in the frame's axes, and rate of turn in the object's axes."""
        at, data = self.at, self.data
        r = data.qpos[at.object_q : at.object_q + 3]
        R_frame_object = self.object_in_frame()[:3, :3]
        v = data.qvel[at.object_v : at.object_v + 3] + self.velocity_m_s + cross(self.rate_rad_s, r)
        return v, data.qvel[at.object_v + 3 : at.object_v + 6] + R_frame_object.T @ self.rate_rad_s

    def tcp_pose(self) -> Float[np.ndarray, "4 4"]:
        """T_base_tcp; where the hand was last, once it has left."""
        T: Float[np.ndarray, "4 4"] = self.T_base_hand.copy()
        if self.at.carrier.is_sliding:
            # A line keeps the orientation with which it began.
            T[:3, :3] = self.T_base_frame[:3, :3]
        return T

    def is_clear(self, gap_m: float) -> bool:
        """Whether hand and object are further apart than a gap."""
        model, data = self.at.model, self.data
        mujoco.mj_kinematics(model, data)
        hand, part = sorted(self.at.hand_geoms), sorted(self.at.object_geoms)
        apart = np.linalg.norm(data.geom_xpos[hand][:, None] - data.geom_xpos[part], axis=-1)
        near = np.argwhere(apart - model.geom_rbound[hand][:, None] - model.geom_rbound[part] <= gap_m)
        return all(mujoco.mj_geomDistance(model, data, hand[a], part[b], 1.01 * gap_m, None) > gap_m for a, b in near.tolist())
