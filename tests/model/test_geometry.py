"""Laws of the derived geometry: what it may depend on, what must not change it, and a scene small enough to check by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from scipy.spatial.transform import RigidTransform

from model.errors import ForbiddenColumnError, InputError
from model.features import CANDIDATE_GEOMETRY, FEATURES, FURTHEST_M, RAW_POSE_FEATURES, Feature
from model.geometry import candidate_geometry, geometry_table, place_pose
from model.hand import SHOULDER_M, WRIST_FROM_TCP_M, WRIST_OFFSET_M
from model.inputs import ENVIRONMENT, OBJECT, OBSTACLE, InputReader, ReleaseInputs, SceneCloud, read_inputs, restricted
from tables.columns import joint_columns
from tables.poses import inverse
from tables.store import read_table, write_table
from tests.model.damage import rewrite, set_values
from tests.strategies import transforms

_NUMBER = {feature.name: k for k, feature in enumerate(FEATURES)}


@pytest.fixture(scope="module")
def inputs(small_release: Path) -> ReleaseInputs:
    return read_inputs(InputReader(small_release))


@pytest.fixture(scope="module")
def geometry(inputs: ReleaseInputs) -> np.ndarray:
    return candidate_geometry(inputs)


def test_every_feature_has_its_own_name_and_varies(geometry: np.ndarray) -> None:
    assert len(_NUMBER) == len(FEATURES) == geometry.shape[1]
    assert FEATURES[: len(RAW_POSE_FEATURES)] == RAW_POSE_FEATURES
    constant = [feature.name for feature, values in zip(FEATURES, geometry.T, strict=True) if np.ptp(values) == 0.0]
    assert constant == []


def test_a_feature_without_meaning_or_with_a_strange_unit_is_refused() -> None:
    for wrong in (("wide-ness", "m", "width"), ("width", "mm", "width"), ("width", "m", "")):
        with pytest.raises(ValueError, match="must have a name, a meaning, and a unit"):
            Feature(*wrong)


@settings(max_examples=25)
@given(transforms(), transforms(), transforms())
def test_the_hand_at_the_place_holds_the_object_as_it_did(target: np.ndarray, initial: np.ndarray, grasp: np.ndarray) -> None:
    place = place_pose(target, initial, grasp)
    poses = [RigidTransform.from_matrix(T) for T in (target, initial, grasp)]
    expected = poses[0] * poses[1].inv() * poses[2]
    np.testing.assert_allclose(place, expected.as_matrix(), rtol=0, atol=1e-13)
    np.testing.assert_allclose(inverse(place) @ target, inverse(grasp) @ initial, rtol=0, atol=1e-13)


def test_order_of_points_and_names_change_nothing(inputs: ReleaseInputs, geometry: np.ndarray) -> None:
    rng = np.random.default_rng(1)
    shuffled = []
    for k, cloud in enumerate(inputs.clouds):
        order = rng.permutation(len(cloud.points_m))
        shuffled.append(SceneCloud(f"other-{k}", cloud.points_m[order], cloud.point_types[order], cloud.T_base_object))
    renamed = replace(inputs, clouds=tuple(shuffled), candidate_ids=tuple(f"c{k}" for k in range(len(inputs.candidate_ids))))
    np.testing.assert_array_equal(candidate_geometry(renamed), geometry)


def test_a_candidate_is_alone_what_it_is_among_others(inputs: ReleaseInputs, geometry: np.ndarray) -> None:
    groups = np.array([1, 9, 17])
    mine = np.isin(inputs.candidate_group, groups)
    np.testing.assert_array_equal(candidate_geometry(restricted(inputs, groups)), geometry[mine])


def test_a_scene_turned_about_the_base_axis_looks_the_same_to_the_arm(inputs: ReleaseInputs, geometry: np.ndarray) -> None:
    turn = np.eye(4)
    turn[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]  # a quarter: coordinates only change places, so that float32 points stay exact
    clouds = tuple(
        replace(c, points_m=c.points_m @ turn[:3, :3].T.astype(np.float32), T_base_object=turn @ c.T_base_object) for c in inputs.clouds
    )
    turned = replace(inputs, clouds=clouds, T_base_target=turn @ inputs.T_base_target, T_base_grasp=turn @ inputs.T_base_grasp)
    difference = np.abs(candidate_geometry(turned) - geometry).max(axis=0)
    seen = {name for name, k in _NUMBER.items() if difference[k] > 1e-12}
    in_base = [f"{pose}_{part}" for pose in ("grasp", "target", "composed") for part in ("x_m", "y_m", "yx", "yy", "zx", "zy")]
    # Relative poses, heights, directions in the plane of the arm and every distance stay.
    assert seen == {*in_base, "pick_azimuth_rad", "place_azimuth_rad"}


def test_only_the_five_inputs_change_it(release: Path, geometry: np.ndarray) -> None:
    """Planted leaks: what pick-lift, planning and execution found out is changed in every row, and not a bit of the geometry is."""
    grasps, candidates = (pq.read_table(release / f"{table}.parquet") for table in ("grasps", "candidates"))
    flipped = [not value for value in candidates["y_plan"].to_pylist()]
    rewrite(release / "candidates.parquet", candidates.set_column(candidates.column_names.index("y_plan"), "y_plan", [flipped]))
    for column in ("inhand_x_m", "lift_slip_m", joint_columns("lifted_q")[0]):
        grasps = grasps.set_column(grasps.column_names.index(column), column, [np.linspace(1.0, 2.0, grasps.num_rows)])
    rewrite(release / "grasps.parquet", grasps)
    for table in ("objects", "obstacles", "policy_features", "timings", "grasp_pool"):
        (release / f"{table}.parquet").unlink()
    np.testing.assert_array_equal(candidate_geometry(read_inputs(InputReader(release))), geometry)
    with pytest.raises(ForbiddenColumnError, match="inhand_x_m: known only after"):
        InputReader(release).columns("grasps", ["inhand_x_m"])


def test_each_of_the_inputs_changes_it(release: Path, geometry: np.ndarray) -> None:
    for table, column, value in (("targets", "target_x_m", 0.61), ("grasps", "grasp_z_m", 0.31), ("scene_points", "z_m", 0.5)):
        set_values(release, table, 0, {column: value})
        changed = candidate_geometry(read_inputs(InputReader(release)))
        assert (changed != geometry).any(), column


def test_a_scene_by_hand() -> None:
    """A post of 4 cm held in the middle from above, put down 20 cm further out, beside a point of an obstacle."""
    values = by_hand(obstacle_m=[0.60, 0.0, 0.10])
    expected = {
        "composed_x_m": 0.60,
        "composed_z_m": 0.10,
        "place_tcp_radius_m": 0.60,
        "place_wrist_radius_m": 0.60,
        "place_wrist_height_m": 0.10 + WRIST_FROM_TCP_M,
        "place_approach_up": -1.0,
        "place_approach_out": 0.0,
        "place_jaw_left": 1.0,
        "place_azimuth_rad": 0.0,
        "inhand_y_low_m": -0.02,
        "inhand_z_high_m": 0.10,
        "held_width_m": 0.04,
        "held_share": 2 / 12,  # the two points on the jaw axis of the middle ring
        "moved_height_m": 0.20,
        "turn_rad": 0.0,
        "tilt_rad": 0.0,
        "carry_m": 0.20,
        "place_lever_jaw_m": 0.0,
        "place_above_m": 0.0,
        "place_fingers_low_m": 0.10 - (0.00025 + 0.0185 / 2),
        "place_hand_low_m": 0.10 + 0.0834 - 0.046,
        # The point is the TCP at the place, between the pads: 4 cm held, 12 mm open on both sides, and 0.02 mm that the pads' boxes leave.
        "place_fingers_obstacle_m": 0.03202,
        "place_hand_obstacle_m": 0.0834 - 0.046,
        "above5_hand_obstacle_m": 0.05 + 0.0834 - 0.046,
        "above15_fingers_obstacle_m": np.hypot(0.03202, 0.15 - 0.00025 - 0.0185 / 2),
        "back15_fingers_low_m": 0.25 - (0.00025 + 0.0185 / 2),
        "place_wrist_obstacle_m": WRIST_FROM_TCP_M,
        "target_obstacle_m": 0.02,
        "place_reach_near_m": np.hypot(0.60 - WRIST_OFFSET_M, 0.10 + WRIST_FROM_TCP_M - SHOULDER_M[2]),
        "place_reach_far_m": np.hypot(0.60 + WRIST_OFFSET_M, 0.10 + WRIST_FROM_TCP_M - SHOULDER_M[2]),
    }
    assert {name: values[name] for name in expected} == pytest.approx(expected, abs=1e-7)  # points are float32


def test_without_obstacles_they_are_as_far_as_it_goes() -> None:
    values = by_hand(obstacle_m=None)
    distances = {name: value for name, value in values.items() if "obstacle" in name}
    assert len(distances) == 21
    assert set(distances.values()) == {FURTHEST_M}


def by_hand(obstacle_m: list[float] | None) -> dict[str, float]:
    sides = [[x, y, z] for z in (0.0, 0.10, 0.20) for x, y in ((0.42, 0.0), (0.38, 0.0), (0.40, 0.02), (0.40, -0.02))]
    table = [[0.2, 0.3, 0.0], [0.7, -0.3, 0.0]]
    obstacle = [] if obstacle_m is None else [obstacle_m]
    types = [ENVIRONMENT] * len(table) + [OBJECT] * len(sides) + [OBSTACLE] * len(obstacle)
    T_base_object, T_base_target, T_base_grasp = np.eye(4), np.eye(4), np.diag([1.0, -1.0, -1.0, 1.0])
    T_base_object[:3, 3] = 0.40, 0.0, 0.0
    T_base_target[:3, 3] = 0.60, 0.0, 0.0
    T_base_grasp[:3, :3] = np.diag([-1.0, 1.0, -1.0])
    T_base_grasp[:3, 3] = 0.40, 0.0, 0.10
    cloud = SceneCloud("scene", np.array([*table, *sides, *obstacle], dtype=np.float32), np.array(types), T_base_object)
    first = np.array([0])
    inputs = ReleaseInputs(
        (cloud,),
        first,
        first,
        T_base_target[None],
        ("candidate",),
        first,
        T_base_grasp[None],
        (inverse(T_base_grasp) @ T_base_object)[None],
    )
    return dict(zip(_NUMBER, candidate_geometry(inputs)[0].tolist(), strict=True))


def test_a_number_that_is_none_is_refused(inputs: ReleaseInputs) -> None:
    targets = inputs.T_base_target.copy()
    targets[0, 0, 3] = np.nan
    with pytest.raises(InputError, match=rf"{inputs.candidate_ids[0]}: target_x_m is nan, must be finite"):
        candidate_geometry(replace(inputs, T_base_target=targets))


def test_the_table_says_what_it_holds(inputs: ReleaseInputs, geometry: np.ndarray, tmp_path: Path) -> None:
    write_table(CANDIDATE_GEOMETRY, geometry_table(inputs, geometry), tmp_path / "candidate_geometry.parquet")
    table = read_table(CANDIDATE_GEOMETRY, tmp_path / "candidate_geometry.parquet", verify=True)
    assert table["candidate_id"].to_pylist() == sorted(inputs.candidate_ids)
    order = np.argsort(inputs.candidate_ids)
    for column in CANDIDATE_GEOMETRY.columns[1:]:
        np.testing.assert_array_equal(table[column.name].to_numpy(), geometry[order, _NUMBER[column.name]])
        assert column.meaning
        assert column.name.endswith(f"_{column.unit}") == bool(column.unit)
