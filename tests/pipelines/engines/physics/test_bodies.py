"""Laws of what Bullet is given of an object: sizes after padding, mass frames, boxes and halves."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from objects.object_model import ObjectModel
from pipelines.engines.physics.bodies import HULL_MARGIN_M, object_body, shrunk_hull
from tests.pipelines.engines.physics.object_models import can_model, cuboid_model, mug_model


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(8, 40), st.floats(0.015, 0.1))
def test_shrunk_hull_padded_again_has_the_size_of_the_part(seed: int, n: int, size_m: float) -> None:
    points = np.random.default_rng(seed).normal(size=(n, 3))
    points *= size_m / np.linalg.norm(points, axis=1, keepdims=True)
    shrunk = shrunk_hull(points, HULL_MARGIN_M).vertices_m
    planes = ConvexHull(points).equations
    heights = shrunk @ planes[:, :3].T + planes[:, 3]
    # The largest ball inside: its centre is at least its radius below every face.
    ball = linprog([0, 0, 0, -1], A_ub=np.c_[planes[:, :3], np.ones(len(planes))], b_ub=-planes[:, 3], bounds=[(None, None)] * 4)
    # No vertex is nearer to any face than the padding (half of the ball's radius in a sliver), and some vertex is exactly that near to
    # some face (1 nm: rounded planes).
    assert heights.max() == pytest.approx(-min(HULL_MARGIN_M, ball.x[3] / 2), abs=1e-8)


def test_a_plate_thinner_than_the_padding_keeps_an_inside() -> None:
    plate = np.array([[x, y, z] for x in (0, 0.05) for y in (0, 0.04) for z in (0, 0.0012)])
    shrunk = shrunk_hull(plate, HULL_MARGIN_M).vertices_m
    assert np.ptp(shrunk[:, 2]) == pytest.approx(0.0006, abs=1e-9)  # half of the inscribed ball's radius off each side


@pytest.mark.parametrize("object_model", [can_model(), cuboid_model(), mug_model()], ids=lambda object_model: object_model.object_id)
def test_principal_frame_gives_back_inertia_and_centre_of_mass(object_model: ObjectModel) -> None:
    body = object_body(object_model)
    R = body.T_object_mass[:3, :3]
    assert np.linalg.det(R) == pytest.approx(1.0)
    np.testing.assert_allclose(R @ np.diag(body.principal_inertia_kg_m2) @ R.T, object_model.inertia_kg_m2, atol=1e-12)
    np.testing.assert_array_equal(body.T_object_mass[:3, 3], object_model.com_m)


def test_boxes_are_boxes_and_a_lone_hull_is_two() -> None:
    assert len(object_body(cuboid_model()).boxes) == 1
    assert object_body(cuboid_model()).hulls_obj == ""
    assert object_body(can_model()).hulls_obj.count("o part_") == 2
    mug = object_body(mug_model())
    assert len(mug.boxes) + mug.hulls_obj.count("o part_") == len(mug_model().parts)


def test_the_two_halves_of_a_can_fill_it() -> None:
    object_model, body = can_model(), object_body(can_model())
    halves = [
        np.array([line.split()[1:] for line in half.splitlines() if line.startswith("v ")], dtype=float)
        for half in body.hulls_obj.split("o part_")[1:]
    ]
    whole = shrunk_hull(object_model.parts[0].vertices_m, HULL_MARGIN_M).vertices_m
    # 1e-9 of 3.9e-4 m3: the OBJ holds nine decimals.
    assert sum(ConvexHull(half).volume for half in halves) == pytest.approx(ConvexHull(whole).volume, rel=1e-6)
    assert halves[0][:, 2].max() == pytest.approx(halves[1][:, 2].min(), abs=1e-9)


def test_a_turned_box_is_not_taken_for_an_aligned_one() -> None:
    object_model = cuboid_model()
    turned = Rotation.from_euler("z", 10, degrees=True).apply(object_model.parts[0].vertices_m)
    part = type(object_model.parts[0])(turned, object_model.parts[0].faces)
    other = type(object_model)(**{name: getattr(object_model, name) for name in object_model.__slots__} | {"parts": (part,)})
    assert object_body(other).boxes == ()
