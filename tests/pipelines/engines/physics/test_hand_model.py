"""The held object's engine is given what it should be: parts, masses, pads that yield as stated, parameters within bounds."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from objects.object_model import ObjectModel
from pipelines.engines.physics.hand_bodies import cylinder_of
from pipelines.engines.physics.hand_model import Carrier, build_model
from pipelines.engines.physics.hand_params import HandWorldParams
from pipelines.engines.physics.hand_world import HandWorld
from pipelines.engines.robot.arm import HOME_Q_RAD
from tests.pipelines.engines.physics.hand_runs import MODELS, PARAMS
from tests.pipelines.engines.physics.object_models import cuboid_model


@pytest.mark.parametrize("carrier", list(Carrier))
@pytest.mark.parametrize("object_model", MODELS, ids=lambda m: m.object_id)
def test_parts_mass_and_inertia_are_where_the_object_has_them(object_model: ObjectModel, carrier: Carrier) -> None:
    """MuJoCo moves meshes to axes of their own: the vertices that it collides must still be the parts'."""
    scene = build_model(object_model, (), PARAMS, carrier)
    m = scene.model
    for k, part in enumerate(object_model.parts):
        geom = m.geom(f"part {k}")
        R = Rotation.from_quat(geom.quat[[1, 2, 3, 0]]).as_matrix()
        if geom.type[0] == mujoco.mjtGeom.mjGEOM_BOX:
            corners = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3) * geom.size
        elif geom.type[0] == mujoco.mjtGeom.mjGEOM_CYLINDER:
            off_axis_m = np.hypot(*(part.vertices_m - geom.pos)[:, :2].T)
            assert off_axis_m.max() == pytest.approx(geom.size[0], abs=1e-7)
            np.testing.assert_allclose(np.abs(part.vertices_m[:, 2] - geom.pos[2]), geom.size[1], atol=1e-7)
            continue
        else:
            first, n = m.mesh_vertadr[geom.dataid[0]], m.mesh_vertnum[geom.dataid[0]]
            corners = m.mesh_vert[first : first + n].astype(float)
        placed = corners @ R.T + geom.pos
        gaps = np.linalg.norm(placed[:, None] - part.vertices_m, axis=-1)
        assert gaps.min(axis=0).max() < 1e-7
        assert gaps.min(axis=1).max() < 1e-7
    body = m.body("object")
    R = Rotation.from_quat(body.iquat[[1, 2, 3, 0]]).as_matrix()
    assert body.mass[0] == pytest.approx(object_model.mass_kg)
    np.testing.assert_allclose(body.ipos, object_model.com_m, atol=1e-12)
    np.testing.assert_allclose(R @ np.diag(body.inertia) @ R.T, object_model.inertia_kg_m2, rtol=1e-9, atol=1e-12)


def test_only_what_is_round_all_round_is_a_cylinder() -> None:
    can, cuboid, mug = MODELS
    centre_m, radius_m, half_m = cylinder_of(can.parts[0].vertices_m) or pytest.fail("a can is a cylinder")
    assert (radius_m, half_m) == (pytest.approx(0.033), pytest.approx(0.0575))
    np.testing.assert_allclose(centre_m, 0.0, atol=1e-9)
    assert cylinder_of(cuboid.parts[0].vertices_m) is None
    assert all(cylinder_of(part.vertices_m) is None for part in mug.parts[1:])
    dented = can.parts[0].vertices_m.copy()
    dented[1, 0] -= 1e-4
    assert cylinder_of(dented) is None
    hulls = build_model(can, (), HandWorldParams(rounds_are_hulls=True), Carrier.LANDING).model
    assert hulls.mesh_vertnum[hulls.geom("part 0").dataid[0]] == len(can.parts[0].vertices_m)


def test_pads_yield_as_stated_whatever_the_object_weighs() -> None:
    for mass_kg in (0.03, 0.5):
        for n in (3, 5):
            params = HandWorldParams(cells_per_side=n)
            with HandWorld(cuboid_model(mass_kg=mass_kg), (), params) as world:
                world.start_taking("press", HOME_Q_RAD, 0.032, _between_the_pads(), 0.4)
                mujoco.mj_forward(world._state.at.model, world._state.data)
                contacts = [
                    c
                    for c in world._state.data.contact
                    if " cell " in world._state.at.model.geom(c.geom2).name + world._state.at.model.geom(c.geom1).name
                ]
                assert len(contacts) == 2 * n * n
                wanted_m = params.finger_force_n / params.pad_stiffness_n_m
                np.testing.assert_allclose([-c.dist for c in contacts], wanted_m, rtol=0.02)


def _between_the_pads() -> np.ndarray:
    """The carton with its 60 mm between the pads, weightless."""
    T = np.eye(4)
    T[:3, :3] = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    T[2, 3] = 0.045  # below the palm
    return T


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"finger_force_n": 20.0}, "finger_force_n = 20.0"),
        ({"pad_lever_scale": 1.3}, "pad_lever_scale = 1.3"),
        ({"cells_per_side": 4}, "cells_per_side = 4"),
        ({"steps_per_tick": 1}, "steps_per_tick"),
        ({"pad_stiffness_n_m": 0.0}, "pad_stiffness_n_m = 0.0"),
    ],
)
def test_parameters_out_of_bounds_are_refused(changes: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        HandWorldParams(**changes)  # type: ignore[arg-type]
