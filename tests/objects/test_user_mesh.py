"""Mesh files as people have them: what is repaired and told, and the one line that says what is wrong with the others."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import trimesh

from objects.catalogue import MeshShape
from objects.errors import MeshError
from objects.mesh_repair import crossed_edges
from objects.mug import mug_mesh
from objects.solids import Solid, solid_of
from tests.objects.shapes import MUG_SHAPE, bumpy_ball, figure_eight, mesh_spec, spec_of

BOX_M3 = 0.05 * 0.06 * 0.07


def box(at: tuple[float, float, float] = (0.0, 0.0, 0.0), size: tuple[float, float, float] = (0.05, 0.06, 0.07)) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(extents=size)
    mesh.apply_translation(at)
    return mesh


def solid_of_file(mesh: trimesh.Trimesh, folder: Path, name: str = "own.ply", scale: float = 1.0) -> Solid:
    mesh.export(folder / name)
    return solid_of(mesh_spec(folder / name, scale))


def refusal(mesh: trimesh.Trimesh, folder: Path, name: str = "own.ply") -> str:
    with pytest.raises(MeshError) as error:
        solid_of_file(mesh, folder, name)
    assert "\n" not in str(error.value)
    assert str(error.value).startswith("own: ")
    return str(error.value)


@pytest.mark.parametrize("suffix", ["obj", "stl", "ply"])
def test_a_mesh_file_gives_the_same_solid_in_every_format_and_unit(tmp_path: Path, suffix: str) -> None:
    mesh = mug_mesh(MUG_SHAPE)
    scaled = mesh.copy()
    scaled.apply_scale(1000.0)
    scaled.apply_translation([300.0, -20.0, 7.0])
    scaled.export(tmp_path / f"own.{suffix}")
    loaded = solid_of(mesh_spec(tmp_path / f"own.{suffix}", scale=0.001)).mesh
    assert loaded.volume == pytest.approx(mesh.volume, rel=1e-4)  # STL and PLY hold single precision
    assert loaded.bounds.sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-7)
    assert loaded.extents == pytest.approx(mesh.extents, rel=1e-5)


def test_an_inside_out_mesh_file_is_turned_right(tmp_path: Path) -> None:
    mesh = box()
    mesh.invert()
    mesh.export(tmp_path / "own.ply")
    assert solid_of(mesh_spec(tmp_path / "own.ply")).mesh.volume == pytest.approx(0.05 * 0.06 * 0.07, rel=1e-5)


@pytest.mark.parametrize(("scale", "value"), [(1000.0, "50 m"), (0.001, "5e-05 m")])
def test_a_mesh_in_another_unit_is_refused_with_its_extent_and_the_bound(tmp_path: Path, scale: float, value: str) -> None:
    box().export(tmp_path / "own.stl")
    with pytest.raises(MeshError) as error:
        solid_of(mesh_spec(tmp_path / "own.stl", scale))
    assert "own: extent along x " + value in str(error.value)
    assert "[0.01, 0.4]" in str(error.value)


def test_a_good_mesh_is_left_alone_and_nothing_is_told(tmp_path: Path) -> None:
    solid = solid_of_file(mug_mesh(MUG_SHAPE), tmp_path)
    assert solid.notes == ()
    assert len(solid.mesh.faces) == len(mug_mesh(MUG_SHAPE).faces)


def test_what_no_cap_closes_is_refused_with_its_open_edges(tmp_path: Path) -> None:
    fin = trimesh.Trimesh([*box().vertices, [0.0, 0.0, 0.1]], [*box().faces, [*box().faces[0][:2], 8]], process=False)
    assert "is not watertight: " in refusal(fin, tmp_path)


def test_a_seam_is_welded_and_told(tmp_path: Path) -> None:
    corners = box().triangles.reshape(-1, 3) + np.random.default_rng(0).uniform(-1e-6, 1e-6, (36, 3)) + 2.4e-6
    solid = solid_of_file(trimesh.Trimesh(corners, np.arange(36).reshape(12, 3), process=False), tmp_path)
    assert solid.mesh.volume == pytest.approx(BOX_M3, rel=1e-3)
    assert "welded vertices within 0.01 mm" in solid.notes[0]


def test_faces_wound_both_ways_are_turned(tmp_path: Path) -> None:
    faces = box().faces.copy()
    faces[::3] = faces[::3, ::-1]
    solid = solid_of_file(trimesh.Trimesh(box().vertices, faces, process=False), tmp_path)
    assert solid.mesh.volume == pytest.approx(BOX_M3, rel=1e-5)
    assert "turned faces so that neighbours face the same side" in solid.notes


def test_bodies_that_overlap_are_joined_and_weigh_once(tmp_path: Path) -> None:
    bar = box((0.03, 0.0, 0.0), (0.04, 0.02, 0.02))
    solid = solid_of_file(trimesh.util.concatenate([box(), bar]), tmp_path)
    assert solid.mesh.volume == pytest.approx(BOX_M3 + 0.025 * 0.02 * 0.02, rel=1e-5)
    assert solid.notes[0] == "joined 2 bodies that overlap or touch into 1"
    assert solid.notes[1] == "volume 226 cm3 in the file, 220 cm3 now"


def test_separate_bodies_are_refused_with_their_number_and_shares(tmp_path: Path) -> None:
    said = refusal(trimesh.util.concatenate([box(), box((0.1, 0.0, 0.0), (0.03, 0.03, 0.03))]), tmp_path)
    assert "holds 2 separate bodies (88.6%, 11.4% of the volume), must be 1" in said


def test_crumbs_are_left_out_and_told(tmp_path: Path) -> None:
    solid = solid_of_file(trimesh.util.concatenate([box(), box((0.1, 0.0, 0.0), (0.002, 0.002, 0.002))]), tmp_path)
    assert solid.mesh.extents == pytest.approx([0.05, 0.06, 0.07], rel=1e-5)
    assert "left out 1 crumbs with 0.004% of the volume" in solid.notes


def test_a_sealed_void_is_filled_and_told(tmp_path: Path) -> None:
    void = box(size=(0.03, 0.03, 0.03))
    void.invert()
    solid = solid_of_file(trimesh.util.concatenate([box(), void]), tmp_path)
    assert solid.mesh.volume == pytest.approx(BOX_M3, rel=1e-5)
    filled = "filled 1 sealed void of 27 cm3, so that its inertia is that of a solid"
    assert solid.notes == (filled, "volume 183 cm3 in the file, 210 cm3 now")


def test_a_body_that_runs_through_itself_becomes_one_or_is_refused_with_both_volumes(tmp_path: Path) -> None:
    thin = figure_eight(radius_m=0.0051, reach_m=0.09)
    assert crossed_edges(thin) > 0
    solid = solid_of_file(thin, tmp_path)
    assert crossed_edges(solid.mesh) == 0
    assert 0.98 * thin.volume < solid.mesh.volume < thin.volume
    assert "made one of pieces that ran through each other at" in solid.notes[0]
    said = refusal(figure_eight(radius_m=0.008), tmp_path)
    assert "pieces that run through each other takes its volume from 47.6 to 44.97 cm3, must change by at most 2%" in said


def test_crossed_edges_are_found_as_by_testing_every_pair() -> None:
    assert crossed_edges(mug_mesh(MUG_SHAPE)) == 0
    mesh = figure_eight(radius_m=0.008, n_along=12, n_around=5)
    mesh.vertices += np.random.default_rng(0).uniform(-5e-4, 5e-4, mesh.vertices.shape)  # no crossing right on a side
    found = 0
    for edge in mesh.edges_unique:
        start, end = mesh.vertices[edge]
        for face in mesh.faces:
            if set(edge) & set(face):
                continue
            a, b, c = mesh.vertices[face]
            unknowns = np.column_stack([end - start, a - b, a - c])
            if abs(np.linalg.det(unknowns)) < 1e-18:
                continue
            t, u, v = np.linalg.solve(unknowns, a - start)
            if 0 < t < 1 and u > 0 and v > 0 and u + v < 1:
                found += 1
                break
    assert found == crossed_edges(mesh) > 0


def test_max_faces_simplifies_within_a_stated_distance(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.03)
    ball.export(tmp_path / "own.stl")
    with pytest.raises(MeshError, match=r"has 20480 faces, must be in \[4, 20000\]; set max_faces = 5000, say, to have it simplified"):
        solid_of(mesh_spec(tmp_path / "own.stl"))
    solid = solid_of(spec_of(MeshShape(tmp_path / "own.stl", max_faces=2000), "own"))
    assert len(solid.mesh.faces) <= 2000
    assert solid.mesh.volume == pytest.approx(ball.volume, rel=0.02)
    radius = np.linalg.norm(solid.mesh.vertices, axis=1)
    assert np.abs(radius - 0.03).max() < 5e-4
    assert solid.notes[0].startswith("simplified from 20480 to ")


def test_a_mesh_that_cannot_be_simplified_so_far_is_refused_with_what_was_tried(tmp_path: Path) -> None:
    bumpy_ball(subdivisions=4).export(tmp_path / "own.ply")
    with pytest.raises(MeshError, match=r"has \d+ faces after simplifying 5120 by 0\.5 mm, must be at most 100"):
        solid_of(spec_of(MeshShape(tmp_path / "own.ply", max_faces=100), "own"))


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("own.obj", "v 0 0\nf 1 2 3\n", "cannot be read: "),
        ("own.ply", "not a mesh", "cannot be read: "),
        ("own.glb", "not a mesh", "cannot be read: "),
        ("own.stl", "", "is empty (0 bytes)"),
        ("own.obj", "# no geometry\n", "has 0 faces, must be in [4, 20000]"),
        ("own.off", "OFF\n3 0 0\n0 0 0\n1 0 0\n0 1 0\n", "has 0 faces, must be in [4, 20000]"),
        ("own.dae", "<COLLADA/>", "has the extension '.dae', must be one of .glb, .obj, .off, .ply, .stl: convert it"),
        ("own.xyz7", "?", "has the extension '.xyz7', must be one of"),
        ("own", "?", "has the extension '', must be one of"),
        ("own.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "own.obj"),
    ],
)
def test_a_file_that_is_no_mesh_is_refused_in_one_line(tmp_path: Path, name: str, text: str, said: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(MeshError) as error:
        solid_of(mesh_spec(tmp_path / name))
    assert str(error.value).startswith(f"own: mesh file {tmp_path / name} ")
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_a_missing_mesh_file_a_folder_and_a_closed_one_are_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(MeshError, match=r"own: mesh file .*gone\.stl does not exist"):
        solid_of(mesh_spec(tmp_path / "gone.stl"))
    (tmp_path / "folder.stl").mkdir()
    with pytest.raises(MeshError, match=r"own: mesh file .*folder\.stl cannot be read: "):
        solid_of(mesh_spec(tmp_path / "folder.stl"))
    if os.geteuid():  # root may read what it may not
        box().export(tmp_path / "closed.stl")
        (tmp_path / "closed.stl").chmod(0)
        with pytest.raises(MeshError, match=r"own: mesh file .*closed\.stl cannot be read: "):
            solid_of(mesh_spec(tmp_path / "closed.stl"))


@pytest.mark.parametrize("name", ["own.obj", "own.ply", "own.stl"])
def test_vertices_that_are_no_numbers_are_counted(tmp_path: Path, name: str) -> None:
    mesh = trimesh.Trimesh(box().vertices.copy(), box().faces, process=False)
    mesh.vertices[3] = np.nan
    assert "vertices that are not finite numbers, must be 0" in refusal(mesh, tmp_path, name)


def test_a_mesh_without_volume_is_refused(tmp_path: Path) -> None:
    corners = [[0, 0, 0], [0.05, 0, 0], [0, 0.05, 0], [0, 0, 0.05]]
    there_and_back = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 1], [0, 2, 3], [0, 3, 2]], process=False)
    said = refusal(there_and_back, tmp_path)
    assert "encloses 0 m3, must be > 0" in said or "is not watertight" in said
