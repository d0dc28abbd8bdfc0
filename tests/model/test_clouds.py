"""Laws of the target-conditioned clouds, and brute-force twins of farthest-point sampling and ball query."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from model.clouds import ball_query, farthest_point_order, grouped_clouds, sample_cloud
from model.errors import InputError
from model.inputs import ENVIRONMENT, OBJECT, OBSTACLE, TARGET, ReleaseInputs, SceneCloud
from model.settings import RankerSettings
from tables.poses import inverse, matrix_of

# Whole numbers: distances are exact in float32, and ties and duplicates are common.
_LATTICE = arrays(np.float32, st.tuples(st.integers(1, 24), st.just(3)), elements=st.integers(-3, 3).map(float))


@given(points=_LATTICE, n_chosen=st.integers(1, 30))
def test_farthest_point_order_equals_brute_force(points: np.ndarray, n_chosen: int) -> None:
    chosen = [0]
    while len(chosen) < min(n_chosen, len(points)):
        left = [k for k in range(len(points)) if k not in chosen]
        distance = {k: min(sum((points[k] - points[c]) ** 2) for c in chosen) for k in left}
        chosen.append(max(left, key=lambda k: (distance[k], -k)))
    assert farthest_point_order(points, n_chosen).tolist() == chosen


@given(points=_LATTICE, n_centres=st.integers(1, 24), radius=st.sampled_from([0.5, 1.0, 1.5, 3.0, 20.0]), n_neighbours=st.integers(1, 30))
def test_ball_query_equals_brute_force(points: np.ndarray, n_centres: int, radius: float, n_neighbours: int) -> None:
    centres = points[:n_centres]
    found = ball_query(points, centres, radius, n_neighbours).tolist()
    for centre, mine in zip(centres, found, strict=True):
        inside = [k for k in range(len(points)) if sum((points[k] - centre) ** 2) <= radius**2]
        listed = inside[: min(n_neighbours, len(points))]
        assert mine[: len(listed)] == listed
        assert set(mine[len(listed) :]) <= {listed[0]}


@given(seed=st.integers(0, 2**16), has_obstacle=st.booleans())
def test_cloud_does_not_depend_on_the_order_of_points(tiny: RankerSettings, seed: int, has_obstacle: bool) -> None:
    cloud = _scene(seed, has_obstacle)
    order = np.random.default_rng(seed + 1).permutation(len(cloud.points_m))
    shuffled = replace(cloud, points_m=cloud.points_m[order], point_types=cloud.point_types[order])
    for mine, theirs in zip(sample_cloud(cloud, tiny), sample_cloud(shuffled, tiny), strict=True):
        np.testing.assert_array_equal(mine, theirs)


@pytest.mark.parametrize("has_obstacle", [True, False])
def test_each_type_has_a_quarter_and_leading_points_are_balanced(tiny: RankerSettings, has_obstacle: bool) -> None:
    points, types = sample_cloud(_scene(0, has_obstacle), tiny)
    shares = {ENVIRONMENT: 1, OBJECT: 1, TARGET: 1, OBSTACLE: 1} if has_obstacle else {ENVIRONMENT: 2, OBJECT: 1, TARGET: 1, OBSTACLE: 0}
    assert points.shape == (tiny.n_points, 3)
    for n in (tiny.n_points, tiny.n_centres_1, tiny.n_centres_2):
        for number, share in shares.items():
            assert abs(np.count_nonzero(types[:n] == number) - share * n / 4) <= 1


def test_too_few_points_are_repeated(tiny: RankerSettings) -> None:
    cloud = _scene(0, has_obstacle=False)
    few = (cloud.point_types != OBJECT) | (np.cumsum(cloud.point_types == OBJECT) <= 3)
    points, types = sample_cloud(replace(cloud, points_m=cloud.points_m[few], point_types=cloud.point_types[few]), tiny)
    assert np.count_nonzero(types == OBJECT) == tiny.n_points // 4
    assert len(np.unique(points[types == OBJECT], axis=0)) == 3


def test_far_environment_is_cropped_and_an_empty_crop_is_an_error(tiny: RankerSettings) -> None:
    cloud = _scene(0, has_obstacle=True)
    far = replace(
        cloud,
        points_m=np.concatenate([cloud.points_m, np.float32([[5.0, 0.0, 0.0]])]),
        point_types=np.append(cloud.point_types, ENVIRONMENT),
    )
    np.testing.assert_array_equal(sample_cloud(far, tiny)[0], sample_cloud(cloud, tiny)[0])
    with pytest.raises(InputError, match="full-0000 has no environment point"):
        sample_cloud(replace(cloud, points_m=cloud.points_m + np.float32(9.0)), tiny)


def test_target_copy_is_the_object_moved_to_the_target(tiny: RankerSettings) -> None:
    inputs = _inputs([_scene(0, has_obstacle=True)])
    clouds = grouped_clouds(inputs, tiny, has_target_copy=True)
    for points, types, T_base_target in zip(clouds.points_m.numpy(), clouds.types.numpy(), inputs.T_base_target, strict=True):
        T = T_base_target @ inverse(inputs.clouds[0].T_base_object)
        expected = points[types == OBJECT].astype(np.float64) @ T[:3, :3].T + T[:3, 3]
        np.testing.assert_allclose(points[types == TARGET], expected, atol=1e-6)  # float32 at 1 m


def test_without_target_hypothesis_only_the_copy_is_gone(tiny: RankerSettings) -> None:
    inputs = _inputs([_scene(0, has_obstacle=True), _scene(1, has_obstacle=False)])
    with_copy, without = (grouped_clouds(inputs, tiny, has_target_copy=flag) for flag in (True, False))
    for g in range(len(inputs.group_scene)):
        kept = with_copy.types[g] != TARGET
        torch.testing.assert_close(without.points_m[g], with_copy.points_m[g][kept], rtol=0, atol=0)
        assert TARGET not in without.types[g]


def test_neighbourhoods_are_those_of_each_cloud(tiny: RankerSettings) -> None:
    inputs = _inputs([_scene(k, has_obstacle=k % 2 == 0) for k in range(3)])
    clouds = grouped_clouds(inputs, tiny, has_target_copy=True)
    for g, points in enumerate(clouds.points_m.numpy()):
        for neighbours, n_centres, radius_m in (
            (clouds.neighbours_1[g], tiny.n_centres_1, tiny.radius_1_m),
            (clouds.neighbours_2[g], tiny.n_centres_2, tiny.radius_2_m),
        ):
            assert neighbours.max() < (tiny.n_points if n_centres == tiny.n_centres_1 else tiny.n_centres_1)
            offsets = points[neighbours] - points[:n_centres, None]
            assert np.linalg.norm(offsets, axis=-1).max() <= radius_m + 1e-6


def _scene(seed: int, has_obstacle: bool) -> SceneCloud:
    rng = np.random.default_rng(seed)
    table = np.column_stack([rng.uniform(0.2, 0.9, 80), rng.uniform(-0.5, 0.5, 80), np.zeros(80)])
    parts = [(ENVIRONMENT, table), (OBJECT, np.array([0.5, 0.1, 0.06]) + rng.uniform(-0.05, 0.05, (40, 3)))]
    if has_obstacle:
        parts.append((OBSTACLE, np.array([0.6, -0.2, 0.06]) + rng.uniform(-0.05, 0.05, (30, 3))))
    points = np.concatenate([part for _, part in parts]).astype(np.float32)
    types = np.concatenate([np.full(len(part), number) for number, part in parts])
    return SceneCloud(f"full-{seed:04d}", points, types, matrix_of(np.array([0.5, 0.1, 0.06, 0, 0, 0, 1.0])))


def _inputs(scenes: list[SceneCloud]) -> ReleaseInputs:
    """Two targets a scene, one candidate each."""
    n = 2 * len(scenes)
    rng = np.random.default_rng(7)
    T_base_target = matrix_of(np.column_stack([rng.uniform(0.3, 0.6, (n, 3)), rng.normal(size=(n, 4))]))
    eye = np.tile(np.eye(4), (n, 1, 1))
    ids = tuple(f"{scene.scene_id}-t{t}-g00" for scene in scenes for t in range(2))
    return ReleaseInputs(tuple(scenes), np.arange(n) // 2, np.arange(n) % 2, T_base_target, ids, np.arange(n), eye, eye)
