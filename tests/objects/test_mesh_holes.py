"""Holes of mesh files: capped where the rim is flat and little can have been there, else refused, in whatever order the faces come."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from objects.catalogue import MeshShape
from objects.user_mesh import user_mesh
from tests.objects.shapes import agreed, bumpy_ball


def ball(subdivisions: int = 3) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.03)


def box(subdivisions: int = 0) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(extents=(0.04, 0.05, 0.06))
    for _ in range(subdivisions):
        mesh = mesh.subdivide()
    return mesh


def without(mesh: trimesh.Trimesh, faces: list[int]) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, np.delete(mesh.faces, faces, axis=0), process=False)


SOLIDS = {
    "box": lambda n: box(n),
    "can": lambda n: trimesh.creation.cylinder(radius=0.03, height=0.08, sections=12 * n + 12),
    "ball": lambda n: ball(n),
    "bumpy ball": lambda n: bumpy_ball(n),
}


@settings(max_examples=40, deadline=None)
@given(st.sampled_from(sorted(SOLIDS)), st.integers(0, 3), st.integers(0, 2**16), st.integers(1, 8), st.integers(1, 2))
def test_a_hole_is_capped_to_the_volume_of_the_whole_or_refused(kind: str, fineness: int, seed: int, n_gone: int, n_holes: int) -> None:
    mesh, rng = SOLIDS[kind](fineness), np.random.default_rng(seed)
    mesh.apply_translation(rng.uniform(-0.1, 0.1, 3))
    gone = set()
    for _ in range(n_holes):
        hole = {int(rng.integers(len(mesh.faces)))}
        while len(hole) < min(n_gone, len(mesh.faces) // 4):
            beside = [int(b) for pair in mesh.face_adjacency for a, b in (pair, pair[::-1]) if int(a) in hole and int(b) not in hole]
            hole.add(beside[rng.integers(len(beside))])
        gone |= hole
    found = agreed(without(mesh, sorted(gone)))
    if isinstance(found, float):
        assert found == pytest.approx(float(mesh.volume) * 1e6, rel=0.02)
    else:
        assert "is not watertight: " in found


@pytest.mark.parametrize("n_gone", [1, 2, 6])
def test_small_holes_in_a_smooth_surface_are_capped_and_told(tmp_path: Path, n_gone: int) -> None:
    star = ball().vertex_faces[50][:n_gone]
    open_ball = without(ball(), star.tolist())
    assert agreed(open_ball) == pytest.approx(float(ball().volume) * 1e6, rel=2e-3)
    open_ball.export(tmp_path / "own.ply")
    notes = user_mesh("own", MeshShape(tmp_path / "own.ply")).notes
    assert notes[0].startswith(f"closed holes along {3 if n_gone == 1 else 4 if n_gone == 2 else 6} open edges, 0.")
    assert notes[-1].startswith("volume unknown in the file, 11")


def test_a_hole_in_a_flat_side_is_capped_without_a_change() -> None:
    mesh = box(subdivisions=3)
    side = np.flatnonzero(mesh.face_normals[:, 2] > 0.9)
    inner = [int(k) for k in side if np.all(np.abs(mesh.triangles_center[k, :2]) < 0.006)]
    assert len(inner) > 3
    assert agreed(without(mesh, inner)) == pytest.approx(120.0, rel=1e-5)


def test_a_rim_with_vertices_in_a_line_is_capped() -> None:
    mesh = box()
    a, b, c = (int(k) for k in mesh.faces[0])
    middle = [*mesh.vertices, (mesh.vertices[a] + mesh.vertices[b]) / 2]
    halves = [[a, 8, c], [8, b, c]]  # its neighbour keeps the whole edge
    assert agreed(trimesh.Trimesh(middle, [*mesh.faces[1:], *halves], process=False)) == pytest.approx(120.0, rel=1e-5)


def test_a_bent_rim_is_refused_in_every_order_with_its_edges_and_its_bend() -> None:
    """Two faces gone across an edge of a box of twelve: caps of 100 and of 120 cm3 are as good as each other."""
    mesh = box()
    for pair in mesh.face_adjacency[mesh.face_adjacency_angles > 1.0]:
        said = agreed(without(mesh, pair.tolist()), n_orders=4)
        assert isinstance(said, str)
        assert "is not watertight: 4 open edges in 1 loop, 1 bent by up to " in said
        assert "mm, must be flat within 0.877 mm; no cap closes it safely" in said


def test_a_flat_rim_that_may_have_held_much_is_refused_with_both_volumes() -> None:
    said = agreed(without(box(), [11]))
    assert isinstance(said, str)
    assert "holes along 3 open edges, " in said
    assert "must be at most 2% of the 120 cm3 within flat caps" in said


def test_a_rim_that_crosses_itself_is_refused() -> None:
    """A bow tie: a side of a box whose rim goes over itself."""
    corners = [[-0.02, -0.02, 0.0], [0.02, 0.02, 0.0], [0.02, -0.02, 0.0], [-0.02, 0.02, 0.0], [0.0, 0.0, 0.05]]
    tent = trimesh.Trimesh(corners, [[k, (k + 1) % 4, 4] for k in range(4)], process=False)
    assert "4 open edges in 1 loop, 1 of which run over themselves; no cap closes it safely" in str(agreed(tent))
