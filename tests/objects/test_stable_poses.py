"""Stable poses: exact solid angles, a brute-force twin that topples one drop at a time, symmetry, and the barely stable ones."""

from __future__ import annotations

import json
import math
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from jaxtyping import Float

from objects.catalogue import CanShape, CuboidShape, load_catalogue
from objects.errors import StablePoseError
from objects.object_model import StablePose
from objects.solids import solid_of
from objects.stable_poses import StablePoseParams, stable_poses
from tests.objects.golden.regenerate import GOLDEN, table
from tests.objects.shapes import MUG_SHAPE, mesh_spec, spec_of

PARAMS = StablePoseParams()


def poses_of(shape: CanShape | CuboidShape, com_z_m: float = 0.0) -> dict[str, StablePose]:
    spec = spec_of(shape, com_z_m=com_z_m)
    return {pose.resting: pose for pose in stable_poses(spec, solid_of(spec).mesh, np.array([0.0, 0.0, com_z_m]), PARAMS)}


@given(st.tuples(*[st.floats(0.03, 0.06)] * 3))
def test_a_cuboid_rests_on_each_face_as_often_as_its_solid_angle_says(size: tuple[float, float, float]) -> None:
    poses = poses_of(CuboidShape(size))
    a, b, c = np.array(size) / 2

    def share(width: float, depth: float, height: float) -> float:
        # Solid angle of a rectangle seen from above its centre, twice for the opposite face.
        return 2 * 4 * math.atan(width * depth / (height * math.sqrt(width**2 + depth**2 + height**2))) / (4 * math.pi)

    expected = {"face_x": share(b, c, a), "face_y": share(a, c, b), "face_z": share(a, b, c)}
    assert poses.keys() == expected.keys()
    for name, value in expected.items():
        assert poses[name].probability == pytest.approx(value, abs=1e-9)


def topple(mesh: trimesh.Trimesh, com: Float[np.ndarray, "3"], n: int, seed: int) -> Counter[tuple[float, ...]]:
    """Brute-force twin: drop on a random side, roll over the edge that the weight lies beyond, until it lies within a side."""
    hull = mesh.convex_hull
    sides: dict[tuple[float, ...], list[int]] = {}
    for f, normal in enumerate(hull.face_normals):
        sides.setdefault(tuple(np.round(normal, 4) + 0.0), []).append(f)
    names = list(sides)
    planes = np.array([[*hull.face_normals[fs[0]], hull.face_normals[fs[0]] @ hull.triangles[fs[0], 0]] for fs in sides.values()])
    gap = planes[:, 3] - planes[:, :3] @ com
    rng = np.random.default_rng(seed)
    ends: Counter[tuple[float, ...]] = Counter()
    for direction in rng.normal(size=(n, 3)):
        # The side that a ray from the centre of mass leaves by is the one it falls on.
        along = planes[:, :3] @ direction
        side = int(np.argmin(np.where(along > 1e-12, gap / np.maximum(along, 1e-12), np.inf)))
        while True:
            foot = com + gap[side] * planes[side, :3]
            over = planes[:, :3] @ foot - planes[:, 3]
            over[side] = -1.0
            if over.max() <= 1e-9:
                break
            # Of the planes that cut the foot off, the neighbour crossed first on the way from the side's middle to the foot.
            middle = hull.triangles[sides[names[side]]].reshape(-1, 3).mean(axis=0)
            step = planes[:, :3] @ (foot - middle)
            start = planes[:, 3] - planes[:, :3] @ middle
            side = int(np.argmin(np.where((over > 1e-9) & (step > 1e-12), start / np.maximum(step, 1e-12), np.inf)))
        ends[names[side]] += 1
    return ends


@pytest.mark.parametrize("com_z_m", [0.0, -0.03])
def test_a_can_agrees_with_drops_toppled_one_by_one(com_z_m: float) -> None:
    shape = CanShape(0.066, 0.14)
    poses = poses_of(shape, com_z_m)
    n = 4000
    ends = topple(solid_of(spec_of(shape)).mesh, np.array([0.0, 0.0, com_z_m]), n, 0)
    share = {"upright": ends[(0.0, 0.0, -1.0)] / n, "inverted": ends[(0.0, 0.0, 1.0)] / n}
    share["lying"] = 1.0 - sum(share.values())
    for name, pose in poses.items():
        # Three standard errors of 4,000 drops.
        assert pose.probability == pytest.approx(share[name], abs=3 * math.sqrt(0.25 / n))


def test_a_full_can_stands_on_either_end_alike_and_a_half_full_one_prefers_its_bottom() -> None:
    full, half = poses_of(CanShape(0.066, 0.168)), poses_of(CanShape(0.066, 0.168), -0.039)
    assert set(full) == {"upright", "inverted", "lying"}
    assert full["upright"].probability == pytest.approx(full["inverted"].probability, rel=1e-6)
    assert half["upright"].probability > 3 * half["inverted"].probability


def test_a_half_full_carton_keeps_its_two_ends_apart() -> None:
    poses = poses_of(CuboidShape((0.063, 0.094, 0.196)), -0.045)
    assert set(poses) == {"face_x", "face_y", "face_-z", "face_+z"}
    assert poses["face_-z"].probability > poses["face_+z"].probability


def test_the_barely_stable_small_ends_are_kept() -> None:
    found = {spec.object_id: {p.resting for p in catalogue_poses(spec.object_id)} for spec in load_catalogue()}
    assert {"face_x", "face_y", "face_z"} <= found["cuboid_02"]
    assert "face_+z" in found["cuboid_08"]
    assert "inverted" in found["can_10"]
    assert all({"upright", "inverted", "on_side_left", "on_side_right"} == found[f"mug_{k:02d}"] for k in range(1, 11))


def catalogue_poses(object_id: str) -> tuple[StablePose, ...]:
    spec = next(s for s in load_catalogue() if s.object_id == object_id)
    mesh = solid_of(spec).mesh
    return stable_poses(spec, mesh, np.asarray(mesh.center_mass) + np.array(spec.com_offset_m), PARAMS)


@pytest.mark.parametrize("object_id", ["can_03", "mug_02", "mug_05", "cuboid_08"])
def test_every_pose_stands_on_the_plane_with_the_weight_above_its_support(object_id: str) -> None:
    spec = next(s for s in load_catalogue() if s.object_id == object_id)
    mesh = solid_of(spec).mesh
    com = np.append(np.asarray(mesh.center_mass) + np.array(spec.com_offset_m), 1.0)
    poses = catalogue_poses(object_id)
    assert sum(pose.probability for pose in poses) == pytest.approx(1.0)
    assert [pose.stable_pose_id for pose in poses] == list(range(len(poses)))
    # Mirror images tie but for rounding.
    assert np.all(np.diff([pose.probability for pose in poses]) < 1e-8)
    for pose in poses:
        T = pose.T_plane_object
        assert T[:3, :3] @ T[:3, :3].T == pytest.approx(np.eye(3), abs=1e-12)
        assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
        assert T[:2, 3] == pytest.approx([0.0, 0.0])
        placed = mesh.vertices @ T[:3, :3].T + T[:3, 3]
        assert placed[:, 2].min() == pytest.approx(0.0, abs=1e-12)
        support = placed[placed[:, 2] < 1e-4][:, :2]
        assert len(support) >= 3
        # In the support polygon: no direction in the plane in which all support lies on one side of the weight.
        weight = (T @ com)[:2]
        for angle in np.linspace(0.0, 2 * np.pi, 90):
            assert ((support - weight) @ [np.cos(angle), np.sin(angle)]).max() > 0.0


def test_a_mug_lies_on_its_handle_left_and_right_as_mirror_images() -> None:
    poses = {pose.resting: pose for pose in catalogue_poses("mug_02")}
    left, right = poses["on_side_left"], poses["on_side_right"]
    assert left.probability == pytest.approx(right.probability, rel=1e-6)
    down_left, down_right = -left.T_plane_object[2, :3], -right.T_plane_object[2, :3]
    assert down_left == pytest.approx(down_right * [1.0, -1.0, 1.0], abs=1e-6)
    assert down_left[1] > 0.5
    assert down_left[0] > 0.2, "the handle is not down"


def test_the_upright_and_inverted_poses_are_what_they_say() -> None:
    poses = {pose.resting: pose.T_plane_object for pose in catalogue_poses("mug_02")}
    assert poses["upright"][2, 2] == pytest.approx(1.0)
    assert poses["inverted"][2, 2] == pytest.approx(-1.0)


def test_a_ball_has_no_stable_pose(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.03)
    with pytest.raises(StablePoseError, match=r"own: no stable pose, the best tips at 0\.0\d+ rad, must be at least 0\.055"):
        stable_poses(mesh_spec(tmp_path / "ball.stl"), ball, np.zeros(3), PARAMS)


def test_a_centre_of_mass_outside_the_object_is_refused() -> None:
    spec = spec_of(CanShape(0.066, 0.1))
    with pytest.raises(StablePoseError, match=r"thing: centre of mass 0\.0100 m outside"):
        stable_poses(spec, solid_of(spec).mesh, np.array([0.0, 0.0, 0.06]), PARAMS)


def test_turning_the_mesh_turns_the_poses() -> None:
    spec = mesh_spec(Path("own.stl"))
    mesh = solid_of(spec_of(MUG_SHAPE)).mesh
    T = trimesh.transformations.random_rotation_matrix(np.random.default_rng(3).random(3))
    turned = mesh.copy()
    turned.apply_transform(T)
    before = stable_poses(spec, mesh, np.asarray(mesh.center_mass), PARAMS)
    after = stable_poses(spec, turned, np.asarray(turned.center_mass), PARAMS)
    assert [p.probability for p in after] == pytest.approx([p.probability for p in before], abs=1e-4)
    assert [p.T_plane_object[2, 3] for p in after] != [p.T_plane_object[2, 3] for p in before]
    downs = [np.array([T[:3, :3] @ -p.T_plane_object[2, :3] for p in before]), np.array([-p.T_plane_object[2, :3] for p in after])]
    nearest = np.linalg.norm(downs[0][:, None] - downs[1][None], axis=2).min(axis=1)
    assert nearest.max() < 1e-3


def test_the_catalogues_resting_poses_are_the_golden_ones() -> None:
    golden, now = json.loads(GOLDEN.read_text()), table()
    assert golden.keys() == now.keys()
    for object_id, row in golden.items():
        assert now[object_id]["rests_percent"].keys() == row["rests_percent"].keys(), object_id
        # One unit of the last digit, which another machine's sine may round the other way.
        assert list(now[object_id]["rests_percent"].values()) == pytest.approx(list(row["rests_percent"].values()), abs=0.11), object_id
        assert now[object_id]["com_mm"] == pytest.approx(row["com_mm"], abs=0.11), object_id
        assert now[object_id]["volume_ml"] == pytest.approx(row["volume_ml"], abs=0.11), object_id
