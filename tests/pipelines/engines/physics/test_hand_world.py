"""The held object's engine against mechanics: rest, impulses, grips, jams, collisions; its bits and its errors."""

from __future__ import annotations

import hashlib
import subprocess
import sys

import numpy as np
import pytest

from objects.object_model import ObjectModel
from pipelines.engines.physics.coming_to_rest import settle
from pipelines.engines.physics.errors import PhysicsError
from pipelines.engines.physics.hand_bodies import FINGERS
from pipelines.engines.physics.hand_rollout import close_fingers, hold, move, open_fingers
from pipelines.engines.physics.hand_world import GRAVITY_M_S2, HandWorld
from pipelines.engines.physics.phases import Phase, pose_difference
from pipelines.engines.planning.trajectory import MotionParams, time_path
from pipelines.engines.robot.arm import HOME_Q_RAD, fk, follow_line
from pipelines.values import Obstacle
from tables.poses import inverse, matrix_of
from tables.vocabulary import Symmetry
from tests.pipelines.engines.physics.hand_runs import FAR_Q_RAD, FAST, MODELS, PARAMS, swing, take


def _run(world: HandWorld, grasp_id: int) -> bytes:
    """Take, swing, set down nothing, open, fall, settle: every model and every kind of contact."""
    take(world, grasp_id)
    move(world, Phase.TRANSPORT, swing())
    open_fingers(world, 0.08, 0.5)
    q, fingers_m = world.arm_state()
    world.remove_hand()
    settle(world, 240)
    return np.concatenate([world.object_pose().ravel(), q, fingers_m, [world.n_steps, world.impulse_n_s("object", "table")]]).tobytes()


@pytest.mark.parametrize("object_model", MODELS, ids=lambda m: m.object_id)
def test_objects_rest_where_their_stable_poses_say(object_model: ObjectModel) -> None:
    for pose in object_model.stable_poses:
        T = pose.T_plane_object.copy()
        T[0, 3] = 0.5
        with HandWorld(object_model, (), PARAMS) as world:
            world.start_open("rest", HOME_Q_RAD, 0.04, T)
            world.remove_hand()
            hold(world, Phase.SETTLE, 0.5)
            drift_m, turn_rad = pose_difference(T, world.object_pose())
            # A can is a cylinder here; where it lies elsewhere, it lies on a face of a prism.
            is_round = object_model.symmetry is Symmetry.REVOLUTION_Z and pose.resting == "lying"
            higher_m = T[2, 3] * (1 / np.cos(np.pi / 48) - 1) if is_round else 0.0
            assert abs(world.object_pose()[2, 3] - T[2, 3] - higher_m) < 2e-5
            assert drift_m < 1e-4
            assert turn_rad < 2e-3


def test_impulse_of_a_landing_is_weight_times_time() -> None:
    """From rest to rest the table gives back all that gravity has: a peak that a look once a tick would miss would be missing."""
    object_model = MODELS[1]
    T = object_model.stable_poses[0].T_plane_object.copy()
    T[:3, 3] += 0.5, 0.0, 0.03
    with HandWorld(object_model, (), PARAMS) as world:
        world.start_open("landing", HOME_Q_RAD, 0.04, T)
        world.remove_hand()
        hold(world, Phase.SETTLE, 1.0)
        wanted = object_model.mass_kg * GRAVITY_M_S2 * world.n_steps * PARAMS.dt_s
        assert world.impulse_n_s("object", "table") == pytest.approx(wanted, rel=0.01)
        assert world.impulse_n_s("robot", "table") == 0.0


def test_a_can_on_its_side_rolls_as_far_as_rolling_friction_says() -> None:
    """Not by whole facets of the prism that stands for it elsewhere, 4 mm wide: those stopped it at once."""
    can, speed_m_s = MODELS[0], 0.03
    rest = next(pose for pose in can.stable_poses if pose.resting == "lying")
    T = rest.T_plane_object.copy()
    T[0, 3] = 0.5
    radius_m, I = 0.033, can.inertia_kg_m2[2, 2]
    with HandWorld(can, (), PARAMS) as world:
        world.start_open("rolls", HOME_Q_RAD, 0.04, T)
        world.remove_hand()
        data, v = world._state.data, world._state.at.object_v
        along = np.cross(T[:3, 2], [0.0, 0.0, 1.0])
        data.qvel[v : v + 3] = speed_m_s * along
        data.qvel[v + 3 : v + 6] = T[:3, :3].T @ np.cross([0.0, 0.0, 1.0], speed_m_s * along / radius_m)
        settle(world, 480)
        moved_m = world.object_pose()[:3, 3] - T[:3, 3]
    deceleration = PARAMS.rolling_friction_m * can.mass_kg * GRAVITY_M_S2 * radius_m / (can.mass_kg * radius_m**2 + I)
    assert moved_m @ along == pytest.approx(speed_m_s**2 / (2 * deceleration), rel=0.1)
    assert abs(moved_m @ T[:3, 2]) < 5e-4


@pytest.mark.parametrize("object_model", MODELS, ids=lambda m: m.object_id)
def test_a_landing_begins_where_the_hold_was(object_model: ObjectModel) -> None:
    """In finer steps, of contacts that begin anew: the object neither jumps nor is kicked."""
    with HandWorld(object_model, (), PARAMS) as world:
        take(world, 1)
        hold(world, Phase.HOLD, 0.1)
        assert all(map(world.touching, FINGERS))
        before, n = world.inhand_pose(), world.n_steps
        world.begin_landing()
        assert pose_difference(before, world.inhand_pose()) == (pytest.approx(0.0, abs=1e-12), pytest.approx(0.0, abs=1e-7))
        assert world.n_steps == n
        hold(world, Phase.HOLD, 0.1)
        moved_m, turned_rad = pose_difference(before, world.inhand_pose())
        assert moved_m < 5e-5
        assert turned_rad < 1e-3


@pytest.mark.parametrize("object_model", MODELS, ids=lambda m: m.object_id)
def test_a_hold_is_restarted_from_what_is_saved(object_model: ObjectModel) -> None:
    with HandWorld(object_model, (), PARAMS) as world:
        take(world, 1)
        hold(world, Phase.HOLD, 0.3)
        assert pose_difference(inverse(object_model.grasps[1].T_object_grasp), world.inhand_pose())[0] < 1e-3  # it is held
        (q, fingers_m), T = world.arm_state(), world.inhand_pose()
    with HandWorld(object_model, (), PARAMS) as world:
        world.start_held("again", q, fingers_m.tolist(), T)
        hold(world, Phase.HOLD, 0.25)
        assert pose_difference(T, world.inhand_pose())[0] < 2e-5


def test_pick_lift_transport_and_release_of_a_carton() -> None:
    object_model = MODELS[1]
    T_object = object_model.stable_poses[0].T_plane_object.copy()
    T_object[:3, 3] += 0.5, 0.0, 0.0
    T_grasp = T_object @ object_model.grasps[0].T_object_grasp
    q = _solve(T_grasp)
    up = T_grasp.copy()
    up[2, 3] += 0.12
    line = follow_line(T_grasp, up, q, 0.0025, 0.35)
    assert line is not None
    with HandWorld(object_model, (), PARAMS) as world:
        world.start_open("lift", line[-1], 0.04, T_object)
        move(world, Phase.APPROACH, time_path(line[::-1], MotionParams(), PARAMS.dt_s, stop_at_waypoints=False))
        assert pose_difference(world.object_pose(), T_object)[0] < 1e-4
        assert close_fingers(world, 0.8)
        hold(world, Phase.CLOSE, 0.1)
        T_closed = world.inhand_pose()
        move(world, Phase.LIFT, time_path(line, MotionParams(), PARAMS.dt_s, stop_at_waypoints=False))
        assert world.object_pose()[2, 3] - T_object[2, 3] == pytest.approx(0.12, abs=1e-3)
        swing = np.stack([line[-1], line[-1] + np.array([0.5, 0.0, 0.2, 0.0, 0.3, 0.0, 0.4]), line[-1]])
        assert move(world, Phase.TRANSPORT, time_path(swing, MotionParams(), PARAMS.dt_s, stop_at_waypoints=True))
        assert pose_difference(T_closed, world.inhand_pose())[0] < 8e-4
        move(world, Phase.DESCEND, time_path(line[::-1], MotionParams(), PARAMS.dt_s, stop_at_waypoints=False))
        before = world.arm_state()[1]
        opened = []
        world.command_fingers(PARAMS.finger_speed_m_s)
        for _ in range(40):
            world.step()
            opened.append(world.arm_state()[1])
        rates = np.diff([before, *opened], axis=0) / PARAMS.dt_s
        assert rates.max() < 1.2 * PARAMS.finger_speed_m_s  # pads that are let go do not throw the fingers
        assert np.abs(np.diff(opened, axis=1)).max() < 2e-5  # nor one before the other
        assert pose_difference(world.object_pose(), T_object)[0] < 1e-3


def _solve(T: np.ndarray) -> np.ndarray:
    from pipelines.engines.robot.arm import ik

    solutions = ik(T, 32)
    return solutions[np.argmin(np.abs(solutions - HOME_Q_RAD).max(axis=1))]


def test_same_bits_in_any_order_and_process() -> None:
    with HandWorld(MODELS[0], (), PARAMS) as world:
        first = _run(world, 1)
        other = _run(world, 3)
        assert _run(world, 1) == first
        assert other != first
    with HandWorld(MODELS[2], (), PARAMS) as world:
        _run(world, 0)
    with HandWorld(MODELS[0], (), PARAMS) as world:
        assert _run(world, 3) == other
        assert _run(world, 1) == first
    code = (
        "from tests.pipelines.engines.physics.test_hand_world import *\nfrom tests.pipelines.engines.physics.test_hand_world import _run\n"
        "with HandWorld(MODELS[0], (), PARAMS) as world: print(hashlib.sha256(_run(world, 1)).hexdigest())"
    )
    fresh = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()[-1]
    assert fresh == hashlib.sha256(first).hexdigest()


def test_a_hand_that_presses_on_the_table_stops() -> None:
    """Down by 60 mm with its object on the table: the arm stops by itself, and the force stays that of a jam of a tick."""
    object_model = MODELS[1]
    T_object = object_model.stable_poses[1].T_plane_object.copy()
    T_object[:3, 3] += 0.5, 0.0, 0.0
    T_start = matrix_of(np.array([0.5, 0.0, T_object[2, 3] + 0.13, 1.0, 0.0, 0.0, 0.0]))
    T_end = T_start.copy()
    T_end[2, 3] = 0.02
    line = follow_line(T_start, T_end, _solve(T_start), 0.0025, 0.35)
    assert line is not None
    with HandWorld(object_model, (), PARAMS) as world:
        world.start_open("jam", line[0], 0.01, T_object)
        done = move(world, Phase.DESCEND, time_path(line, MotionParams(), PARAMS.dt_s, stop_at_waypoints=False))
        assert not done
        assert world.is_stopped
        assert world.n_steps < len(line) * 100
        assert 0.0 < world.impulse_n_s("object", "table") < 10.0


def test_what_the_engine_cannot_answer_for_is_an_error_with_the_label() -> None:
    with HandWorld(MODELS[1], (), PARAMS) as world:
        take(world, 0, "full-0000-t0-g00")
        world._state.data.qvel[world._state.at.object_v] = 1e12
        with pytest.raises(PhysicsError, match=r"full-0000-t0-g00.*warned"):
            hold(world, Phase.HOLD, 0.1)
        take(world, 0, "full-0000-t0-g01")
        world._state.data.qpos[world._state.at.object_q] = np.nan
        with pytest.raises(PhysicsError, match="full-0000-t0-g01"):
            hold(world, Phase.HOLD, 0.1)
        take(world, 0, "full-0000-t0-g02")
        with pytest.raises(PhysicsError, match="full-0000-t0-g02: a motion starts"):
            move(world, Phase.TRANSPORT, time_path(np.stack([FAR_Q_RAD, HOME_Q_RAD]), FAST, PARAMS.dt_s, stop_at_waypoints=True))


def test_collisions_of_the_held_object_with_an_obstacle_are_felt() -> None:
    """An obstacle in the way of the swing: its impulse is counted while the hand turns, and none without it."""
    T = fk(HOME_Q_RAD)
    turned = fk(HOME_Q_RAD + np.array([0.3, 0, 0, 0, 0, 0, 0]))
    obstacle = Obstacle(0, matrix_of(np.array([*turned[:2, 3], T[2, 3] + 0.02, 0.0, 0.0, 0.0, 1.0])), np.array([0.05, 0.05, 0.1]))
    sums = []
    for obstacles in ((), (obstacle,)):
        with HandWorld(MODELS[0], obstacles, PARAMS) as world:
            take(world, 1)
            q = np.stack([HOME_Q_RAD, HOME_Q_RAD + np.array([0.6, 0, 0, 0, 0, 0, 0])])
            move(world, Phase.TRANSPORT, time_path(q, MotionParams(), PARAMS.dt_s, stop_at_waypoints=True))
            sums.append(sum(world.impulse_n_s("object", name) + world.impulse_n_s("robot", name) for name in world.fixed_bodies))
    assert sums[0] == 0.0
    assert sums[1] > 0.02


def test_fingers_are_the_two_that_press() -> None:
    with HandWorld(MODELS[1], (), PARAMS) as world:
        take(world, 0)
        assert all(world.touching(finger) for finger in FINGERS)
        assert not world.touching("panda_hand")
