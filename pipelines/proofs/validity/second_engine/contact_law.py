"""How far MuJoCo's contacts yield, in newton and metres, so that Bullet's can be given the same; the models are hand_model.py's.

Four corners of a rigid pad on a face are one too many: theory leaves open which of them bears how much, Bullet's iterations then give
nearly all to whichever comes first, and a pad on one corner is an axle. Contacts that yield by some micrometres share evenly.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco

from pipelines.engines.physics.hand_model import SceneModel

PAD_GEOM, TABLE_GEOM, PALM_GEOM = "panda_leftfinger 0", "table", "panda_hand 0"
# Of the hand's contacts, of what MuJoCo's have. What is pressed has long come to rest: damping only makes the iterations converge slower.
_HAND_DAMPING_SHARE = 0.1


@dataclass(frozen=True, slots=True)
class ContactYield:
    """Spring and damper of one contact point."""

    stiffness_n_m: float
    damping_n_s_m: float


@dataclass(frozen=True, slots=True)
class ContactLaw:
    """Of what stands on the table or meets an obstacle, of what the pads and bare fingers hold, of what meets the palm."""

    fixed: ContactYield
    finger: ContactYield
    palm: ContactYield


def contact_law(scene: SceneModel) -> ContactLaw:
    """Read it from a compiled model with a hand that slides."""
    return ContactLaw(
        _yield_of(scene, TABLE_GEOM, 1.0), _yield_of(scene, PAD_GEOM, _HAND_DAMPING_SHARE), _yield_of(scene, PALM_GEOM, _HAND_DAMPING_SHARE)
    )


def _yield_of(scene: SceneModel, geom_name: str, damping_share: float) -> ContactYield:
    """MuJoCo's contact force f obeys  a + R f = -b v - k r  with R = (1 - d) / d x A, A the two bodies' inverse masses ("Computation",
    solver parameters): where a is small, it is a spring of k / R and a damper of b / R. For solref with a time constant and constant d."""
    model: mujoco.MjModel = scene.model
    geom = int(model.geom(geom_name).id)
    time_s, ratio = (float(value) for value in model.geom_solref[geom])
    d = float(model.geom_solimp[geom, 1])
    A = float(model.body_invweight0[scene.object_body, 0] + model.body_invweight0[model.geom_bodyid[geom], 0])
    R = (1.0 - d) / d * A
    return ContactYield(1.0 / (d * time_s * ratio) ** 2 / R, damping_share * 2.0 / (d * time_s) / R)
