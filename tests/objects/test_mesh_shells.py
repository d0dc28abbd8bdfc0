"""Mesh files whose bodies touch or whose faces are there twice: the same solid as without, in every format and order of the faces."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from objects.catalogue import MeshShape
from objects.user_mesh import user_mesh
from tests.objects.shapes import agreed

BOX_CM3 = 24.0


def box(at: tuple[float, float, float] = (0.0, 0.0, 0.0), size: tuple[float, float, float] = (0.02, 0.03, 0.04)) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(extents=size)
    mesh.apply_translation(at)
    return mesh


def both(*meshes: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.util.concatenate(list(meshes))


def inside_out(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    turned = mesh.copy()
    turned.invert()
    return turned


def mirrored(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The diagonals of its sides run the other way."""
    flipped = mesh.copy()
    flipped.apply_transform(np.diag([1.0, -1.0, 1.0, 1.0]))
    return flipped


@pytest.mark.parametrize("shift", [(0.02, 0.0, 0.0), (0.0, 0.03, 0.0), (0.0, 0.0, -0.04)])
def test_boxes_that_share_a_side_are_joined(shift: tuple[float, float, float]) -> None:
    beside = box(shift)
    assert agreed(both(box(), beside)) == pytest.approx(2 * BOX_CM3, rel=1e-5)
    other = mirrored(box())
    other.apply_translation(shift)
    assert agreed(both(box(), other)) == pytest.approx(2 * BOX_CM3, rel=1e-5)
    assert agreed(inside_out(both(box(), other))) == pytest.approx(2 * BOX_CM3, rel=1e-5)


def test_a_row_and_a_block_of_boxes_are_joined() -> None:
    row = [box((0.02 * k, 0.0, 0.0)) for k in range(4)]
    assert agreed(both(*row)) == pytest.approx(4 * BOX_CM3, rel=1e-5)
    block = [box((0.02 * i, 0.03 * j, 0.0)) for i in range(2) for j in range(2)]
    assert agreed(both(*block)) == pytest.approx(4 * BOX_CM3, rel=1e-5)


def test_what_was_joined_is_told(tmp_path: Path) -> None:
    both(box(), box((0.02, 0.0, 0.0))).export(tmp_path / "own.stl")
    notes = user_mesh("own", MeshShape(tmp_path / "own.stl")).notes
    assert notes == ("joined 2 bodies that overlap or touch into 1", "volume 48 cm3 in the file, 48 cm3 now")


@pytest.mark.parametrize("at", [(0.02, 0.03, 0.0), (0.02, 0.03, 0.04)])
def test_boxes_that_share_an_edge_or_a_corner_only_are_two(at: tuple[float, float, float]) -> None:
    assert "holds 2 separate bodies (50.0%, 50.0% of the volume), must be 1" in str(agreed(both(box(), box(at))))
    assert "holds 2 separate bodies" in str(agreed(inside_out(both(box(), box(at)))))


@pytest.mark.parametrize("doubled", [[0], [3, 4], list(range(5)), list(range(12))])
def test_faces_that_are_there_twice_count_once_and_that_is_told(tmp_path: Path, doubled: list[int]) -> None:
    mesh = box()
    for second in (mesh.faces[doubled], np.roll(mesh.faces[doubled], 1, axis=1)):
        twice = trimesh.Trimesh(mesh.vertices, [*mesh.faces, *second], process=False)
        assert agreed(twice) == pytest.approx(BOX_CM3, rel=1e-5)
        twice.export(tmp_path / "own.ply")
        notes = user_mesh("own", MeshShape(tmp_path / "own.ply")).notes
        assert notes == (f"left out {len(doubled)} faces that were there twice", "volume 24 cm3 in the file, 24 cm3 now")


@pytest.mark.parametrize("doubled", [[0], [3, 4], list(range(12))])
def test_faces_that_are_there_with_both_windings_bound_one_solid(doubled: list[int]) -> None:
    mesh = box()
    twice = trimesh.Trimesh(mesh.vertices, [*mesh.faces, *mesh.faces[doubled][:, ::-1]], process=False)
    assert agreed(twice) == pytest.approx(BOX_CM3, rel=1e-5)


def test_boxes_that_touch_and_are_there_twice_are_joined() -> None:
    pair = both(box(), box((0.02, 0.0, 0.0)))
    assert agreed(both(pair, pair)) == pytest.approx(2 * BOX_CM3, rel=1e-5)


def test_a_body_inside_out_beside_another_is_the_sum_or_refused() -> None:
    for wrong in (inside_out(box((0.02, 0.0, 0.0))), inside_out(box((0.02, 0.0, 0.0), (0.02, 0.01, 0.01)))):
        found = agreed(both(box(), wrong))
        assert isinstance(found, str) or found == pytest.approx(BOX_CM3 + abs(wrong.volume) * 1e6, rel=1e-5)


def test_holes_that_meet_in_a_vertex_are_capped_each() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.03)
    around = ball.vertex_faces[100]
    beside = [int(k) for k in around if not set(ball.faces[k]) & set(ball.faces[around[0]]) - {100} and k >= 0]
    holed = trimesh.Trimesh(ball.vertices, np.delete(ball.faces, [int(around[0]), beside[0]], axis=0), process=False)
    assert agreed(holed) == pytest.approx(float(ball.volume) * 1e6, rel=1e-5)


def test_a_loose_face_is_left_out() -> None:
    loose = trimesh.Trimesh([[0.0, 0.0, 0.03], [0.001, 0.0, 0.03], [0.0, 0.001, 0.03]], [[0, 1, 2]], process=False)
    assert agreed(both(box(), loose)) == pytest.approx(BOX_CM3, rel=1e-5)


def test_an_inside_out_body_that_sticks_out_of_another_is_joined_in_every_order() -> None:
    bar = box((0.015, 0.0, 0.0), (0.02, 0.01, 0.01))
    assert agreed(both(box(), inside_out(bar)), n_orders=4) == pytest.approx(BOX_CM3 + 1.5, rel=1e-5)


def test_a_fin_is_refused_with_its_edges() -> None:
    mesh = box()
    fin = trimesh.Trimesh([*mesh.vertices, [0.0, 0.0, 0.1]], [*mesh.faces, [*mesh.faces[0][:2], 8]], process=False)
    assert "is not watertight: " in str(agreed(fin))
