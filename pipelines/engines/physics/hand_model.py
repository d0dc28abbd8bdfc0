"""Builds the MuJoCo models of one scene: the hand at rest in its own frame, the hand that slides, no hand.

What stands in them is hand_bodies.py, stepping is hand_world.py. All three hold the object as a free body of its exact convex parts with
the catalogue's mass, centre of mass and inertia, and table and obstacles as one mocap body. Links 5 to 7 of the arm do not collide here:
the planner keeps them off everything and the path audit rechecks the executed path; so does the palm against table and obstacles while
the hand turns.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import mujoco

from objects.object_model import ObjectModel
from pipelines.engines.physics.errors import PhysicsError
from pipelines.engines.physics.hand_bodies import FINGERS, HAND_PARTS, SLIDES, add_environment, add_hand, add_object, fixed_bodies
from pipelines.engines.physics.hand_params import HandWorldParams
from pipelines.values import Obstacle

# How fast a pad's contact takes up speed, 1/s: below 1 / step. With stiffness and relaxation given it moves nothing else but the condition
# of the solver's matrix.
PAD_RATE_PER_S = 800.0


class Carrier(StrEnum):
    """What moves with respect to the frame of the simulation."""

    HAND_FRAME = "hand_frame"  # the frame is the hand's: the hand is at rest in it, table and obstacles go by
    REST_FRAME = "rest_frame"  # the frame is at rest: the hand slides in it
    LANDING = "landing"  # the same in finer steps: the hand lets go, and what it held lands
    NO_HAND = "no_hand"  # the base frame, the object alone, in the steps of a landing

    @property
    def is_sliding(self) -> bool:
        """Whether the hand slides in a frame at rest."""
        return self in (Carrier.REST_FRAME, Carrier.LANDING)

    @property
    def is_let_go(self) -> bool:
        """Whether the hand lets the object go, or has left it."""
        return self in (Carrier.LANDING, Carrier.NO_HAND)

    def steps_per_tick(self, params: HandWorldParams) -> int:
        """Contact steps of a tick."""
        return params.landing_steps_per_tick if self.is_let_go else params.steps_per_tick


@dataclass(frozen=True, slots=True)
class SceneModel:
    """A compiled model, and where its parts are in MuJoCo's arrays."""

    model: mujoco.MjModel
    carrier: Carrier
    n_steps: int  # of a tick
    step_s: float
    object_body: int
    object_q: int
    object_v: int
    finger_q: tuple[int, ...]
    finger_v: tuple[int, ...]
    slide_q: tuple[int, ...]
    slide_v: tuple[int, ...]
    sensor_adr: dict[str, int]
    object_geoms: frozenset[int]
    hand_geoms: frozenset[int]


def build_model(object_model: ObjectModel, obstacles: Sequence[Obstacle], params: HandWorldParams, carrier: Carrier) -> SceneModel:
    """Compile one model.

    Raises:
        PhysicsError: MuJoCo refuses it; names the object.
    """
    try:
        model = mujoco.MjModel.from_xml_string(_xml(object_model, obstacles, params, carrier))
    except ValueError as error:
        raise PhysicsError(f"{object_model.object_id} with {len(object_model.parts)} convex parts, {carrier.value}: {error}") from error
    _set_pad_yield(model, params)
    names = [model.geom(k).name for k in range(model.ngeom)]
    has_hand = carrier is not Carrier.NO_HAND
    slides = SLIDES if carrier.is_sliding else ()

    def at(field: str, joints: Sequence[str]) -> tuple[int, ...]:
        return tuple(int(getattr(model.joint(name), field)[0]) for name in joints)

    return SceneModel(
        model=model,
        carrier=carrier,
        n_steps=carrier.steps_per_tick(params),
        step_s=float(model.opt.timestep),
        object_body=int(model.body("object").id),
        object_q=at("qposadr", ["object"])[0],
        object_v=at("dofadr", ["object"])[0],
        finger_q=at("qposadr", FINGERS if has_hand else ()),
        finger_v=at("dofadr", FINGERS if has_hand else ()),
        slide_q=at("qposadr", slides),
        slide_v=at("dofadr", slides),
        sensor_adr={model.sensor(k).name: k for k in range(model.nsensor)},
        object_geoms=frozenset(k for k, name in enumerate(names) if name.startswith("part ")),
        hand_geoms=frozenset(k for k, name in enumerate(names) if name.startswith("panda_")),
    )


def _xml(object_model: ObjectModel, obstacles: Sequence[Obstacle], params: HandWorldParams, carrier: Carrier) -> str:
    root = ET.Element("mujoco")
    ET.SubElement(root, "compiler", angle="radian", autolimits="true", inertiafromgeom="false")
    option = ET.SubElement(
        root,
        "option",
        timestep=repr(params.dt_s / carrier.steps_per_tick(params)),
        # Whatever is damped implicitly outside of the constraint solver (implicitfast) is not what the solver reckoned with: pads
        # then stay pressed in by 0.3 mm under forces that belong to 0.04. Here nothing is.
        integrator="Euler",
        cone="elliptic",
        solver="Newton",
        # MuJoCo 4.0.0 factorises sparse Hessians wrongly (its issue 3767); a dozen degrees of freedom are dense anyway.
        jacobian="dense",
        impratio=repr(params.friction_stiffness_ratio),
        iterations=str(params.solver_iterations),
        tolerance=repr(params.solver_tolerance),
    )
    # A diverged state must stay visible: MuJoCo would start again from the initial one.
    ET.SubElement(option, "flag", multiccd="enable", nativeccd="enable", autoreset="disable")
    ET.SubElement(root, "size", memory="32M")
    asset, world = ET.SubElement(root, "asset"), ET.SubElement(root, "worldbody")
    add_environment(world, object_model, obstacles, params)
    add_object(asset, world, object_model, are_rounds_hulls=params.rounds_are_hulls)
    sensors = ET.SubElement(root, "sensor")
    history = str(carrier.steps_per_tick(params))
    for name in fixed_bodies(obstacles):
        _add_force(sensors, f"object {name}", history, body1="object", geom2=name)
    if carrier is not Carrier.NO_HAND:
        add_hand(root, asset, world, object_model, params, carrier.is_sliding)
        for name in fixed_bodies(obstacles):
            _add_force(sensors, f"robot {name}", history, subtree1="panda_hand", geom2=name)
        _add_force(sensors, "robot anything", history, subtree1="panda_hand")
        for name in HAND_PARTS:
            _add_force(sensors, name, "0", body1=name, body2="object")
    return ET.tostring(root, encoding="unicode")


def _add_force(sensors: ET.Element, name: str, history: str, **between: Any) -> None:
    """Net contact force between two things; `history` steps of it are kept: no step's force is lost to whoever looks once a tick."""
    ET.SubElement(sensors, "contact", name=name, data="force", reduce="netforce", nsample=history, **between)


def _set_pad_yield(model: mujoco.MjModel, params: HandWorldParams) -> None:
    """Give every cell its share of the pad's stiffness and damping, in newton and metres whatever the object weighs.

    MuJoCo's contact force f obeys  a + R f = -b v - k r  with R = (1 - d) / d x A and A the two bodies' inverse masses: where a is small,
    the cell is a spring of k / R and a damper of b / R. Its direct format takes k d and b d (for constant d).
    """
    object_body = model.body("object").id
    n_cells = params.cells_per_side**2
    if n_cells == 0:
        return
    b = PAD_RATE_PER_S
    k = b / params.pad_relaxation_s
    R = k / (params.pad_stiffness_n_m / n_cells)
    for geom in range(model.ngeom):
        if " cell " in model.geom(geom).name:
            A = float(model.body_invweight0[object_body, 0] + model.body_invweight0[model.geom_bodyid[geom], 0])
            d = A / (A + R)
            model.geom_solref[geom] = -k * d, -b * d
            model.geom_solimp[geom] = d, d, 0.001, 0.5, 2.0
