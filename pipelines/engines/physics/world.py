"""An object alone with table and obstacles, in a PyBullet client of its own; what a hand holds is hand_world.py's.

A state is never saved and restored (Bullet's restore is not reproducible): `rebuild` makes the world anew in a fixed order, and
what follows is bit-identical in any order and process.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from jaxtyping import Float

from objects.object_model import ObjectModel
from pipelines.engines.bullet import pybullet
from pipelines.engines.physics import building
from pipelines.engines.physics.bodies import object_body
from pipelines.engines.physics.errors import PhysicsError
from pipelines.engines.physics.params import PhysicsParams
from pipelines.values import GRAVITY_M_S2, Obstacle
from tables.poses import inverse, matrix_of, pose_of

# Bullet's default, said aloud: it is one number for all worlds of a process, and another world may have left another.
_BREAKING_M = 0.02


class PhysicsWorld:
    """Context manager around one DIRECT client; call `rebuild` before anything else and before every new run.

    Args:
        object_model: the object.
        obstacles: box obstacles, fixed to the table.
        params: the physics recipe.
    """

    def __init__(self, object_model: ObjectModel, obstacles: Sequence[Obstacle], params: PhysicsParams) -> None:
        self.object_model, self.obstacles, self.params = object_model, tuple(obstacles), params
        self._body = object_body(object_model)
        self._T_mass_object = inverse(self._body.T_object_mass)
        self._client = -1
        self._label = ""
        self._stack: tempfile.TemporaryDirectory[str] | None = None
        self._ids: dict[str, int] = {}
        self.n_steps = 0

    def __enter__(self) -> Self:
        self._stack = tempfile.TemporaryDirectory(prefix="placebench-physics-")
        self._hulls_obj = str(Path(self._stack.name) / "object.obj")
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

    def rebuild(self, label: str) -> None:
        """Make the world anew, always in the same order; `label` names the run in errors."""
        self._label, self.n_steps, self._ids = label, 0, {}
        c, p = self._client, self.params
        pybullet.resetSimulation(physicsClientId=c)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=p.dt_s,
            numSolverIterations=p.solver_iterations,
            solverResidualThreshold=p.solver_residual,
            erp=p.erp,
            contactERP=p.erp,
            frictionERP=p.erp,
            contactBreakingThreshold=_BREAKING_M,
            deterministicOverlappingPairs=1,
            physicsClientId=c,
        )
        pybullet.setGravity(0.0, 0.0, -GRAVITY_M_S2, physicsClientId=c)
        self._ids["table"] = building.add_table(c, p)
        for obstacle in self.obstacles:
            name = f"obstacle {obstacle.obstacle_id}"
            self._ids[name] = building.add_box(c, p, obstacle.size_m / 2, obstacle.T_base_obstacle)
        try:
            self._ids["object"] = building.add_object(c, self._body, self.object_model.mass_kg, self.object_model.friction, self._hulls_obj)
        except pybullet.error as error:
            raise PhysicsError(
                f"{label}: {self.object_model.object_id} with {len(self.object_model.parts)} convex parts: {error}"
            ) from error

    def step(self) -> None:
        """One time step."""
        pybullet.stepSimulation(physicsClientId=self._client)
        self.n_steps += 1

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
