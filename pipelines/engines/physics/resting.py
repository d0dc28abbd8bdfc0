"""Does an object stay where it is put? Lone objects on a bare table; see labels/execution.py for placements."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from pipelines.engines.physics.coming_to_rest import n_steps_of, settle
from pipelines.engines.physics.phases import pose_difference
from pipelines.engines.physics.world import PhysicsWorld


def rest_drift(
    world: PhysicsWorld, label: str, T_base_object: Float[np.ndarray, "4 4"], duration_s: float
) -> tuple[Float[np.ndarray, "4 4"] | None, tuple[float, float]]:
    """Leave the object alone for a while.

    Args:
        world: it is built anew.
        label: names the run in errors.

    Returns:
        The pose it has then (None where it still moves), and how far it moved: metres, and radians modulo its symmetry.
    """
    world.rebuild(label)
    world.set_object(T_base_object)
    for _ in range(n_steps_of(world, duration_s)):
        world.step()
    is_at_rest = settle(world, 2 * world.params.settled_checks * world.params.check_every_steps)
    T = world.object_pose()
    drift_m, _ = pose_difference(T_base_object, T)
    drift_rad = world.object_model.rotation_error_rad(T_base_object[:3, :3], T[:3, :3])
    return (T if is_at_rest else None), (drift_m, drift_rad)
