"""Collision verdicts against pybullet, against geometry that can be written down, and their independence of history."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from itertools import combinations

import coal
import numpy as np
import pinocchio as pin
import pytest

from objects.object_model import ObjectModel
from pipelines.engines.planning.bodies import CLEARANCE_M, Surroundings, bodies_meet, hand_body, object_body, transform_of
from pipelines.engines.planning.clearance import path_clearance_m
from pipelines.engines.planning.collision import ALLOWED_COLLISION_MATRIX, HELD_TOLERANCE_M, ROBOT, SELF_COLLISION_PAIRS, CollisionModel
from pipelines.engines.robot.arm import HOME_Q_RAD, Q_LOWER_RAD, Q_UPPER_RAD, fk, follow_line, ik
from pipelines.engines.robot.geometry import box_corners, moved, panda
from pipelines.values import Obstacle
from tables.poses import inverse
from tests.builders import OBSTACLE_SIZE_M, box_model, can_model, panda_scene, pose, tcp_pose
from tests.pipelines.engines.planning.bullet_reference import BulletReference

OBSTACLES = ((0.5, 0.25), (0.62, -0.2))
T_TCP_CAN = inverse(tcp_pose((0.0, 0.0, 0.03), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)))
N_Q7 = 32  # enough configurations of every pose here
FINGERS_M = np.array([0.03, 0.034])
# Hulls and boxes of pybullet are in contact up to this early or late.
BULLET_TOLERANCE_M = 0.0015


def configurations(n: int, seed: int) -> np.ndarray:
    """Half anywhere, half near the table, where grasping and placing happen."""
    rng = np.random.default_rng(seed)
    near = HOME_Q_RAD + np.array([0.0, 0.7, 0.0, -0.2, 0.0, 0.6, 0.0]) + rng.uniform(-0.6, 0.6, (n - n // 2, 7))
    return np.concatenate([rng.uniform(Q_LOWER_RAD, Q_UPPER_RAD, (n // 2, 7)), np.clip(near, Q_LOWER_RAD, Q_UPPER_RAD)])


@pytest.mark.parametrize("object_model", [can_model(), box_model()], ids=["can", "box"])
def test_verdicts_agree_with_pybullet(object_model: ObjectModel) -> None:
    """Every configuration where pybullet is surer than its margin; the others are counted, so that the test cannot go blind."""
    scene = panda_scene(object_model, OBSTACLES)
    model = CollisionModel(scene, object_model)
    model.attach(T_TCP_CAN, FINGERS_M)
    n_sure, n_hit = 0, 0
    with BulletReference(scene, object_model) as reference:
        model.place_object(scene.T_base_object, 0.07)
        for q in configurations(300, 4):
            carrying_m = reference.carrying_m(q, FINGERS_M, T_TCP_CAN)
            if abs(carrying_m) > BULLET_TOLERANCE_M:
                n_sure += 1
                n_hit += carrying_m < 0
                assert model.in_collision_holding(q) == (carrying_m < 0), (q, carrying_m)
            open_m = reference.open_m(q, 0.07, scene.T_base_object)
            if abs(open_m) > BULLET_TOLERANCE_M:
                assert model.in_collision_open(q) == (open_m < 0), (q, open_m)
    assert n_sure > 270
    assert 40 < n_hit < 260


def test_every_pair_of_the_robot_is_tested_or_allowed_and_the_tested_ones_are_those_of_the_labels() -> None:
    """The published labels were made with these 29 pairs of 78."""
    hand = ("hand", "left_finger_pad", "left_finger_body", "right_finger_pad", "right_finger_body")
    arm_by_wrist = {frozenset((a, b)) for a in ("link0", "link1", "link2") for b in ("link5", "link6", "link7")}
    arm_by_hand = {frozenset((a, b)) for a in ("link0", "link1", "link2", "link5") for b in hand}
    tested = {frozenset(pair) for pair in SELF_COLLISION_PAIRS}
    assert tested == arm_by_wrist | arm_by_hand
    assert len(SELF_COLLISION_PAIRS) == len(tested) == 29
    assert tuple(shape.name for shape in panda().shapes) == ROBOT
    assert tested | ALLOWED_COLLISION_MATRIX == {frozenset(pair) for pair in combinations(ROBOT, 2)}
    assert not tested & ALLOWED_COLLISION_MATRIX


def test_bodies_that_are_said_to_meet_never_or_always_do_so() -> None:
    """What the matrix allows, in 2,000 random configurations; link5 and link7 are the documented pair between."""
    model, data, shapes = panda().model, panda().model.createData(), {shape.name: shape for shape in panda().shapes}
    n_met = dict.fromkeys(sorted(tuple(sorted(pair)) for pair in ALLOWED_COLLISION_MATRIX), 0)
    sampled = np.random.default_rng(10).uniform(Q_LOWER_RAD, Q_UPPER_RAD, (2000, 7))
    for q in sampled:
        pin.forwardKinematics(model, data, np.concatenate([q, [0.01, 0.01]]))
        placed = {name: transform_of(data.oMi[s.joint].homogeneous @ s.T_joint_shape) for name, s in shapes.items()}
        for a, b in n_met:
            result = coal.CollisionResult()
            n_met[a, b] += bool(coal.collide(shapes[a].geometry, placed[a], shapes[b].geometry, placed[b], coal.CollisionRequest(), result))
    between = {pair for pair, n in n_met.items() if 0 < n < len(sampled)}
    assert between == {("link5", "link7")}
    assert n_met["link5", "link7"] / len(sampled) == pytest.approx(0.06, abs=0.02)
    always = {pair for pair, n in n_met.items() if n == len(sampled)}
    assert {(a, b) for a, b in always if a.startswith("link") and b.startswith("link")} <= {(f"link{k}", f"link{k + 1}") for k in range(7)}


def test_a_verdict_does_not_depend_on_what_was_asked_before() -> None:
    object_model = can_model()
    scene = panda_scene(object_model, OBSTACLES)
    model = CollisionModel(scene, object_model)
    model.attach(T_TCP_CAN, FINGERS_M)
    q = configurations(4000, 5)
    first = np.array([(model.in_collision_holding(row), model.in_collision_open(row)) for row in q])
    order = np.random.default_rng(6).permutation(len(q))
    again = np.empty_like(first)
    for k in order:
        model.attach(np.eye(4), np.zeros(2))
        model.place_object(pose(0.4, 0.1, 0.3), 0.02)
        model.in_collision_open(q[k])
        model.attach(T_TCP_CAN, FINGERS_M)
        model.place_object(scene.T_base_object, 0.08)
        again[k] = model.in_collision_holding(q[k]), model.in_collision_open(q[k])
    np.testing.assert_array_equal(first, again)
    fresh = CollisionModel(scene, object_model)
    fresh.attach(T_TCP_CAN, FINGERS_M)
    np.testing.assert_array_equal(first[:200], [(fresh.in_collision_holding(row), fresh.in_collision_open(row)) for row in q[:200]])


def test_a_deep_overlap_that_early_stopping_misses_is_found() -> None:
    """link5 and hand 9 mm inside each other: coal without contacts calls it a gap of 0.6 um, with its default guess."""
    object_model = can_model()
    q = np.random.default_rng(0).uniform(Q_LOWER_RAD, Q_UPPER_RAD, (135, 7))[134]
    scene = panda_scene(object_model)
    with BulletReference(scene, object_model) as reference:
        assert reference.open_m(q, 0.08, scene.T_base_object) < -0.005
    assert CollisionModel(scene, object_model).in_collision_open(q)


def test_the_attached_object_meets_the_table_where_its_lowest_point_does() -> None:
    """Exact: the TCP goes down until the can's rim is at its clearance."""
    object_model = can_model()
    model = CollisionModel(panda_scene(object_model), object_model)
    model.attach(T_TCP_CAN, FINGERS_M)
    body = object_body(object_model)
    for tilt in (0.0, 0.3):
        T_tcp = tcp_pose((0.5, 0.1, 0.3), (np.sin(tilt), 0.0, -np.cos(tilt)), (0.0, 1.0, 0.0))
        lowest = moved(T_tcp @ T_TCP_CAN, body.vertices_m)[:, 2].min()
        for height, expected in ((CLEARANCE_M + 2e-5, False), (CLEARANCE_M - 2e-5, True)):
            T = T_tcp.copy()
            T[2, 3] += height - lowest
            free_before = [q for q in ik(T_tcp, N_Q7) if not model.in_collision_holding(q)]
            assert free_before
            q = min(ik(T, N_Q7), key=lambda row: float(np.abs(row - free_before[0]).max()))
            assert model.in_collision_holding(q) is expected
            assert model.surroundings.in_collision(body, T @ T_TCP_CAN) is expected


@pytest.mark.parametrize(("overlap_m", "expected"), [(HELD_TOLERANCE_M - 5e-5, False), (HELD_TOLERANCE_M + 5e-5, True)])
def test_a_standing_object_may_be_overlapped_as_deep_as_the_tolerance(overlap_m: float, expected: bool) -> None:
    """A box, too low for the palm, beside a finger's outer face."""
    object_model = box_model((0.04, 0.04, 0.06))
    model = CollisionModel(panda_scene(object_model), object_model)
    T_base_tcp = tcp_pose((0.5, 0.0, 0.06), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0))
    solutions = ik(T_base_tcp, N_Q7)
    model.place_object(pose(2.0, 2.0, 0.03), 0.06)
    free = [q for q in solutions if not model.in_collision_open(q)]
    assert free
    outer_m = float(np.abs(hand_body(0.06).part_vertices_m[2][:, 1]).max())
    model.place_object(pose(0.5, outer_m + 0.02 - overlap_m, 0.06), 0.06)
    assert {model.in_collision_open(q) for q in free} == {expected}


@pytest.mark.parametrize(("gap_m", "expected"), [(CLEARANCE_M + 5e-5, False), (CLEARANCE_M - 5e-5, True)])
def test_arm_and_hand_keep_their_clearance_to_table_and_obstacles(gap_m: float, expected: bool) -> None:
    """A hand pointing down over the table, and one beside an obstacle turned like the hand; with and without the arm."""
    object_model = can_model()
    lowest_m = -float(hand_body(0.06).vertices_m[:, 2].max())
    widest_m = float(hand_body(0.06).vertices_m[:, 1].max())
    obstacle = Obstacle(0, pose(0.5, 0.2 + OBSTACLE_SIZE_M[1] / 2, 0.06), np.array(OBSTACLE_SIZE_M))
    scene = dataclasses.replace(panda_scene(object_model), T_base_object=pose(2.0, 2.0, 0.06), obstacles=(obstacle,))
    model = CollisionModel(scene, object_model)
    model.place_object(scene.T_base_object, 0.06)
    over_table = tcp_pose((0.5, 0.0, gap_m - lowest_m), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0))
    beside_obstacle = tcp_pose((0.5, 0.2 - widest_m - gap_m, 0.05), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0))
    for T in (over_table, beside_obstacle):
        T_far = T.copy()
        T_far[:3, 3] += [0.0, -0.02, 0.02]
        lines = [line for q in ik(T, N_Q7) if (line := follow_line(T, T_far, q, 0.0025, 0.1)) is not None]
        assert {model.in_collision_open(line[0]) for line in lines if not model.in_collision_open(line[-1])} == {expected}
        assert model.surroundings.in_collision(hand_body(0.06), T) is expected


def test_a_swept_hand_stands_for_every_step_of_its_line() -> None:
    """One hull test against 0.25 mm steps: the sweep is in collision where some step is, and free where none is."""
    object_model = can_model()
    scene = panda_scene(object_model, OBSTACLES)
    surroundings = Surroundings(scene)
    rng = np.random.default_rng(7)
    still, swept = hand_body(0.07), hand_body(0.07, 0.1)
    verdicts = []
    for _ in range(120):
        approach = rng.normal(size=3) - [0.0, 0.0, 0.5]
        T = tcp_pose(rng.uniform([0.4, -0.3, 0.02], [0.7, 0.35, 0.2]), approach, np.cross(approach, rng.normal(size=3)))
        steps = []
        for back in np.linspace(0.0, 0.1, 401):
            T_step = T.copy()
            T_step[:3, 3] -= back * T[:3, 2]
            steps.append(surroundings.in_collision(still, T_step))
        verdicts.append((any(steps), surroundings.in_collision(swept, T)))
    assert 20 < sum(stepped for stepped, _ in verdicts) < 110
    # A corner may graze between two steps, never the other way.
    assert not any(stepped and not whole for stepped, whole in verdicts)
    assert sum(whole and not stepped for stepped, whole in verdicts) <= 1


def test_clearance_is_the_smallest_of_all_distances() -> None:
    """Brute force over every body, obstacle and configuration, without bounding spheres."""
    object_model = box_model()
    for obstacles in (OBSTACLES, ()):
        scene = panda_scene(object_model, obstacles)
        model = CollisionModel(scene, object_model)
        model.attach(T_TCP_CAN, FINGERS_M)
        path = configurations(40, 8)[20:]
        assert path_clearance_m(model, path) == pytest.approx(min(_clearance_m(model, q) for q in path), abs=1e-7)


def _clearance_m(model: CollisionModel, q: np.ndarray) -> float:
    robot = panda()
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, np.concatenate([q, FINGERS_M]))
    placed = [
        (data.oMi[s.joint].homogeneous @ s.T_joint_shape, s.geometry, moved(data.oMi[s.joint].homogeneous, s.vertices_m))
        for s in robot.shapes
        if s.name not in ("link0", "link1")
    ]
    T_base_object = fk(q) @ T_TCP_CAN
    parts = zip(model.object.parts, model.object.part_vertices_m, strict=True)
    placed += [(T_base_object, part, moved(T_base_object, points)) for part, points in parts]
    distances = [points[:, 2].min() for _, _, points in placed]
    for obstacle in model.surroundings.obstacles:
        for T, geometry, _ in placed:
            result = coal.DistanceResult()
            coal.distance(geometry, transform_of(T), obstacle.geometry, obstacle.placement, coal.DistanceRequest(), result)
            distances.append(result.min_distance)
    return float(min(distances))


def clearance_after(first_query: str) -> str:
    """A clearance, to the bit, in a process whose first query of coal is another one."""
    if first_query == "coal.Box":
        here = coal.Transform3s()
        coal.distance(coal.Box(1.0, 1.0, 1.0), here, coal.Box(1.0, 1.0, 1.0), here, coal.DistanceRequest(), coal.DistanceResult())
    object_model = can_model()
    model = CollisionModel(panda_scene(object_model, OBSTACLES), object_model)
    model.attach(T_TCP_CAN, FINGERS_M)
    path = configurations(60, 9)[30:]
    return " ".join(path_clearance_m(model, q[None]).hex() for q in (path if first_query != "last" else path[::-1]))


def test_distances_do_not_depend_on_the_first_query_of_the_process() -> None:
    """coal's Box keeps a tie-breaker of its first query for the whole process (coal issue 894); hulls of boxes do not."""
    code = (
        "import sys; from tests.pipelines.engines.planning.test_collision import clearance_after; print('>', clearance_after(sys.argv[1]))"
    )
    answers = {}
    for first in ("none", "coal.Box", "last"):
        output = subprocess.run([sys.executable, "-c", code, first], capture_output=True, text=True, check=True).stdout
        answers[first] = output.split("> ")[-1].split()
    assert len(answers["none"]) == 30
    assert answers["coal.Box"] == answers["none"]
    assert answers["last"][::-1] == answers["none"]


def test_margins_between_boxes_are_exact() -> None:
    """Two boxes face to face: what comes closer than the margin meets, a negative margin forgives overlap."""
    body = object_body(box_model((0.04, 0.04, 0.10)))
    for gap_m in (-0.003, -0.0005, 0.0005, 0.003):
        T = pose(0.04 + gap_m, 0.0, 0.0)
        for margin_m in (-0.001, 0.0, 0.001):
            assert bodies_meet(body.parts, body.parts, T, margin_m) is (gap_m < margin_m)


def test_equal_geometry_shares_one_body_and_other_geometry_does_not() -> None:
    object_model = box_model()
    assert object_body(object_model) is object_body(dataclasses.replace(object_model, object_id="other"))
    assert object_body(object_model) is not object_body(box_model((0.05, 0.06, 0.121)))
    np.testing.assert_allclose(
        np.ptp(object_body(object_model).vertices_m, axis=0), np.ptp(box_corners(np.array([0.05, 0.06, 0.12])), axis=0)
    )
