"""One physics world: table, obstacles, object and Panda in a PyBullet client of its own; see rollout.py for motions.

A state is never saved and restored (Bullet's restore is not reproducible): `rebuild` makes the world anew in a fixed order, and
what follows is bit-identical in any order and process.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import pybullet
from jaxtyping import Float

from objects.object_model import ObjectModel
from pipelines.engines.physics import building
from pipelines.engines.physics.bodies import object_body, write_arm
from pipelines.engines.physics.errors import PhysicsError
from pipelines.engines.physics.params import PhysicsParams
from pipelines.engines.robot.arm import fk
from pipelines.values import Obstacle
from tables.poses import inverse, matrix_of, pose_of

__all__ = ["FINGER_LINKS", "GRAVITY_M_S2", "PhysicsParams", "PhysicsWorld"]

GRAVITY_M_S2 = 9.81
FINGER_LINKS = ("panda_leftfinger", "panda_rightfinger")
ARM_FORCES_NM = (174.0,) * 4 + (24.0,) * 3  # twice the Panda's rated torques: the real controller compensates gravity, this one does not


class PhysicsWorld:
    """Context manager around one DIRECT client; call `rebuild` before anything else and before every new run.

    Args:
        object_model: the object.
        obstacles: box obstacles, fixed to the table.
        params: the physics recipe.
        friction_scale: multiplies the object's friction, for audits.
    """

    def __init__(
        self, object_model: ObjectModel, obstacles: Sequence[Obstacle], params: PhysicsParams, friction_scale: float = 1.0
    ) -> None:
        self.object_model, self.obstacles, self.params = object_model, tuple(obstacles), params
        self._friction = object_model.friction * friction_scale
        wanted_n = params.min_finger_force_n + params.finger_force_n_per_kg * object_model.mass_kg
        self.finger_force_n = min(wanted_n, params.max_finger_force_n)
        self._body = object_body(object_model)
        self._T_mass_object = inverse(self._body.T_object_mass)
        self._client = -1
        self._label = ""
        self._stack: tempfile.TemporaryDirectory[str] | None = None
        self._ids: dict[str, int] = {}
        self._fixed = ("table", *(f"obstacle {obstacle.obstacle_id}" for obstacle in self.obstacles))
        self.n_steps = 0
        self._pads_since: Float[np.ndarray, "4"] | None = None  # orientation of the hand when the pads' contacts were last found anew

    def __enter__(self) -> Self:
        self._stack = tempfile.TemporaryDirectory(prefix="placebench-physics-")
        folder = Path(self._stack.name)
        self._arm_urdf = str(write_arm(folder))
        self._hulls_obj = str(folder / "object.obj")
        Path(self._hulls_obj).write_text(self._body.hulls_obj)
        self._client = pybullet.connect(pybullet.DIRECT)
        if self._client < 0:
            raise PhysicsError(f"{self.object_model.object_id}: PyBullet gave no client")
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        pybullet.disconnect(physicsClientId=self._client)
        self._client = -1
        if self._stack is not None:
            self._stack.cleanup()

    def rebuild(self, label: str, *, with_robot: bool) -> None:
        """Make the world anew, always in the same order; `label` names the run in errors."""
        self._label, self.n_steps, self._ids = label, 0, {}
        self._pads_since = None
        c, p = self._client, self.params
        pybullet.resetSimulation(physicsClientId=c)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=p.dt_s,
            numSolverIterations=p.solver_iterations,
            solverResidualThreshold=p.solver_residual,
            erp=p.erp,
            contactERP=p.erp,
            frictionERP=p.erp,
            deterministicOverlappingPairs=1,
            physicsClientId=c,
        )
        pybullet.setGravity(0.0, 0.0, -GRAVITY_M_S2, physicsClientId=c)
        self._ids["table"] = building.add_table(c, p)
        for obstacle in self.obstacles:
            name = f"obstacle {obstacle.obstacle_id}"
            self._ids[name] = building.add_box(c, p, obstacle.size_m / 2, obstacle.T_base_obstacle)
        try:
            self._ids["object"] = building.add_object(c, self._body, self.object_model.mass_kg, self._friction, self._hulls_obj)
        except pybullet.error as error:
            raise PhysicsError(
                f"{label}: {self.object_model.object_id} with {len(self.object_model.parts)} convex parts: {error}"
            ) from error
        if with_robot:
            self._robot = building.add_robot(c, p, self._arm_urdf)
            self._ids["robot"] = self._robot.body

    def remove_robot(self) -> None:
        """Take the arm out of the world: the object moves on alone, at a third of the cost."""
        robot = self._ids.pop("robot", None)
        if robot is not None:
            pybullet.removeBody(robot, physicsClientId=self._client)

    def step(self) -> None:
        """One time step."""
        if self.has_robot and self.n_steps % self.params.check_every_steps == 0:
            self._refresh_pads()
        pybullet.stepSimulation(physicsClientId=self._client)
        self.n_steps += 1

    def _refresh_pads(self) -> None:
        """Find the contacts of the pads anew once the hand has turned.

        Bullet keeps a contact's normal in the base frame for as long as the contact lasts. A hand that turns would leave the normals of
        its pads behind until they point the wrong way, and hold the object fast when the fingers open. A refreshed proxy has no contacts.
        It has lost what its anchors remember, too: a hand that does not turn is left alone.
        """
        now = np.array(pybullet.getLinkState(self._robot.body, self._robot.links["panda_hand"], physicsClientId=self._client)[1])
        if self._pads_since is None:
            self._pads_since = now
        if 2.0 * math.acos(min(1.0, abs(float(now @ self._pads_since)))) > self.params.pad_refresh_rad:
            self._pads_since = now
            for finger in self._robot.fingers:
                pybullet.setCollisionFilterGroupMask(self._robot.body, finger, 1, -1, physicsClientId=self._client)

    def set_object(self, T_base_object: Float[np.ndarray, "4 4"]) -> None:
        """Put the object at a pose, at rest."""
        pose = pose_of(T_base_object @ self._body.T_object_mass)
        # PyBullet's base pose is the mass frame, not the object frame.
        pybullet.resetBasePositionAndOrientation(self._ids["object"], pose[:3].tolist(), pose[3:].tolist(), physicsClientId=self._client)
        pybullet.resetBaseVelocity(self._ids["object"], [0.0] * 3, [0.0] * 3, physicsClientId=self._client)

    def object_pose(self) -> Float[np.ndarray, "4 4"]:
        """T_base_object.

        Raises:
            PhysicsError: the pose is not finite.
        """
        position, quaternion = pybullet.getBasePositionAndOrientation(self._ids["object"], physicsClientId=self._client)
        pose = np.array([*position, *quaternion])
        if not np.all(np.isfinite(pose)) or np.abs(pose[:3]).max() > 1e3:
            raise PhysicsError(f"{self._label}: object pose {pose.tolist()} after {self.n_steps} steps, must be finite and within 1000 m")
        T_base_object: Float[np.ndarray, "4 4"] = matrix_of(pose) @ self._T_mass_object
        return T_base_object

    def set_arm(self, q: Float[np.ndarray, "7"], fingers_m: Sequence[float]) -> None:
        """Put arm and fingers (opening of each) at rest at a configuration and command both to stay."""
        for joint, value in zip(self._robot.joints, (*q, *fingers_m), strict=True):
            pybullet.resetJointState(self._robot.body, joint, float(value), 0.0, physicsClientId=self._client)
        self.command_arm(q.tolist(), [0.0] * 7)
        self.command_fingers(0.0)
        self._pads_since = None

    def command_arm(self, q: Sequence[float], qd: Sequence[float]) -> None:
        """Position targets with velocity feed-forward; they hold until the next command."""
        pybullet.setJointMotorControlArray(
            self._robot.body,
            self._robot.arm,
            pybullet.POSITION_CONTROL,
            targetPositions=q,
            targetVelocities=qd,
            positionGains=[self.params.arm_position_gain] * 7,
            velocityGains=[self.params.arm_velocity_gain] * 7,
            forces=ARM_FORCES_NM,
            physicsClientId=self._client,
        )

    def command_fingers(self, speed_m_s: float) -> None:
        """Speed of each finger, positive opens; a blocked finger presses with the grip force at most."""
        pybullet.setJointMotorControlArray(
            self._robot.body,
            self._robot.fingers,
            pybullet.VELOCITY_CONTROL,
            targetVelocities=[speed_m_s] * 2,
            forces=[self.finger_force_n] * 2,
            physicsClientId=self._client,
        )

    def grip(self) -> None:
        """Let both fingers, which touch the object, press with the grip force from now on."""
        self.command_fingers(-self.params.grip_speed_m_s)

    def arm_state(self) -> tuple[Float[np.ndarray, "7"], Float[np.ndarray, "2"]]:
        """Measured arm configuration in radians and opening of each finger in metres."""
        states = pybullet.getJointStates(self._robot.body, self._robot.joints, physicsClientId=self._client)
        q = np.array([state[0] for state in states])
        if not np.all(np.isfinite(q)):
            raise PhysicsError(f"{self._label}: joint positions {q.tolist()} after {self.n_steps} steps, must be finite")
        return q[:7], q[7:]

    def tcp_pose(self) -> Float[np.ndarray, "4 4"]:
        """T_base_tcp of the measured configuration."""
        return fk(self.arm_state()[0])

    def inhand_pose(self) -> Float[np.ndarray, "4 4"]:
        """T_tcp_object, measured."""
        T_tcp_object: Float[np.ndarray, "4 4"] = inverse(self.tcp_pose()) @ self.object_pose()
        return T_tcp_object

    def force_n(self, body: str, other: str, link: str | None = None) -> float:
        """Sum of normal contact forces between two bodies in the last step, in newton.

        Args:
            body: "object" or "robot".
            other: "object", "table", "obstacle 0", ...
            link: only this link of the robot.
        """
        return float(sum(point[9] for point in self._points(body, other, link)))

    def is_clear(self, gap_m: float) -> bool:
        """Whether robot and object are further apart than a gap."""
        a, b = self._ids["robot"], self._ids["object"]
        return not pybullet.getClosestPoints(a, b, gap_m, physicsClientId=self._client)

    def n_contacts(self, body: str, other: str) -> int:
        """Contact points between two bodies in the last step."""
        return len(self._points(body, other, None))

    @property
    def has_robot(self) -> bool:
        """Whether the robot is in the world."""
        return "robot" in self._ids

    @property
    def fixed_bodies(self) -> tuple[str, ...]:
        """Names of the table and the obstacles."""
        return self._fixed

    def _points(self, body: str, other: str, link: str | None) -> Sequence[Any]:
        a, b = self._ids.get(body), self._ids.get(other)
        if a is None or b is None:
            return ()
        if link is None:
            return pybullet.getContactPoints(bodyA=a, bodyB=b, physicsClientId=self._client) or ()
        return pybullet.getContactPoints(bodyA=a, bodyB=b, linkIndexA=self._robot.links[link], physicsClientId=self._client) or ()
