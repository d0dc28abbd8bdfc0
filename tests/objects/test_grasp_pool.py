"""The grasp pool: every grasp is a grasp, no two are the same, and the pool serves what a roboticist would use it for."""

from __future__ import annotations

import dataclasses
from collections import Counter

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from jaxtyping import Float

from objects.build import ObjectParams, build_object, object_models_of
from objects.catalogue import CuboidShape, load_catalogue
from objects.clearance import GripperClearance, clears_table
from objects.contacts import ray_exits, sharp_edge_distance, surface_points
from objects.errors import GraspError
from objects.grasp_pool import GRAVITY_M_S2, TRIED_FRICTION, GraspPoolParams, grasp_pool, pose_distance
from objects.object_model import ObjectModel, TriangleMesh
from objects.stable_poses import StablePoseParams, stable_poses
from pipelines.recipe import load_recipe
from tests.objects.shapes import spec_of

# As the benchmark ships them: the recipe's pools hold marginal grasps, too.
OBJECTS = load_recipe("full").objects
PARAMS = OBJECTS.grasp_pool
SEED = 7
# A round, a small round, a narrow and a wide mug, a box with one graspable width and a box with two.
IDS = ("can_03", "can_06", "mug_10", "mug_01", "cuboid_02", "cuboid_07")
KINDS = {
    "can_03": {"side", "top", "bottom"},
    "can_06": {"side", "top", "bottom", "caps"},
    "mug_10": {"rim", "handle", "body"},
    "mug_01": {"rim", "handle"},
    "cuboid_02": {"face_x"},
    "cuboid_07": {"face_x", "face_y"},
}


@pytest.fixture(scope="module")
def object_models() -> dict[str, ObjectModel]:
    specs = {spec.object_id: spec for spec in load_catalogue()}
    return object_models_of([build_object(specs[object_id], OBJECTS, SEED) for object_id in IDS])


def poses(object_model: ObjectModel) -> Float[np.ndarray, "n 4 4"]:
    return np.array([grasp.T_object_grasp for grasp in object_model.grasps])


def widths(object_model: ObjectModel) -> Float[np.ndarray, "n"]:
    return np.array([grasp.jaw_width_m for grasp in object_model.grasps])


def mesh_of(object_model: ObjectModel) -> trimesh.Trimesh:
    return trimesh.Trimesh(object_model.mesh.vertices_m, object_model.mesh.faces, process=False)


@pytest.mark.parametrize("object_id", IDS)
def test_a_pool_has_64_numbered_grasps_of_every_kind_the_object_has(object_models: dict[str, ObjectModel], object_id: str) -> None:
    object_model = object_models[object_id]
    assert [grasp.grasp_id for grasp in object_model.grasps] == list(range(64))
    counts = Counter(grasp.grasp_kind for grasp in object_model.grasps)
    assert set(counts) == KINDS[object_id]
    assert min(counts.values()) >= 4
    T = poses(object_model)
    assert np.einsum("nij,nik->njk", T[:, :3, :3], T[:, :3, :3]) == pytest.approx(np.tile(np.eye(3), (64, 1, 1)), abs=1e-9)
    assert np.linalg.det(T[:, :3, :3]) == pytest.approx(np.ones(64))
    assert widths(object_model).max() <= 0.075


@pytest.mark.parametrize("object_id", IDS)
def test_both_contacts_lie_between_the_pads_on_the_object_within_the_friction_cone(
    object_models: dict[str, ObjectModel], object_id: str
) -> None:
    object_model, mesh = object_models[object_id], mesh_of(object_models[object_id])
    for T, width in zip(poses(object_model), widths(object_model), strict=True):
        assert any(_is_held(mesh, T, width, depth) for depth in PARAMS.depths_m), f"{object_id}: the pads close on nothing"


def _is_held(mesh: trimesh.Trimesh, T: Float[np.ndarray, "4 4"], width_m: float, depth_m: float) -> bool:
    """Whether rays along the jaw line, from just inside the object, leave it at both contacts, inside the cones and off the edges."""
    outwards = np.array([T[:3, 1], -T[:3, 1]])
    contacts = T[:3, 3] - depth_m * T[:3, 2] + width_m / 2 * outwards
    ray, exits, faces = ray_exits(mesh, contacts - 1e-4 * outwards, outwards)
    firsts = [np.flatnonzero(ray == k)[:1] for k in (0, 1)]
    if any(len(first) == 0 for first in firsts):
        return False
    first = np.concatenate(firsts)
    cosines = np.einsum("ij,ij->i", mesh.face_normals[faces[first]], outwards)
    return (
        bool(np.abs(exits[first] - contacts).max() < 1e-6)
        and bool(np.arccos(np.clip(cosines, -1, 1)).max() <= np.arctan(PARAMS.friction) + 1e-6)
        and bool(sharp_edge_distance(mesh, contacts).min() >= PARAMS.edge_margin_m - 1e-6)
    )


@pytest.mark.parametrize("object_id", IDS)
def test_no_grasp_touches_the_object_with_palm_or_open_fingers(object_models: dict[str, ObjectModel], object_id: str) -> None:
    object_model = object_models[object_id]
    probes, _ = surface_points(mesh_of(object_model), 3000, np.random.default_rng(0))
    clearance = GripperClearance(object_model.parts, probes, PARAMS.palm_clearance_m, PARAMS.skew_m, PARAMS.approach_m)
    # Point distances with ten times the probes: a witness for the palm that knows nothing of the collision library.
    assert np.all(clearance.may_be_free(poses(object_model)))
    assert all(clearance.is_free(T, float(width)) for T, width in zip(poses(object_model), widths(object_model), strict=True))


@pytest.mark.parametrize("object_id", IDS)
def test_no_two_grasps_are_the_same(object_models: dict[str, ObjectModel], object_id: str) -> None:
    T = poses(object_models[object_id])
    for k in range(1, 64):
        assert pose_distance(T[:k], T[k], PARAMS).min() >= PARAMS.min_distance


@pytest.mark.parametrize("object_id", IDS)
def test_every_prefix_serves_every_resting_pose_that_can_be_grasped(object_models: dict[str, ObjectModel], object_id: str) -> None:
    object_model = object_models[object_id]
    serves = np.array(
        [
            clears_table(rest.T_plane_object @ poses(object_model), widths(object_model), PARAMS.table_clearance_m, PARAMS.approach_m)
            for rest in object_model.stable_poses
        ]
    )
    graspable = serves.any(axis=1)
    # A flat box wider than the jaw lies on the only faces that the jaw could span: then, and only then, nothing serves the pose.
    assert [r.resting for r, g in zip(object_model.stable_poses, graspable, strict=True) if not g] == (
        ["face_x"] if object_id == "cuboid_02" else []
    )
    assert serves[graspable].sum(axis=1).min() >= 8
    assert serves[graspable][:, :32].sum(axis=1).min() >= 4
    kinds = Counter(grasp.grasp_kind for grasp in object_model.grasps[:32])
    assert set(kinds) == KINDS[object_id]


@pytest.mark.parametrize("object_id", IDS)
def test_each_grasp_lifts_the_object_off_some_resting_pose_without_turning_it(
    object_models: dict[str, ObjectModel], object_id: str
) -> None:
    object_model = object_models[object_id]
    least = np.full(64, np.inf)
    for rest in object_model.stable_poses:
        T = rest.T_plane_object @ poses(object_model)
        com = (rest.T_plane_object @ np.append(object_model.com_m, 1.0))[:3]
        torque = np.cross(com - T[:, :3, 3], [0.0, 0.0, -object_model.mass_kg * GRAVITY_M_S2])
        about_jaw = np.abs(np.einsum("nj,nj->n", torque, T[:, :3, 1]))
        clear = clears_table(T, widths(object_model), PARAMS.table_clearance_m, PARAMS.approach_m)
        least = np.minimum(least, np.where(clear, about_jaw, np.inf))
    # The pads' depth moves the TCP off the jaw line by up to 7 mm.
    limit = PARAMS.max_torque_n_m * object_model.friction / TRIED_FRICTION
    assert least.max() <= limit + 0.007 * object_model.mass_kg * GRAVITY_M_S2


def test_kinds_are_where_the_fingers_are(object_models: dict[str, ObjectModel]) -> None:
    can = object_models["can_06"]
    for grasp in can.grasps:
        jaw, approach = grasp.T_object_grasp[:3, 1], grasp.T_object_grasp[:3, 2]
        assert (grasp.grasp_kind == "caps") == (abs(jaw[2]) > 0.9)
        assert (grasp.grasp_kind == "top") == (approach[2] < -0.82 and abs(jaw[2]) < 0.9)
    mug = object_models["mug_10"]
    for grasp in mug.grasps:
        tcp, width = grasp.T_object_grasp[:3, 3], grasp.jaw_width_m
        radius = np.hypot(tcp[0], tcp[1])
        if grasp.grasp_kind == "rim":
            assert width < 0.006
            assert abs(radius - 0.033) < 0.008
            assert grasp.T_object_grasp[2, 2] < -0.5, "the hand comes from above the brim"
        elif grasp.grasp_kind == "body":
            assert 0.065 < width < 0.0751
        else:
            assert width < 0.03
            assert tcp[0] > 0.03
    for grasp in object_models["cuboid_07"].grasps:
        assert "xyz"[int(np.abs(grasp.T_object_grasp[:3, 1]).argmax())] == grasp.grasp_kind[-1]


def test_a_heavy_mug_is_held_where_its_weight_is_borne() -> None:
    """0.3 kg at a handle 60 mm off the axis take 0.85 of what the pads bear, and pools stop at half: the rim is left, from above."""
    spec = next(spec for spec in load_catalogue() if spec.object_id == "mug_02")
    object_model = object_models_of([build_object(spec, OBJECTS, SEED)])["mug_02"]
    assert {grasp.grasp_kind for grasp in object_model.grasps} == {"rim"}
    assert poses(object_model)[:, 2, 2].max() < -0.5


def test_hands_come_from_many_sides(object_models: dict[str, ObjectModel]) -> None:
    for object_id, object_model in object_models.items():
        approach = poses(object_model)[:, :3, 2]
        sides = {(int(np.abs(a).argmax()), bool(a[np.abs(a).argmax()] > 0)) for a in approach}
        assert len(sides) >= 3, object_id
    heights = poses(object_models["can_03"])[[g.grasp_kind == "side" for g in object_models["can_03"].grasps], 2, 3]
    assert len(set(np.round(heights / 0.02))) >= 5, "side grasps at several heights"


@settings(max_examples=50)
@given(st.integers(0, 100_000))
def test_pose_distance_is_symmetric_flip_blind_and_the_same_in_every_frame(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b, frame = (trimesh.transformations.random_rotation_matrix(rng.random(3)) for _ in range(3))
    for T in (a, b, frame):
        T[:3, 3] = rng.uniform(-0.1, 0.1, 3)
    flip = np.diag([-1.0, -1.0, 1.0, 1.0])

    def distance(one: Float[np.ndarray, "4 4"], other: Float[np.ndarray, "4 4"]) -> float:
        return float(pose_distance(one[None], other, PARAMS)[0])

    assert distance(a, b) == pytest.approx(distance(b, a))
    assert distance(a @ flip, b) == pytest.approx(distance(a, b))
    assert distance(frame @ a, frame @ b) == pytest.approx(distance(a, b), abs=1e-6)
    assert distance(a, a @ flip) == pytest.approx(0.0, abs=1e-6)


def test_the_seed_decides_and_nothing_else() -> None:
    spec = next(s for s in load_catalogue() if s.object_id == "cuboid_09")
    one, two, other = (build_object(spec, ObjectParams(), seed).grasp_pool for seed in (1, 1, 2))
    assert one == two
    assert one != other


def pool_of(spec_size: tuple[float, float, float], params: GraspPoolParams = PARAMS, mass_kg: float = 0.2) -> int:
    spec = spec_of(CuboidShape(spec_size), mass_kg=mass_kg)
    box = trimesh.creation.box(extents=spec_size)
    rests = stable_poses(spec, box, np.zeros(3), StablePoseParams())
    part = TriangleMesh(np.asarray(box.vertices), np.asarray(box.faces))
    return len(grasp_pool(spec, box, (part,), np.zeros(3), rests, params, 1))


def test_an_object_too_wide_for_the_jaw_is_refused_with_its_width_and_the_bound() -> None:
    with pytest.raises(GraspError, match=r"thing: smallest graspable width 0\.0900 m, must be at most 0\.0750"):
        pool_of((0.09, 0.10, 0.12))


def test_an_object_with_too_few_grasps_is_refused_with_their_number() -> None:
    with pytest.raises(GraspError, match=r"thing: \d+ distinct grasps free of the object, must be at least 60"):
        pool_of((0.015, 0.015, 0.012), dataclasses.replace(PARAMS, min_grasps=60, min_distance=1.0))


def test_an_object_that_offers_only_edges_is_refused() -> None:
    with pytest.raises(GraspError, match=r"thing: contacts lie 0\.01\d\d m or less from an edge, must be at least 0\.02"):
        pool_of((0.03, 0.03, 0.03), dataclasses.replace(PARAMS, edge_margin_m=0.02))


@pytest.mark.parametrize(
    "changes",
    [
        {"n_grasps": 0},
        {"min_grasps": 65},
        {"friction": 0.0},
        {"depths_m": (0.01,)},
        {"depths_m": ()},
        {"min_distance": -1.0},
        {"shares": {"side": 0.0}},
    ],
)
def test_params_out_of_bounds_are_refused_by_name(changes: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=f"GraspPoolParams.{next(iter(changes))}"):
        GraspPoolParams(**changes)  # type: ignore[arg-type]
