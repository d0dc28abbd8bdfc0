"""The fast view against its slow twin, and laws of what is near the hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from model.features import FEATURES, POSE_FEATURES, TURNING
from model.geometry import candidate_geometry, place_pose
from model.hand_view import NEAR_PHASES, HandView, hand_view, pose_view
from model.inputs import ENVIRONMENT, OBSTACLE, InputReader, ReleaseInputs, SceneCloud, read_inputs, restricted
from model.local_settings import LocalSettings
from tables.poses import inverse

ALL_POINTS = LocalSettings(n_object_points=4096, n_obstacle_points=4096, n_environment_points=4096)


@pytest.fixture(scope="module")
def inputs(small_release: Path) -> ReleaseInputs:
    return read_inputs(InputReader(small_release))


def _of_scene(inputs: ReleaseInputs, scene: int) -> ReleaseInputs:
    return restricted(inputs, np.flatnonzero(inputs.group_scene == scene))


def _view(inputs: ReleaseInputs, settings: LocalSettings) -> HandView:
    (cloud,) = inputs.clouds
    return hand_view(cloud, inputs.T_base_grasp, inputs.T_base_target[inputs.candidate_group], settings)


@pytest.mark.parametrize("scene", range(5))
def test_with_every_point_it_equals_the_slow_geometry(inputs: ReleaseInputs, scene: int) -> None:
    """Positions are within a metre, so float32 leaves them to 0.1 micrometres and differences of a few of them to some more."""
    own = _of_scene(inputs, scene)
    exact, fast = candidate_geometry(own), _view(own, ALL_POINTS).features
    for k, feature in enumerate(FEATURES):
        np.testing.assert_allclose(fast[:, k], exact[:, k], rtol=0, atol=1e-5, err_msg=feature.name)


def test_thinned_obstacles_are_never_nearer_than_all_of_them(inputs: ReleaseInputs) -> None:
    scene = next(k for k, cloud in enumerate(inputs.clouds) if OBSTACLE in cloud.point_types)
    own = _of_scene(inputs, scene)
    whole, few = (_view(own, settings).features for settings in (ALL_POINTS, LocalSettings(n_obstacle_points=10)))
    gaps = [k for k, feature in enumerate(FEATURES) if feature.name.endswith("_obstacle_m")]
    others = [k for k in range(len(FEATURES)) if k not in gaps]
    assert np.all(few[:, gaps] >= whole[:, gaps] - 1e-6)
    assert np.any(few[:, gaps] > whole[:, gaps] + 1e-3)
    np.testing.assert_array_equal(few[:, others], whole[:, others])


def test_near_points_are_those_that_come_nearest_to_the_hand(inputs: ReleaseInputs) -> None:
    """Brute force over every point, by the distances that the view itself gives for all of them."""
    settings = replace(ALL_POINTS, n_near_obstacle=7, n_near_environment=5)
    for scene, cloud in enumerate(inputs.clouds):
        own = _of_scene(inputs, scene)
        few, everything = _view(own, settings), _view(own, replace(ALL_POINTS, n_near_obstacle=400, n_near_environment=400))
        for number, n_near in ((OBSTACLE, 7), (ENVIRONMENT, 5)):
            if number not in cloud.point_types:
                assert number not in few.near_types
                continue
            chosen = few.near_m[:, few.near_types[0] == number]
            of_type = everything.near_m[:, everything.near_types[0] == number]
            assert chosen.shape[1] == n_near
            nearest = [points[..., 3:].min(axis=2) for points in (chosen, of_type)]
            np.testing.assert_allclose(nearest[0], np.sort(nearest[1], axis=1)[:, :n_near], atol=1e-6)
            assert np.all(np.diff(nearest[0], axis=1) >= 0)


def test_near_points_lie_in_the_frame_of_the_hand(inputs: ReleaseInputs) -> None:
    """Moved back to the base frame, each is one of the points of the scene."""
    (own,) = (_of_scene(inputs, next(k for k, cloud in enumerate(inputs.clouds) if OBSTACLE in cloud.point_types)),)
    (cloud,) = own.clouds
    T_base_target = own.T_base_target[own.candidate_group]
    view = _view(own, LocalSettings())
    T_base_place = place_pose(T_base_target, cloud.T_base_object, own.T_base_grasp)
    for k in (0, len(T_base_place) - 1):
        back_m = view.near_m[k, :, :3] @ T_base_place[k, :3, :3].T + T_base_place[k, :3, 3]
        gap_m = np.linalg.norm(back_m[:, None] - cloud.points_m[None], axis=2).min(axis=1)
        assert gap_m.max() < 1e-6


def test_the_view_does_not_depend_on_the_order_of_points_or_candidates(inputs: ReleaseInputs) -> None:
    own = _of_scene(inputs, 1)
    (cloud,) = own.clouds
    rng = np.random.default_rng(0)
    order, rows = rng.permutation(len(cloud.points_m)), rng.permutation(len(own.T_base_grasp))
    T_base_target = own.T_base_target[own.candidate_group]
    view = hand_view(cloud, own.T_base_grasp, T_base_target, LocalSettings())
    shuffled = SceneCloud(cloud.scene_id, cloud.points_m[order], cloud.point_types[order], cloud.T_base_object)
    other = hand_view(shuffled, own.T_base_grasp[rows], T_base_target[rows], LocalSettings())
    np.testing.assert_array_equal(other.features, view.features[rows])
    np.testing.assert_array_equal(other.near_m, view.near_m[rows])


def test_turning_the_scene_about_the_base_axis_changes_what_is_listed_and_nothing_else(inputs: ReleaseInputs) -> None:
    own = _of_scene(inputs, 1)
    (cloud,) = own.clouds
    turn = np.eye(4)
    turn[:2, :2] = [[0.8, -0.6], [0.6, 0.8]]
    T_base_target = own.T_base_target[own.candidate_group]
    moved = SceneCloud(cloud.scene_id, (cloud.points_m @ turn[:3, :3].T).astype(np.float32), cloud.point_types, turn @ cloud.T_base_object)
    view = hand_view(cloud, own.T_base_grasp, T_base_target, ALL_POINTS)
    turned = hand_view(moved, turn @ own.T_base_grasp, turn @ T_base_target, ALL_POINTS)
    for k, feature in enumerate(FEATURES):
        is_equal = np.allclose(turned.features[:, k], view.features[:, k], atol=1e-5)
        assert is_equal is (feature.name not in TURNING), feature.name
    # Near points may swap where two are equally far; their distances may not.
    np.testing.assert_allclose(turned.near_m[..., 3:].min(axis=2), view.near_m[..., 3:].min(axis=2), atol=1e-5)


def test_a_pose_view_has_the_features_of_poses_and_no_point(inputs: ReleaseInputs) -> None:
    own = _of_scene(inputs, 0)
    (cloud,) = own.clouds
    T_base_target = own.T_base_target[own.candidate_group]
    view = pose_view(cloud.T_base_object, own.T_base_grasp, T_base_target)
    # The table of the synthetic scenes is at z = 0 exactly.
    np.testing.assert_allclose(view.features, candidate_geometry(own)[:, : len(POSE_FEATURES)], atol=1e-6)
    assert view.near_m.shape == (len(T_base_target), 0, 3 + len(NEAR_PHASES))
    np.testing.assert_allclose(inverse(own.T_base_grasp) @ cloud.T_base_object, own.T_grasp_object, atol=1e-12)
