"""What a grip bears against what Coulomb says: weightless flat objects pulled and twisted between the pads until they move."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from objects.object_model import ObjectModel
from pipelines.codecs import Row
from pipelines.engines.physics.hand_params import HandWorldParams
from pipelines.engines.physics.hand_world import HandWorld
from pipelines.engines.physics.pads import PAD_SIZE_M, even_pressure_lever_m
from pipelines.engines.physics.phases import pose_difference
from pipelines.engines.robot.arm import HOME_Q_RAD
from pipelines.proofs.validity.demand import capacity_n
from pipelines.proofs.validity.study import Numbers, Study, StudyUnit
from pipelines.proofs.validity.subject import TAKE_GAP_M, Subject

# In the plane of the pads: across the fingers, along them, and between.
DIRECTIONS = ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.7071067811865476, 0.0, 0.7071067811865476))
# Motion that tells slipping from what pads yield and creep before it (micrometres).
SLIPPED_M, SLIPPED_RAD = 2e-4, 0.005
# Slow: a load that grows by theory's bound in 4 s is 1 to 2 % beyond the true one when the slip is seen.
RAMP_S = 4.0
MOST = 1.5  # of theory's bound that is tried


def pull_out_study(subject: Subject) -> Study:
    """Flat objects in every direction."""
    physics = subject.recipe.hand_physics
    units = tuple(
        StudyUnit(f"{model.object_id} {k}", (model, direction, physics))
        for model in subject.flat_objects()
        for k, direction in enumerate(DIRECTIONS)
    )
    return Study("pull_out", units, pull_out_row, pull_out_summary, unit_ms=200.0)


def pull_out_row(object_model: ObjectModel, direction: tuple[float, float, float], params: HandWorldParams) -> Row:
    """Of one object in one direction; an object that does not slip has the most that was tried."""
    ratio = pull_out_ratio(object_model, direction, params)
    return {"object_id": object_model.object_id, "direction": list(direction), "ratio": min(ratio, MOST)}


def pull_out_summary(rows: Sequence[Row]) -> Numbers:
    """Least and most of 2 mu F."""
    ratios = [row["ratio"] for row in rows]
    return {"pullout_ratio_min": min(ratios), "pullout_ratio_max": max(ratios), "n_pullout": float(len(ratios))}


def torsion_study(subject: Subject) -> Study:
    """Flat objects, about the jaw axis."""
    physics = subject.recipe.hand_physics
    units = tuple(StudyUnit(model.object_id, (model, physics)) for model in subject.flat_objects())
    return Study("torsion", units, torsion_row, torsion_summary, unit_ms=200.0)


def torsion_row(object_model: ObjectModel, params: HandWorldParams) -> Row:
    """Of one object; an object that does not turn has the most that was tried."""
    ratio = torsion_lever_m(object_model, params) / stated_lever_m(params)
    return {"object_id": object_model.object_id, "lever_ratio": min(ratio, MOST)}


def torsion_summary(rows: Sequence[Row]) -> Numbers:
    """Least and most of the stated lever."""
    ratios = [row["lever_ratio"] for row in rows]
    return {"torsion_lever_ratio_min": min(ratios), "torsion_lever_ratio_max": max(ratios), "n_torsion": float(len(ratios))}


def pull_out_ratio(object_model: ObjectModel, direction: tuple[float, float, float], params: HandWorldParams) -> float:
    """Force through the pads' centre at which the object slips, over 2 mu F; infinite where it does not slip at 1.5."""
    axis = np.array(direction)
    return _ramp(object_model, params, axis * capacity_n(object_model, params), np.zeros(3))


def torsion_lever_m(object_model: ObjectModel, params: HandWorldParams) -> float:
    """Torque about the jaw axis at which the object turns, over 2 mu F; infinite where it does not at 1.5 times the stated lever."""
    stated_m = stated_lever_m(params)
    torque = np.array([0.0, capacity_n(object_model, params) * stated_m, 0.0])
    return _ramp(object_model, params, np.zeros(3), torque) * stated_m


def stated_lever_m(params: HandWorldParams) -> float:
    """Of an evenly pressed pad on a flat face."""
    return params.pad_lever_scale * even_pressure_lever_m(*PAD_SIZE_M)


def _ramp(object_model: ObjectModel, params: HandWorldParams, force_n: Float[np.ndarray, "3"], torque_n_m: Float[np.ndarray, "3"]) -> float:
    """Share of a load at which the object moves, grown from 0 to one and a half of it."""
    T, width_m = across_the_jaw(object_model)
    with HandWorld(object_model, (), params) as world:
        world.start_taking(object_model.object_id, HOME_Q_RAD, width_m / 2 + TAKE_GAP_M, T, 0.3)
        T_start = world.inhand_pose()
        n = round(MOST * RAMP_S / params.dt_s)
        for k in range(1, n + 1):
            share = MOST * k / n
            world.load(share * force_n, share * torque_n_m, is_weightless=True)
            world.step()
            moved_m, turned_rad = pose_difference(T_start, world.inhand_pose())
            if moved_m > SLIPPED_M or turned_rad > SLIPPED_RAD:
                return share
    return float("inf")


def across_the_jaw(object_model: ObjectModel) -> tuple[Float[np.ndarray, "4 4"], float]:
    """Pose in the hand of a box whose thinnest side is between the pads and whose faces cover them, and that side's length."""
    vertices_m = np.concatenate([part.vertices_m for part in object_model.parts])
    size_m = np.ptp(vertices_m, axis=0)
    order = np.argsort(size_m)
    thin, middle, long = (np.eye(3)[axis] for axis in order)
    # Object axes in the hand: thin along the jaw (y), long along the fingers (z).
    R = np.outer([0.0, 1.0, 0.0], thin) + np.outer([0.0, 0.0, 1.0], long) + np.outer([1.0, 0.0, 0.0], middle)
    R = R if np.linalg.det(R) > 0 else R - 2.0 * np.outer([1.0, 0.0, 0.0], middle)
    T = np.eye(4)
    turned_m = vertices_m @ R.T
    T[:3, :3], T[:3, 3] = R, -(turned_m.min(axis=0) + turned_m.max(axis=0)) / 2
    # Its upper end stays below the palm.
    T[2, 3] = -turned_m[:, 2].min() - min(0.03, float(np.ptp(turned_m[:, 2])) / 2)
    return T, float(size_m[order[0]])
