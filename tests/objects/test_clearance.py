"""The gripper against the object and the table: a stepped, point-wise twin of the swept boxes."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from jaxtyping import Float

from objects.clearance import GripperClearance, clears_table, reach_chance
from objects.contacts import surface_points
from objects.gripper import MAX_JAW_M, gripper_boxes, open_jaw_m
from objects.object_model import TriangleMesh
from tests.builders import tcp_pose

PALM_M, SKEW_M, APPROACH_M = 0.004, 0.004, 0.10


def clearance_of(mesh: trimesh.Trimesh) -> GripperClearance:
    probes, _ = surface_points(mesh, 300, np.random.default_rng(0))
    return GripperClearance([TriangleMesh(mesh.vertices, mesh.faces)], probes, PALM_M, SKEW_M, APPROACH_M)


def points_in_gripper(
    points: Float[np.ndarray, "p 3"], T: Float[np.ndarray, "4 4"], jaw_m: float, grow_m: float, first: int = 0, last: int = 5
) -> int:
    """How many points lie in the gripper's boxes, from number `first` (0 is the hand) to before `last`, at an opening."""
    hits = np.zeros(len(points), dtype=bool)
    T_boxes, sizes = gripper_boxes(jaw_m)
    for T_box, size in list(zip(T_boxes, sizes, strict=True))[first:last]:
        placed = T @ T_box
        hits |= np.all(np.abs((points - placed[:3, 3]) @ placed[:3, :3]) <= size / 2 + grow_m, axis=1)
    return int(hits.sum())


def random_grasp(rng: np.random.Generator, spread_m: float) -> Float[np.ndarray, "4 4"]:
    jaw, approach = rng.normal(size=(2, 3))
    jaw /= np.linalg.norm(jaw)
    approach -= (approach @ jaw) * jaw
    return tcp_pose(rng.uniform(-spread_m, spread_m, 3), approach, jaw)


def test_what_is_called_free_is_free_at_every_step_of_approach_and_closing() -> None:
    can = trimesh.creation.cylinder(radius=0.02, height=0.06, sections=48)
    rng, width_m = np.random.default_rng(1), 0.04
    clearance, points = clearance_of(can), surface_points(can, 2000, rng)[0]
    free = [T for T in (random_grasp(rng, 0.012) for _ in range(1500)) if clearance.is_free(T, width_m)]
    assert len(free) > 10
    for T in free:
        assert points_in_gripper(points, T, open_jaw_m(width_m), PALM_M - 1e-6, first=0, last=1) == 0
        for back_m in np.linspace(0.0, APPROACH_M, 21):
            T_back = T.copy()
            T_back[:3, 3] -= back_m * T[:3, 2]
            assert points_in_gripper(points, T_back, open_jaw_m(width_m), 0.0) == 0
        for jaw_m in np.linspace(width_m + 2 * SKEW_M, open_jaw_m(width_m), 11):
            assert points_in_gripper(points, T, float(jaw_m), 0.0, first=1) == 0


def test_a_can_is_held_across_its_side_from_above_and_not_when_pushed_into_the_palm() -> None:
    can = trimesh.creation.cylinder(radius=0.03, height=0.12, sections=48)
    clearance = clearance_of(can)
    assert clearance.is_free(tcp_pose((0, 0, 0), (1, 0, 0), (0, 1, 0)), 0.06)
    # The palm is 37.4 mm behind the TCP: top end 30 mm above it clears by 7.4 mm, 35 mm by less than the 4 demanded.
    assert clearance.is_free(tcp_pose((0, 0, 0.030), (0, 0, -1), (0, 1, 0)), 0.06)
    assert not clearance.is_free(tcp_pose((0, 0, 0.025), (0, 0, -1), (0, 1, 0)), 0.06)
    assert not clearance.is_free(tcp_pose((0, 0.02, 0), (1, 0, 0), (0, 1, 0)), 0.06), "a finger in the can"


def test_pads_that_would_close_on_air_are_refused() -> None:
    can = trimesh.creation.cylinder(radius=0.03, height=0.12, sections=48)
    clearance = clearance_of(can)
    assert clearance.is_free(tcp_pose((0, 0, 0), (1, 0, 0), (0, 1, 0)), 0.06)
    assert not clearance.is_free(tcp_pose((0.06, 0, 0), (-1, 0, 0), (0, 1, 0)), 0.06)


def test_an_approach_through_the_object_is_refused() -> None:
    """A ring: the grasp on its far wall is free, the straight way there is not."""
    ring = trimesh.creation.annulus(r_min=0.10, r_max=0.11, height=0.02, sections=24)
    wedges = []
    for k in range(24):
        angle = (np.arange(2) + k) * 2 * np.pi / 24
        corners = [[r * np.cos(a), r * np.sin(a), z] for r in (0.10, 0.11) for a in angle for z in (-0.01, 0.01)]
        hull = trimesh.convex.convex_hull(np.array(corners))
        wedges.append(TriangleMesh(hull.vertices, hull.faces))
    probes, _ = surface_points(ring, 300, np.random.default_rng(0))
    T = tcp_pose((0.105, 0.0, 0.0), (0, 0, -1), (1, 0, 0))
    assert GripperClearance(wedges, probes, PALM_M, SKEW_M, APPROACH_M).is_free(T, 0.0105)
    sideways = tcp_pose((0.105, 0.0, 0.0), (0, 1, 0), (1, 0, 0))
    assert not GripperClearance(wedges, probes, PALM_M, SKEW_M, 0.25).is_free(sideways, 0.0105)


def test_the_quick_test_never_rejects_what_the_exact_one_accepts() -> None:
    can = trimesh.creation.cylinder(radius=0.02, height=0.06, sections=48)
    clearance, rng = clearance_of(can), np.random.default_rng(2)
    T = np.array([random_grasp(rng, 0.012) for _ in range(300)])
    quick = clearance.may_be_free(T)
    exact = np.array([clearance.is_free(pose, 0.04) for pose in T])
    assert exact.sum() > 5
    assert np.all(quick[exact])


@given(st.integers(0, 100_000), st.floats(0.002, 0.075))
def test_table_clearance_is_the_lowest_corner_of_hand_fingers_and_wrist(seed: int, width_m: float) -> None:
    rng = np.random.default_rng(seed)
    T = random_grasp(rng, 0.15)
    T[2, 3] += 0.15
    lowest = np.inf
    for back_m in (0.0, APPROACH_M):
        for T_box, size in [*zip(*gripper_boxes(open_jaw_m(width_m)), strict=True), (_wrist(), np.array([0.09, 0.09, 0.10]))]:
            placed = T @ T_box
            corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * size / 2
            lowest = min(lowest, float((corners @ placed[:3, :3].T + placed[:3, 3])[:, 2].min()) - back_m * T[2, 2])
    for margin in (-1e-6, 1e-6):
        assert clears_table(T[None], np.array([width_m]), lowest + margin, APPROACH_M)[0] == (margin < 0)


def _wrist() -> Float[np.ndarray, "4 4"]:
    T = np.eye(4)
    T[2, 3] = -0.18
    return T


def test_reach_is_likeliest_from_above_and_never_certain() -> None:
    tilts = np.radians([0.0, 30.0, 60.0, 90.0, 120.0])
    T = np.array([tcp_pose((0, 0, 0), (np.sin(t), 0, -np.cos(t)), (0, 1, 0)) for t in tilts])
    chance = reach_chance(T)
    assert np.all(np.diff(chance) < 0.0 + 1e-12)
    assert chance[0] == pytest.approx(0.9)
    assert chance.min() > 0.0


def test_a_jaw_that_cannot_open_further_stays_within_the_gripper() -> None:
    assert open_jaw_m(0.075) == MAX_JAW_M
    box = trimesh.creation.box(extents=(0.05, 0.075, 0.05))
    assert clearance_of(box).is_free(tcp_pose((0, 0, 0), (1, 0, 0), (0, 1, 0)), 0.075)
