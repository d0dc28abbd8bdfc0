"""Convex parts: what stays open, what is covered, and that nothing but the seed decides."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import trimesh
from jaxtyping import Bool, Float

from objects.catalogue import CanShape, CuboidShape, load_catalogue
from objects.coacd_process import CoacdProcess
from objects.decomposition import Decomposition, DecompositionParams, decompose, fill_of
from objects.errors import MeshError
from objects.object_model import TriangleMesh
from objects.solids import Solid, solid_of
from tests.objects.shapes import MUG_SHAPE, bumpy_ball, mesh_spec, spec_of

PARAMS = DecompositionParams()


@pytest.fixture(scope="module")
def mug() -> tuple[Solid, Decomposition]:
    solid = solid_of(spec_of(MUG_SHAPE))
    return solid, decompose(spec_of(MUG_SHAPE), solid, PARAMS, 1)


def inside(part: TriangleMesh, points: Float[np.ndarray, "n 3"], tolerance_m: float) -> Bool[np.ndarray, "n"]:
    """Points on the inner side of every face of a convex part."""
    corner, edge_1, edge_2 = (
        part.vertices_m[part.faces[:, 0]],
        *(part.vertices_m[part.faces[:, k]] - part.vertices_m[part.faces[:, 0]] for k in (1, 2)),
    )
    normal = np.cross(edge_1, edge_2)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.all(points @ normal.T <= np.einsum("ij,ij->i", normal, corner) + tolerance_m, axis=1)


def share_inside(volume: trimesh.Trimesh, parts: tuple[TriangleMesh, ...]) -> float:
    """Monte Carlo twin of the boolean fill: of points in a convex volume, how many lie in a part."""
    points = np.random.default_rng(0).uniform(*volume.bounds, (200_000, 3))
    hull = volume.convex_hull
    points = points[inside(TriangleMesh(hull.vertices, hull.faces), points, 0.0)]
    return float(np.any([inside(part, points, 0.0) for part in parts], axis=0).mean())


@pytest.mark.parametrize("shape", [CanShape(0.066, 0.115), CuboidShape((0.04, 0.05, 0.06))])
def test_a_convex_solid_is_its_own_single_part(shape: CanShape | CuboidShape) -> None:
    solid = solid_of(spec_of(shape))
    made = decompose(spec_of(shape), solid, PARAMS, 1)
    assert len(made.parts) == 1
    assert made.volume_ratio == pytest.approx(1.0, abs=1e-9)
    assert made.parts[0].vertices_m.min(axis=0) == pytest.approx(solid.mesh.bounds[0])
    assert len(made.parts[0].vertices_m) == (96 if isinstance(shape, CanShape) else 8)


def test_a_solid_that_should_be_convex_and_is_not_is_refused() -> None:
    dented = solid_of(spec_of(MUG_SHAPE)).mesh
    with pytest.raises(MeshError, match=r"thing: its convex parts have .* times its volume, must be in \[0, 1\]"):
        decompose(spec_of(CanShape(0.066, 0.1)), Solid(dented), PARAMS, 1)


def test_a_mug_keeps_cavity_and_handle_hole_open(mug: tuple[Solid, Decomposition]) -> None:
    solid, made = mug
    assert made.cavity_fill is not None
    assert made.handle_hole_fill is not None
    assert 0.0 < made.cavity_fill <= PARAMS.max_cavity_fill
    assert 0.0 < made.handle_hole_fill <= PARAMS.max_handle_hole_fill
    # Binomial error of 150,000 points at a fill of 5 % is 0.06 %; four of them.
    assert share_inside(solid.cavity, made.parts) == pytest.approx(made.cavity_fill, abs=0.0025)


def test_the_middle_of_the_cavity_and_of_the_handle_hole_are_free_of_parts(mug: tuple[Solid, Decomposition]) -> None:
    _, made = mug
    finger = np.array([[0.0, 0.0, 0.0], [0.034, 0.0, 0.04], [0.0, -0.034, -0.03], [0.053, 0.0, 0.0]])
    assert not np.any([inside(part, finger, 0.0) for part in made.parts])


def test_the_parts_cover_the_mug(mug: tuple[Solid, Decomposition]) -> None:
    solid, made = mug
    points, _ = trimesh.sample.sample_surface(solid.mesh, 3000, seed=0)
    covered = np.any([inside(part, points, 1e-5) for part in made.parts], axis=0)
    # CoACD drops hull corners beyond 64: of the floor's 120 that costs slivers at its rim.
    assert covered.mean() > 0.95
    gaps = points[~covered]
    assert np.all(np.any([inside(part, gaps, 5e-4) for part in made.parts], axis=0)), "the parts miss more than half a millimetre"


def test_the_parts_stay_inside_the_mugs_hull(mug: tuple[Solid, Decomposition]) -> None:
    solid, made = mug
    hull = solid.mesh.convex_hull
    corners = np.vstack([part.vertices_m for part in made.parts])
    assert np.all(inside(TriangleMesh(hull.vertices, hull.faces), corners, 1e-6)), "a part would hold the mug off the table"


def test_wall_sectors_fill_what_geometry_says() -> None:
    solid = solid_of(spec_of(MUG_SHAPE))
    for n_sectors in (10, 15):
        one = dataclasses.replace(PARAMS, wall_sectors=(n_sectors,), handle_segments=(4,), max_cavity_fill=1.0)
        angle = 2 * np.pi / n_sectors
        # A sector's hull adds the segment between the inner wall and its chord; the inner wall itself has 60 facets.
        polygon = np.sin(2 * np.pi / 60) / (2 * np.pi / 60)
        assert decompose(spec_of(MUG_SHAPE), solid, one, 1).cavity_fill == pytest.approx(1.0 - np.sin(angle) / angle / polygon, rel=0.02)


def test_the_search_takes_the_fewest_parts_that_pass() -> None:
    solid = solid_of(spec_of(MUG_SHAPE))
    loose = decompose(spec_of(MUG_SHAPE), solid, dataclasses.replace(PARAMS, max_cavity_fill=0.12, max_handle_hole_fill=0.3), 1)
    strict = decompose(spec_of(MUG_SHAPE), solid, dataclasses.replace(PARAMS, max_cavity_fill=0.03, max_handle_hole_fill=0.08), 1)
    assert len(loose.parts) == 8 + 1 + 3
    assert len(strict.parts) > len(loose.parts)
    assert strict.cavity_fill is not None
    assert strict.cavity_fill <= 0.03


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"max_cavity_fill": 0.001}, r"its convex parts fill .* of its cavity, must be in \[0, 0.001\]"),
        ({"max_handle_hole_fill": 0.001}, r"its convex parts fill .* of its handle hole, must be in \[0, 0.001\]"),
        ({"max_volume_ratio": 1.01}, r"its convex parts have .* times its volume, must be in \[0, 1.01\]"),
        ({"max_parts": 10}, r"it takes 12 convex parts, must be in \[1, 10\]"),
        # A hull of too few vertices loses the ring that the mug stands on.
        ({"max_hull_vertices": 16}, r"its convex parts leave out .* mm of its outside, must be in \[0, 0.5\]"),
    ],
)
def test_a_gate_that_no_setting_passes_is_an_error(changes: dict[str, float], said: str) -> None:
    coarse = dataclasses.replace(PARAMS, wall_sectors=(8,), handle_segments=(3,), max_cavity_fill=1.0, max_handle_hole_fill=1.0)
    with pytest.raises(MeshError, match=f"thing: .*{said}"):
        decompose(spec_of(MUG_SHAPE), solid_of(spec_of(MUG_SHAPE)), dataclasses.replace(coarse, **changes), 1)  # type: ignore[arg-type]


def test_a_users_concave_mesh_is_split_until_its_volume_fits(tmp_path: Path) -> None:
    bars = [trimesh.creation.box(bounds=bounds) for bounds in ([[0, 0, 0], [0.08, 0.02, 0.03]], [[0, 0, 0], [0.02, 0.07, 0.03]])]
    trimesh.boolean.union(bars, engine="manifold").export(tmp_path / "angle.stl")
    spec = mesh_spec(tmp_path / "angle.stl")
    solid = solid_of(spec)
    made = decompose(spec, solid, dataclasses.replace(PARAMS, max_mesh_volume_ratio=1.02), 1)
    assert len(made.parts) >= 2
    assert made.volume_ratio <= 1.02
    notch = np.array([[0.02, 0.02, 0.0]])  # in the open corner of the angle, object frame
    assert not np.any([inside(part, notch, 0.0) for part in made.parts])


def test_a_mesh_too_rough_for_convex_parts_ends_with_the_number_it_would_take(tmp_path: Path) -> None:
    bumpy_ball(subdivisions=3).export(tmp_path / "own.ply")
    spec, told = mesh_spec(tmp_path / "own.ply"), []
    with pytest.raises(MeshError, match=r"own: it takes \d+ convex parts, must be in \[1, 4\]"):
        decompose(spec, solid_of(spec), dataclasses.replace(PARAMS, max_parts=4), 1, told.append)
    assert any("times the volume of the mesh" in line for line in told)


def test_a_call_that_takes_too_long_is_ended_and_says_so() -> None:
    ball = bumpy_ball(subdivisions=4)
    with CoacdProcess("own", max_core_s=0.0) as child, pytest.raises(MeshError, match=r"own: CoACD took \d+ core-seconds .* at most 0:"):
        child.split([ball], threshold=0.02, preprocess_mode="off")


def test_a_smooth_mesh_has_parts_of_few_enough_vertices(tmp_path: Path) -> None:
    trimesh.creation.icosphere(subdivisions=4, radius=0.03).export(tmp_path / "own.ply")
    spec = mesh_spec(tmp_path / "own.ply")
    made = decompose(spec, solid_of(spec), PARAMS, 1)
    assert len(made.parts) == 1
    assert 128 < len(made.parts[0].vertices_m) < 512  # of 2562
    assert 0.97 <= made.volume_ratio <= 1.0


def test_fill_of_nothing_is_nothing_and_of_everything_is_one() -> None:
    box = trimesh.creation.box(extents=(1.0, 1.0, 1.0))
    far = trimesh.creation.box(bounds=[[5.0, 5.0, 5.0], [6.0, 6.0, 6.0]])
    halves = [trimesh.creation.box(bounds=[[-1.0, -1.0, -1.0], [0.1, 1.0, 1.0]]), trimesh.creation.box(bounds=[[-0.1, -1, -1], [1, 1, 1]])]
    assert fill_of(None, [box]) is None
    assert fill_of(box, [far]) == 0.0
    assert fill_of(box, halves[:1]) == pytest.approx(0.6)
    assert fill_of(box, halves) == pytest.approx(1.0), "overlapping parts count once"


def test_a_crash_of_coacd_names_the_object_and_leaves_this_process_alive() -> None:
    broken = trimesh.Trimesh(np.eye(3), [[0, 1, 2]], process=False)
    broken.faces = np.array([[0, 1, 10_000_000]])
    with CoacdProcess("mine") as child, pytest.raises(MeshError, match="mine: CoACD crashed with exit code -"):
        child.split([broken], threshold=0.1, preprocess_mode="off")
    with CoacdProcess("mine") as child:
        assert len(child.split([trimesh.creation.box()], threshold=0.1, preprocess_mode="off")) == 1


@pytest.mark.parametrize(
    "changes",
    [{"max_cavity_fill": 1.5}, {"max_volume_ratio": 0.9}, {"wall_sectors": (12, 8)}, {"wall_sectors": ()}, {"thresholds": (0.1, 0.2)}],
)
def test_params_out_of_bounds_are_refused_by_name(changes: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=f"DecompositionParams.{next(iter(changes))}"):
        DecompositionParams(**changes)  # type: ignore[arg-type]


@pytest.mark.slow
def test_every_packaged_mug_passes_its_gates_with_few_parts() -> None:
    for spec in load_catalogue():
        if spec.category == "mug":
            assert len(decompose(spec, solid_of(spec), PARAMS, 1).parts) <= 20, spec.object_id
