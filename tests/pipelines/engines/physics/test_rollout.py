"""Holding and letting go: a grasped object must not creep, fingers must stop where they are told, rest must be recognised."""

from __future__ import annotations

import dataclasses

import numpy as np
import pybullet
import pytest

from pipelines.engines.physics.coming_to_rest import n_steps_of, settle
from pipelines.engines.physics.phases import Phase, pose_difference
from pipelines.engines.physics.rollout import close_fingers, hold, move, open_fingers, pressing_fingers
from pipelines.engines.physics.world import PhysicsParams, PhysicsWorld
from pipelines.engines.planning.trajectory import time_path
from pipelines.engines.robot.arm import HOME_Q_RAD
from pipelines.values import LiftedGrasp
from tests.pipelines.engines.physics.lifted import MOTION, lifted
from tests.pipelines.engines.physics.measured import deepest_contact_m

PHYSICS = PhysicsParams()


def _held(world: PhysicsWorld, grasp: LiftedGrasp) -> None:
    world.rebuild("held", with_robot=True)
    world.set_arm(grasp.lifted_q_rad, grasp.fingers_m)
    world.set_object(grasp.T_base_lifted)
    world.grip()
    hold(world, Phase.HOLD, 0.05)


@pytest.mark.parametrize("friction_scale", [1.0, 0.5])
@pytest.mark.parametrize("name", ["can", "cuboid", "mug"])
def test_a_grasped_object_does_not_creep(name: str, friction_scale: float) -> None:
    """Less than 1 mm and 1 degree in five seconds, with a matt object and with a slippery one, as most of the catalogue is.

    The arm does not move either, and no finger goes into the object.
    """
    case = lifted(name)
    assert case.grasps
    for grasp in case.grasps:
        with PhysicsWorld(case.object_model, (), PHYSICS, friction_scale) as world:
            _held(world, grasp)
            before, q_before = world.inhand_pose(), world.arm_state()[0]
            hold(world, Phase.HOLD, 5.0)
            moved_m, turned_rad = pose_difference(before, world.inhand_pose())
            assert moved_m < 1e-3
            assert turned_rad < np.radians(1.0)
            assert np.abs(world.arm_state()[0] - q_before).max() < 1e-4
            assert deepest_contact_m(world, "robot", "object") < 1e-3
            assert pressing_fingers(world) == 2


def test_contacts_found_anew_all_the_time_creep() -> None:
    """Why pads are left alone while the hand does not turn: the test of creeping can fail."""
    case = lifted("mug")
    moved_m = []
    for params in (PHYSICS, dataclasses.replace(PHYSICS, pad_refresh_rad=1e-9)):
        with PhysicsWorld(case.object_model, (), params, 0.5) as world:
            _held(world, case.grasps[0])
            before = world.inhand_pose()
            hold(world, Phase.HOLD, 2.0)
            moved_m.append(pose_difference(before, world.inhand_pose())[0])
    assert moved_m[1] > 3 * moved_m[0]


def test_fingers_press_with_the_force_of_the_recipe() -> None:
    case = lifted("can")
    with PhysicsWorld(case.object_model, (), PHYSICS) as world:
        _held(world, case.grasps[0])
        hold(world, Phase.HOLD, 0.5)
        for link in ("panda_leftfinger", "panda_rightfinger"):
            assert world.force_n("robot", "object", link) == pytest.approx(15.0 + 50.0 * case.object_model.mass_kg, rel=0.02)


def test_fingers_open_to_the_jaw_and_stop() -> None:
    case = lifted("can")
    with PhysicsWorld(case.object_model, (), PHYSICS) as world:
        world.rebuild("open", with_robot=True)
        world.set_arm(HOME_Q_RAD, (0.01, 0.01))
        world.set_object(case.scene.T_base_object)
        assert open_fingers(world, 0.05, 1.0)
        hold(world, Phase.OPEN, 0.2)
        # At most two steps at 0.1 m/s too far.
        np.testing.assert_allclose(world.arm_state()[1], 0.025, atol=0.0012)
        assert not open_fingers(world, 0.09, 0.5)  # wider than the jaw


def test_fingers_that_close_on_nothing_say_so() -> None:
    case = lifted("can")
    with PhysicsWorld(case.object_model, (), PHYSICS) as world:
        world.rebuild("empty", with_robot=True)
        world.set_arm(HOME_Q_RAD, (0.02, 0.02))
        world.set_object(case.scene.T_base_object)
        assert not close_fingers(world, 0.5)
        assert world.arm_state()[1].max() < 1e-3


def test_a_watch_ends_a_motion_and_sees_it_at_the_pace_of_the_recipe() -> None:
    case = lifted("can")
    seen: list[int] = []
    with PhysicsWorld(case.object_model, (), PHYSICS) as world:
        world.rebuild("watched", with_robot=False)
        world.set_object(case.scene.T_base_object)

        def watch(phase: Phase) -> bool:
            seen.append(world.n_steps)
            return len(seen) == 3

        assert not hold(world, Phase.HOLD, 1.0, watch)
        assert seen == [8, 16, 24]
        assert world.n_steps == 24
        assert n_steps_of(world, 0.5) == 120


def test_what_keeps_moving_is_not_settled() -> None:
    case = lifted("can")
    with PhysicsWorld(case.object_model, (), PHYSICS) as world:
        world.rebuild("sliding", with_robot=False)
        world.set_object(case.scene.T_base_object)
        assert settle(world, 100)
        assert world.n_steps == 24  # three checks, eight steps apart
        pybullet.resetBaseVelocity(world._ids["object"], [0.0, 0.0, 3.0], [0.0] * 3, physicsClientId=world._client)
        assert not settle(world, 100)


def test_pads_push_along_the_jaw_after_a_turn_and_let_go() -> None:
    """Bullet keeps the normals of lasting contacts in the base frame: after a turn they would hold the object fast."""
    case = lifted("can")
    grasp = case.grasps[0]
    side = 1.0 if grasp.lifted_q_rad[6] < 0.0 else -1.0
    turned = grasp.lifted_q_rad + np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, side * 2.5])
    trajectory = time_path(np.stack([grasp.lifted_q_rad, turned]), MOTION, PHYSICS.dt_s, stop_at_waypoints=True)
    with PhysicsWorld(case.object_model, (), PHYSICS) as world:
        _held(world, grasp)
        move(world, Phase.TRANSPORT, trajectory)
        robot, body, jaw = world._ids["robot"], world._ids["object"], world.tcp_pose()[:3, 1]
        points = [p for p in pybullet.getContactPoints(robot, body, physicsClientId=world._client) if p[9] > 0.5]
        assert len(points) >= 2
        # Flat pads on a polygon of 48 sides: half a side is 4 degrees.
        assert min(abs(float(np.dot(p[7], jaw))) for p in points) > np.cos(np.radians(6.0))
        assert open_fingers(world, 0.078, 0.3)
        before_m = world.object_pose()[2, 3]
        hold(world, Phase.OPEN, 0.15)
        # Nothing holds it: it falls as a stone does, half g t squared less what the first moments of opening took.
        assert before_m - world.object_pose()[2, 3] > 0.08
