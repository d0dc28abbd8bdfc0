"""One candidate executed by both engines with the same rigid pads, and by the engine and pads that make the labels.

Which candidates are asked about and what the answers amount to is sample.py.
"""

from __future__ import annotations

import dataclasses
from typing import cast

import numpy as np
from jaxtyping import Float
from scipy.optimize import linprog
from scipy.spatial import ConvexHull

from objects.gripper import FINGER_FROM_HAND_M, TCP_FROM_HAND_M
from objects.object_model import ObjectModel
from pipelines.codecs import Row, pose_in
from pipelines.engines.physics.hand_params import HandWorldParams
from pipelines.engines.physics.hand_world import HandWorld
from pipelines.engines.physics.pads import PAD_CENTRE_M, PAD_FACE_M, PAD_SIZE_M
from pipelines.engines.physics.phases import pose_difference
from pipelines.labels.execution import ExecutionSetup, execute_candidate
from pipelines.proofs.validity.second_engine.bullet_world import BulletHandWorld
from pipelines.values import Candidate, Motion

# Cells stand before a rigid block; without them the block is the pad, this far behind the pad's face.
BEHIND_FACE_M = 1e-5
# Rigid pads need finer steps than pads of rubber. Each engine has the one at which its own half changes little: SECOND_ENGINE.md.
MUJOCO_STEPS_PER_TICK, BULLET_STEPS_PER_TICK = 32, 8
_MEASURES = {
    "success": "y_pipe",
    "status": "exec_status",
    "margin": "tolerance_margin",
    "position_error_m": "final_position_error_m",
    "rotation_error_rad": "final_rotation_error_rad",
    "slip_m": "transport_slip_m",
    "slip_rad": "transport_slip_rad",
}


def opinion(object_model: ObjectModel, candidate: Candidate, motion: Motion, setup: ExecutionSetup) -> Row:
    """How the candidate ends with rigid pads in MuJoCo and in Bullet, and with the pads that make the labels.

    Args:
        setup: of the labels.

    Returns:
        `candidate_id`, `category`; for `mujoco`, `bullet` and `yielding` each `_success`, `_status`, `_margin`, `_position_error_m`,
        `_rotation_error_rad`, `_slip_m`, `_slip_rad`; how far apart the first two end: `apart_m`, `apart_rad`.

    Raises:
        PhysicsError: an engine warned or gave a state that is not finite; names the candidate.
    """
    held = touching(object_model, candidate)
    labels = {
        "mujoco": mujoco_row(object_model, held, motion, with_rigid_pads(setup, MUJOCO_STEPS_PER_TICK)),
        "bullet": bullet_row(object_model, held, motion, with_rigid_pads(setup, BULLET_STEPS_PER_TICK)),
        "yielding": mujoco_row(object_model, candidate, motion, setup),
    }
    T_mujoco, T_bullet = (pose_in(labels[name], "final") for name in ("mujoco", "bullet"))
    return {
        "candidate_id": candidate.candidate_id,
        "category": str(object_model.category),
        **{f"{engine}_{name}": label[column] for engine, label in labels.items() for name, column in _MEASURES.items()},
        "apart_m": pose_difference(T_mujoco, T_bullet)[0],
        "apart_rad": object_model.rotation_error_rad(T_mujoco[:3, :3], T_bullet[:3, :3]),
    }


def mujoco_row(object_model: ObjectModel, candidate: Candidate, motion: Motion, setup: ExecutionSetup) -> Row:
    """The row of `execution_labels` that MuJoCo gives."""
    with HandWorld(object_model, candidate.scene.obstacles, setup.physics) as world:
        return execute_candidate(world, candidate, motion, setup)


def bullet_row(object_model: ObjectModel, candidate: Candidate, motion: Motion, setup: ExecutionSetup) -> Row:
    """The row of `execution_labels` that Bullet gives."""
    with BulletHandWorld(object_model, candidate.scene.obstacles, setup.physics) as world:
        # It has every name that an execution asks for; phases and verdicts are the labels' own.
        return execute_candidate(cast(HandWorld, world), candidate, motion, setup)


def with_rigid_pads(setup: ExecutionSetup, steps_per_tick: int) -> ExecutionSetup:
    """The same physics on pads that are rigid boxes."""
    return dataclasses.replace(setup, physics=rigid_pads(setup.physics, steps_per_tick))


def rigid_pads(params: HandWorldParams, steps_per_tick: int) -> HandWorldParams:
    """Pads that are rigid boxes; the step is not longer than it was."""
    steps_per_tick = max(params.steps_per_tick, steps_per_tick)
    return dataclasses.replace(
        params,
        cells_per_side=0,
        pad_protrusion_m=BEHIND_FACE_M,
        steps_per_tick=steps_per_tick,
        landing_steps_per_tick=steps_per_tick,
        rounds_are_hulls=True,
    )


def touching(object_model: ObjectModel, candidate: Candidate) -> Candidate:
    """The candidate with fingers that just touch the object: yielding pads were pressed in, and rigid ones would throw it out."""
    T = candidate.grasp.T_tcp_object
    vertices_m = np.concatenate([part.vertices_m for part in object_model.parts]) @ T[:3, :3].T + T[:3, 3]
    finger_m = max(_reach_m(vertices_m, side) for side in (1.0, -1.0)) - PAD_FACE_M - BEHIND_FACE_M
    return dataclasses.replace(candidate, grasp=dataclasses.replace(candidate.grasp, fingers_m=np.full(2, finger_m)))


def _reach_m(vertices_m: Float[np.ndarray, "v 3"], side: float) -> float:
    """How far along the jaw the hull of points reaches within the pad's rectangle (a linear program)."""
    planes = ConvexHull(vertices_m).equations
    (x, z), (width_m, height_m) = PAD_CENTRE_M, PAD_SIZE_M
    z += FINGER_FROM_HAND_M - TCP_FROM_HAND_M
    bounds = [(x - width_m / 2, x + width_m / 2), (None, None), (z - height_m / 2, z + height_m / 2)]
    solution = linprog([0.0, -side, 0.0], A_ub=planes[:, :3], b_ub=-planes[:, 3], bounds=bounds)
    if not solution.success:
        raise ValueError(f"no point of the object is between the pads, must be: {solution.message}")
    return float(side * solution.x[1])
