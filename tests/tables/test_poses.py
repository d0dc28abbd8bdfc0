"""Pose rows and 4x4: round trips, and scipy as the independent reference."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from scipy.spatial.transform import Rotation

from tables.poses import inverse, matrix_of, pose_of, rotation_angle_rad
from tests.strategies import transforms, unit_quaternions

# Products of a few doubles of size one: rounding stays below this.
EPS = 1e-12


@given(transforms())
def test_round_trip(T: np.ndarray) -> None:
    assert np.allclose(matrix_of(pose_of(T)), T, atol=EPS)
    assert pose_of(T)[6] >= 0


@given(unit_quaternions())
def test_matrix_agrees_with_scipy(q: np.ndarray) -> None:
    assert np.allclose(matrix_of(np.array([0, 0, 0, *q]))[:3, :3], Rotation.from_quat(q).as_matrix(), atol=EPS)


@given(transforms(), transforms())
def test_angle_agrees_with_scipy(A: np.ndarray, B: np.ndarray) -> None:
    expected = (Rotation.from_matrix(A[:3, :3]).inv() * Rotation.from_matrix(B[:3, :3])).magnitude()
    assert rotation_angle_rad(A[:3, :3], B[:3, :3]) == pytest.approx(expected, abs=1e-7)


@given(transforms())
def test_inverse(T: np.ndarray) -> None:
    assert np.allclose(inverse(T) @ T, np.eye(4), atol=EPS)


def test_batches_equal_single_rows() -> None:
    poses = np.random.default_rng(0).normal(size=(5, 3, 7))
    singles = [[matrix_of(pose) for pose in row] for row in poses]
    assert np.array_equal(matrix_of(poses), np.array(singles))
    assert np.allclose(pose_of(matrix_of(poses)), [[pose_of(T) for T in row] for row in singles], atol=0)


def test_half_turns_keep_the_quaternion_unit() -> None:
    for axis in np.eye(3):
        T = np.eye(4)
        T[:3, :3] = Rotation.from_rotvec(np.pi * axis).as_matrix()
        assert np.allclose(matrix_of(pose_of(T)), T, atol=EPS)


def test_zero_quaternion_is_refused() -> None:
    with pytest.raises(ValueError, match="must be at least 1e-6"):
        matrix_of(np.zeros(7))
