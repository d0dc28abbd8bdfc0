"""What a planned motion asks of a rigid grip against what Coulomb's pads can give; no engine, no contact.

The limit surface of a pad is an ellipse in tangential force t and torque m about the jaw axis, (t / mu F)^2 + (m / mu F L)^2 (Howe and
Cutkosky, "Practical force-motion models for sliding manipulation", 1996). Both pads take half of the inertial force, and of the torque by
their levers. Tilting about the other axes is left to the pads' width.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from objects.object_model import ObjectModel
from pipelines.engines.physics.hand_motion import HandMotion, hand_motion
from pipelines.engines.physics.hand_params import HandWorldParams
from pipelines.engines.physics.hand_world import GRAVITY_M_S2
from pipelines.engines.physics.pads import PAD_SIZE_M, even_pressure_lever_m, winkler_lever_m
from pipelines.engines.planning.trajectory import MotionParams, time_path
from pipelines.proofs.validity.contact_patch import ContactPatch
from pipelines.values import LiftedGrasp, Motion
from tables.vocabulary import Category


def carried(motion: Motion, timing: MotionParams, tick_s: float) -> tuple[HandMotion, HandMotion]:
    """The hand in transport and descend, while it carries."""
    transport = time_path(motion.transport_q_rad, timing, tick_s, stop_at_waypoints=True)
    descend = time_path(motion.descend_q_rad, timing, tick_s, stop_at_waypoints=False)
    return hand_motion(transport, tick_s), hand_motion(descend, tick_s)


def demand_ratio(
    patch: ContactPatch, object_model: ObjectModel, grasp: LiftedGrasp, hands: Sequence[HandMotion], params: HandWorldParams
) -> float:
    """Largest share of a pad's limit surface that some motions of the hand take: 1 is the bound of sticking.

    Args:
        patch: where the pads press in this hold, and what the grip takes by itself.
    """
    pad_n = capacity_n(object_model, params) / 2
    worst = 0.0
    for hand in hands:
        force_n, torque_n_m = _wrench(hand, patch.centre_m, object_model, grasp)
        turning = torque_n_m / (pad_n * sum(patch.levers_m))
        for sign in (1.0, -1.0):
            sliding = np.linalg.norm(force_n / 2 + sign * patch.preload_n, axis=1) / pad_n
            worst = max(worst, float(np.hypot(sliding, turning).max(initial=0.0)))
    return worst


def demand_ratio_even_pads(object_model: ObjectModel, grasp: LiftedGrasp, hands: Sequence[HandMotion], params: HandWorldParams) -> float:
    """The same of a grip that is pressed evenly: the lever of a flat face for boxes, of a strip across the pad for what is round."""
    lever_m = winkler_lever_m(0.033, False, params.finger_force_n, params.pad_stiffness_n_m)
    if object_model.category == Category.CUBOID:
        lever_m = even_pressure_lever_m(*PAD_SIZE_M)
    whole_n, worst = capacity_n(object_model, params), 0.0
    for hand in hands:
        force_n, torque_n_m = _wrench(hand, np.zeros(3), object_model, grasp)
        ratio = np.hypot(np.linalg.norm(force_n, axis=1), torque_n_m / (params.pad_lever_scale * lever_m)) / whole_n
        worst = max(worst, float(ratio.max(initial=0.0)))
    return worst


def capacity_n(object_model: ObjectModel, params: HandWorldParams) -> float:
    """2 mu F: the tangential force that both pads bear together."""
    return 2.0 * params.pad_friction * params.friction_scale * object_model.friction * params.finger_force_n


def _wrench(
    hand: HandMotion, centre_m: Float[np.ndarray, "3"], object_model: ObjectModel, grasp: LiftedGrasp
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n"]]:
    """Of every tick: the force in the pads' plane (x and z of the hand), and the torque about its y through a point."""
    R, com = grasp.T_tcp_object[:3, :3], grasp.T_tcp_object[:3, :3] @ object_model.com_m + grasp.T_tcp_object[:3, 3]
    I = R @ object_model.inertia_kg_m2 @ R.T
    felt = hand.acceleration_m_s2 + hand.position_gain_1_s2 @ com + GRAVITY_M_S2 * hand.R_mid[:, 2]
    force = object_model.mass_kg * felt
    L = hand.rate_rad_s @ I
    torque = hand.angular_acceleration_rad_s2 @ I + np.cross(hand.rate_rad_s, L) + np.cross(com - centre_m, force)
    return force[:, [0, 2]], torque[:, 1]
