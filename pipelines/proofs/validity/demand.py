"""What a planned motion asks of a rigid grip against what Coulomb's pads can give; no engine, no contact."""

from __future__ import annotations

import numpy as np

from objects.object_model import ObjectModel
from pipelines.engines.physics.hand_motion import hand_motion
from pipelines.engines.physics.hand_params import HandWorldParams
from pipelines.engines.physics.hand_world import GRAVITY_M_S2
from pipelines.engines.physics.pads import PAD_SIZE_M, even_pressure_lever_m, winkler_lever_m
from pipelines.engines.planning.trajectory import MotionParams, time_path
from pipelines.values import LiftedGrasp, Motion
from tables.vocabulary import Category


def demand_ratio(object_model: ObjectModel, grasp: LiftedGrasp, motion: Motion, timing: MotionParams, params: HandWorldParams) -> float:
    """Largest share of the grip's capacity that transport and descend take: 1 is the bound of sticking.

    Tangential force t and torque m about the jaw axis together, by the ellipse (t / 2 mu F)^2 + (m / 2 mu F L)^2 (Howe and Cutkosky,
    "Practical force-motion models for sliding manipulation", 1996). Tilting about the other axes is left to the pads' width.
    """
    capacity_n = 2.0 * params.pad_friction * params.friction_scale * object_model.friction * params.finger_force_n
    lever_m = params.pad_lever_scale * _lever_m(object_model, params)
    R, com = grasp.T_tcp_object[:3, :3], grasp.T_tcp_object[:3, :3] @ object_model.com_m + grasp.T_tcp_object[:3, 3]
    I = R @ object_model.inertia_kg_m2 @ R.T
    worst = 0.0
    for q, stops in ((motion.transport_q_rad, True), (motion.descend_q_rad, False)):
        hand = hand_motion(time_path(q, timing, params.dt_s, stop_at_waypoints=stops), params.dt_s)
        felt = hand.acceleration_m_s2 + hand.position_gain_1_s2 @ com + GRAVITY_M_S2 * hand.R_mid[:, 2]
        force = object_model.mass_kg * felt
        L = hand.rate_rad_s @ I
        torque = hand.angular_acceleration_rad_s2 @ I + np.cross(hand.rate_rad_s, L) + np.cross(com, force)
        tangential = np.hypot(force[:, 0], force[:, 2]) / capacity_n
        turning = torque[:, 1] / (capacity_n * lever_m)
        worst = max(worst, float(np.hypot(tangential, turning).max(initial=0.0)))
    return worst


def _lever_m(object_model: ObjectModel, params: HandWorldParams) -> float:
    """Of a flat face for boxes, of a strip across the pad for what is round."""
    if object_model.category == Category.CUBOID:
        return even_pressure_lever_m(*PAD_SIZE_M)
    return winkler_lever_m(0.033, False, params.finger_force_n, params.pad_stiffness_n_m)
