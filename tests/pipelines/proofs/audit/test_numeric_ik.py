"""Numerical inverse kinematics against the closed form it audits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipelines.engines.robot.arm import Q_LOWER_RAD, Q_UPPER_RAD, fk, follow_line, ik
from pipelines.proofs.audit import numeric_ik
from pipelines.proofs.audit.bullet_scene import BulletScene
from tests.builders import can_model, panda_scene, pose
from tests.pipelines.engines.planning.test_collision import configurations


def test_numerical_inverse_kinematics_finds_what_the_closed_form_finds() -> None:
    object_model = can_model()
    n_found = 0
    with BulletScene(panda_scene(object_model), object_model) as world:
        for seed, q in enumerate(configurations(16, 3)):
            T = fk(q)
            found = numeric_ik.solutions(world, T, 16, np.random.default_rng(seed))
            n_found += len(found) > 0
            for solution in found:
                np.testing.assert_allclose(fk(solution), T, atol=1e-6)
                assert np.all((solution >= Q_LOWER_RAD) & (solution <= Q_UPPER_RAD))
        # From so far away the pose cannot be reached.
        assert numeric_ik.solutions(world, pose(1.4, 0.0, 0.5), 8, np.random.default_rng(0)) == []
    assert n_found >= 14


@pytest.mark.parametrize("angle_rad", [0.0, 1e-9, 1e-4, 0.7, 2.0, 3.0, math.pi - 1e-4])
def test_turns_are_scipys(angle_rad: float) -> None:
    for axis in np.random.default_rng(0).normal(size=(20, 3)):
        turn = angle_rad * axis / np.linalg.norm(axis)
        np.testing.assert_allclose(numeric_ik._turn(Rotation.from_rotvec(turn).as_matrix()), turn, atol=1e-7)


def test_half_a_turn_has_its_length() -> None:
    assert np.linalg.norm(numeric_ik._turn(np.diag([1.0, -1.0, -1.0]))) == pytest.approx(math.pi)


def test_numerical_lines_are_the_closed_forms() -> None:
    object_model = can_model()
    T = np.diag([1.0, -1.0, -1.0, 1.0])
    T[:3, 3] = (0.5, 0.1, 0.2)
    T_up = T.copy()
    T_up[2, 3] += 0.1
    q = ik(T, 16)[5]
    expected = follow_line(T, T_up, q, 0.0025, 0.1)
    assert expected is not None
    with BulletScene(panda_scene(object_model), object_model) as world:
        line = numeric_ik.follow_line(world, T, T_up, q, 0.0025, 0.1)
    assert line is not None
    np.testing.assert_allclose(line, expected, atol=1e-5)
