"""The world of resting objects against mechanics: free fall, rest, rolling, stacking; and its errors."""

from __future__ import annotations

import dataclasses

import numpy as np
import pybullet
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from objects.object_model import ObjectModel, TriangleMesh
from pipelines.engines.physics.coming_to_rest import settle
from pipelines.engines.physics.errors import PhysicsError
from pipelines.engines.physics.params import PhysicsParams
from pipelines.engines.physics.phases import pose_difference
from pipelines.engines.physics.resting import rest_drift
from pipelines.engines.physics.world import PhysicsWorld
from pipelines.labels.planning import PlanningParams
from pipelines.values import GRAVITY_M_S2, Obstacle
from tables.poses import matrix_of
from tests.pipelines.engines.physics.measured import deepest_contact_m, n_contacts, object_speed_m_s
from tests.pipelines.engines.physics.object_models import can_model, cuboid_model, mug_model

OBJECT_MODELS = [can_model(), cuboid_model(), mug_model()]
PARAMS = PhysicsParams()


def _energy_j(world: PhysicsWorld) -> float:
    """Kinetic and potential energy of the object, from poses and velocities alone."""
    object_model, T = world.object_model, world.object_pose()
    v, w = map(np.array, pybullet.getBaseVelocity(world._ids["object"], physicsClientId=world._client))
    inertia = T[:3, :3] @ object_model.inertia_kg_m2 @ T[:3, :3].T
    height = float((T[:3, :3] @ object_model.com_m + T[:3, 3])[2])
    return float(0.5 * object_model.mass_kg * v @ v + 0.5 * w @ inertia @ w + object_model.mass_kg * GRAVITY_M_S2 * height)


@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(-0.5, 0.5), min_size=3, max_size=3), st.lists(st.floats(-1, 1), min_size=4, max_size=4))
def test_object_pose_is_the_one_that_was_set(position: list[float], quaternion: list[float]) -> None:
    if np.linalg.norm(quaternion) < 0.1:
        quaternion = [0.0, 0.0, 0.0, 1.0]
    T = matrix_of(np.array([*position, *quaternion]))
    with PhysicsWorld(OBJECT_MODELS[2], (), PARAMS) as world:
        world.rebuild("round trip")
        world.set_object(T)
        np.testing.assert_allclose(world.object_pose(), T, atol=1e-12)


def test_a_spinning_mug_falls_by_its_centre_of_mass() -> None:
    """The mug's frame is 5 mm from its centre of mass: taken for one another, this parabola would wobble by as much."""
    object_model = OBJECT_MODELS[2]
    T = np.eye(4)
    T[:3, 3] = 0.4, 0.0, 1.5
    with PhysicsWorld(object_model, (), PARAMS) as world:
        world.rebuild("free fall")
        world.set_object(T)
        pybullet.resetBaseVelocity(world._ids["object"], [0.3, 0.0, 1.0], [0.0, 9.0, 4.0], physicsClientId=world._client)
        start = T[:3, :3] @ object_model.com_m + T[:3, 3]
        for _ in range(72):
            world.step()
        t, T_end = 72 * PARAMS.dt_s, world.object_pose()
        end = T_end[:3, :3] @ object_model.com_m + T_end[:3, 3]
    expected = start + np.array([0.3, 0.0, 1.0]) * t - np.array([0, 0, 0.5 * GRAVITY_M_S2 * t * t])
    # Bullet's semi-implicit Euler is ahead by g t dt / 2 = 6 mm, its damping of 4 % a second behind by 2 mm.
    np.testing.assert_allclose(end, expected - np.array([0, 0, 0.5 * GRAVITY_M_S2 * t * PARAMS.dt_s]), atol=0.003)
    assert pose_difference(T, T_end)[1] > 1.0


@pytest.mark.parametrize("object_model", OBJECT_MODELS, ids=lambda object_model: object_model.object_id)
def test_rest_is_rest(object_model: ObjectModel) -> None:
    """Every stable pose stays where it is, neither on air nor in the table, and gains no energy."""
    for rest in object_model.stable_poses:
        T = rest.T_plane_object.copy()
        T[:2, 3] = 0.5, 0.1
        with PhysicsWorld(object_model, (), PARAMS) as world:
            world.rebuild(rest.resting)
            world.set_object(T)
            start_j, most_j, deepest_m = _energy_j(world), 0.0, 0.0
            for _ in range(240):
                world.step()
                most_j = max(most_j, _energy_j(world))
                deepest_m = max(deepest_m, deepest_contact_m(world, "table"))
            moved_m, _ = pose_difference(T, world.object_pose())
        # Boxes feel the table only once they are in it, after a step of free fall (0.17 mm): 0.3 mm for that, a tenth of a millimetre
        # in the end, and the energy of lifting the object by a micrometre.
        assert moved_m < 1e-4, rest.resting
        assert deepest_m < 3e-4, rest.resting
        assert most_j - start_j < object_model.mass_kg * GRAVITY_M_S2 * 1e-6, rest.resting


@pytest.mark.parametrize("speed_m_s", [0.1, 0.3])
def test_a_rolling_can_slows_down(speed_m_s: float) -> None:
    """In one convex piece it rolled faster and faster: this is why it is cut in two."""
    object_model = OBJECT_MODELS[0]
    rest = next(pose for pose in object_model.stable_poses if pose.resting == "lying")
    T = rest.T_plane_object.copy()
    T[:2, 3] = 0.3, 0.0
    axis = T[:3, 2]
    ahead = np.cross(axis, [0, 0, 1])
    with PhysicsWorld(object_model, (), PARAMS) as world:
        world.rebuild("rolling")
        world.set_object(T)
        spin = np.cross([0, 0, 1], ahead) * speed_m_s / T[2, 3]
        pybullet.resetBaseVelocity(world._ids["object"], (ahead * speed_m_s).tolist(), spin.tolist(), physicsClientId=world._client)
        start_j, most_j, deepest_m = _energy_j(world), 0.0, 0.0
        for _ in range(240):
            world.step()
            most_j = max(most_j, _energy_j(world))
            deepest_m = max(deepest_m, deepest_contact_m(world, "table"))
        end_m_s, travelled_m = object_speed_m_s(world), pose_difference(T, world.object_pose())[0]
    assert most_j <= start_j + 1e-6
    assert deepest_m < 1e-3
    # A can on wood rolls with a resistance of 0.1 to 2 per cent of its weight; over a second that leaves it moving.
    loss_m_s = (speed_m_s - end_m_s) * 1.5
    assert 0.001 < loss_m_s / GRAVITY_M_S2 < 0.02
    assert travelled_m > 0.5 * speed_m_s


@pytest.mark.parametrize("release_height_m", [PlanningParams().release_height_m, 0.005])
def test_a_box_let_go_comes_to_rest_exactly(release_height_m: float) -> None:
    object_model = OBJECT_MODELS[1]
    T = np.eye(4)
    T[:3, 3] = 0.5, 0.0, 0.07 + release_height_m
    with PhysicsWorld(object_model, (), PARAMS) as world:
        world.rebuild("drop")
        world.set_object(T)
        assert settle(world, 240)
        assert world.object_pose()[2, 3] == pytest.approx(0.07, abs=2e-5)


def test_obstacles_do_not_move_and_carry_an_object() -> None:
    object_model = OBJECT_MODELS[1]
    T_obstacle, T = np.eye(4), np.eye(4)
    T_obstacle[:3, 3] = 0.5, 0.0, 0.06
    T[:3, 3] = 0.5, 0.0, 0.12 + 0.07
    obstacle = Obstacle(0, T_obstacle, np.array([0.10, 0.08, 0.12]))
    with PhysicsWorld(object_model, (obstacle,), PARAMS) as world:
        world.rebuild("stacked")
        world.set_object(T)
        assert settle(world, 240)
        assert world.object_pose()[2, 3] == pytest.approx(0.19, abs=1e-4)
        assert n_contacts(world, "obstacle 0") > 0
        assert n_contacts(world, "table") == 0


def test_an_unstable_pose_is_found_out() -> None:
    object_model = OBJECT_MODELS[0]
    T = matrix_of(np.array([0.5, 0.0, 0.066, 0.0, np.sin(0.3), 0.0, np.cos(0.3)]))
    with PhysicsWorld(object_model, (), PARAMS) as world:
        _, (_, turned_rad) = rest_drift(world, "tilted can", T, 1.0)
    assert turned_rad > 0.5


def test_a_world_is_the_same_after_a_rebuild() -> None:
    object_model = OBJECT_MODELS[2]
    T = object_model.stable_poses[0].T_plane_object.copy()
    T[:3, 3] += 0.4, 0.1, 0.02
    ends = []
    with PhysicsWorld(object_model, (), PARAMS) as world:
        for _ in range(2):
            world.rebuild("again")
            world.set_object(T)
            for _ in range(100):
                world.step()
            ends.append(world.object_pose().tobytes())
    assert ends[0] == ends[1]


def test_a_pose_that_is_not_finite_names_the_run() -> None:
    T = np.eye(4)
    T[0, 3] = np.nan
    with PhysicsWorld(OBJECT_MODELS[0], (), PARAMS) as world:
        world.rebuild("full-0007-t3-g05")
        world.set_object(T)
        with pytest.raises(PhysicsError, match=r"full-0007-t3-g05.*must be finite"):
            world.object_pose()


def test_an_object_that_cannot_be_simulated_is_named() -> None:
    with (
        PhysicsWorld(dataclasses.replace(OBJECT_MODELS[0], parts=()), (), PARAMS) as world,
        pytest.raises(PhysicsError, match="test_can with 0"),
    ):
        world.rebuild("no parts")
    flat = TriangleMesh(np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0.1, 0.1, 0.0]]), OBJECT_MODELS[0].parts[0].faces)
    with pytest.raises(PhysicsError, match=r"test_can: part 0 .* volume 0"):
        PhysicsWorld(dataclasses.replace(OBJECT_MODELS[0], parts=(flat,)), (), PARAMS)


@pytest.mark.parametrize(("field", "value"), [("dt_s", 1 / 120), ("erp", 0.0), ("table_x_m", (1.0, 0.5)), ("settled_checks", 0)])
def test_params_are_valid_from_birth(field: str, value: object) -> None:
    with pytest.raises(ValueError, match=field):
        PhysicsParams(**{field: value})  # type: ignore[arg-type]
