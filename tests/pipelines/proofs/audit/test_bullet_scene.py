"""Distances of the audit's engine: exact where they can be written down, the same with and without bounds, the arm where it is."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import trimesh

from objects.object_model import TriangleMesh
from pipelines.engines.robot.arm import HOME_Q_RAD, fk
from pipelines.proofs.audit import bullet_scene
from pipelines.proofs.audit.bullet_scene import FAR_M, BulletScene, Nearest, Pair, hand
from pipelines.proofs.audit.paths import ALLOWED_COLLISION_MATRIX, arm_pairs, carried_pairs, self_pairs
from pipelines.values import Obstacle
from tests.builders import box_model, can_model, panda_scene, pose
from tests.pipelines.engines.planning.test_collision import configurations


def object_gap_m(world: BulletScene, T_base_object: np.ndarray) -> float:
    return world.nearest({"object": T_base_object[None]}, [Pair("object", "obstacle 0")]).room_m


@pytest.mark.parametrize("gap_m", [0.004, 0.001, 1e-4, -1e-4, -0.001, -0.004, -0.015])
def test_distances_are_those_that_can_be_written_down(gap_m: float) -> None:
    """Face to face, edge to edge and corner to corner, apart and overlapping: the engine's padding is gone to the micrometre."""
    object_model = box_model((0.05, 0.06, 0.12))
    box = Obstacle(0, pose(0.5, 0.0, 0.2), np.array([0.10, 0.08, 0.12]))
    with BulletScene(dataclasses.replace(panda_scene(object_model), obstacles=(box,)), object_model) as world:
        assert object_gap_m(world, pose(0.5 + 0.075 + gap_m, 0.003, 0.19)) == pytest.approx(gap_m, abs=1e-6)
        assert object_gap_m(world, pose(0.503, 0.001, 0.32 + gap_m)) == pytest.approx(gap_m, abs=1e-6)
        tip_m = np.hypot(0.025, 0.03)  # the vertical edge of the object points along x
        T_edge = pose(0.55 + tip_m + gap_m, 0.0, 0.2, -np.arctan2(0.03, 0.025))
        assert object_gap_m(world, T_edge) == pytest.approx(gap_m, abs=1e-6)
        if gap_m > 0:
            diagonal = gap_m / np.sqrt(3.0)
            T_corner = pose(0.5 + 0.075 + diagonal, 0.07 + diagonal, 0.2 + 0.12 + diagonal)
            assert object_gap_m(world, T_corner) == pytest.approx(gap_m, abs=1e-6)
        on_table = world.nearest({"object": pose(0.3, -0.4, 0.06 + gap_m)[None]}, [Pair("object", "table")])
        assert on_table.room_m == pytest.approx(gap_m, abs=1e-6)


def test_the_exact_mesh_leaves_open_what_a_hull_fills() -> None:
    """A finger between the walls of a trough: 9 mm inside its convex part, 3.8 mm away from the mesh."""
    walls = [trimesh.creation.box((0.06, 0.01, 0.08)).apply_translation((0.0, side * 0.02, 0.0)) for side in (-1, 1)]
    floor = trimesh.creation.box((0.06, 0.05, 0.01)).apply_translation((0.0, 0.0, -0.045))
    trough = trimesh.util.concatenate([*walls, floor])
    solid, mesh = (TriangleMesh(np.asarray(m.vertices), np.asarray(m.faces)) for m in (trough.convex_hull, trough))
    small = TriangleMesh(np.asarray(floor.vertices), np.asarray(floor.faces))
    object_model = dataclasses.replace(box_model(), mesh=mesh, parts=(solid, small))
    T_tcp = pose(0.5, 0.0, 0.5)
    # The finger box at zero opening spans y = 0 to 15 mm; the walls leave 30 mm.
    placed = {**hand(T_tcp[None], np.zeros(2)), "object": pose(0.5, 0.0075, 0.5)[None]}
    pad = [Pair("left_pad", "object")]
    with (
        BulletScene(panda_scene(object_model), object_model) as rough,
        BulletScene(panda_scene(object_model), object_model, exact=True) as exact,
    ):
        assert rough.nearest(placed, pad).room_m < -0.009
        assert not rough.is_free(placed, pad)
        assert exact.is_free(placed, pad)
        assert exact.is_free(placed, [Pair("left_pad", "object", 0.0036)])
        assert not exact.is_free({**placed, "object": pose(0.5, 0.0175, 0.5)[None]}, pad)


def test_kinematics_agree_with_the_closed_form() -> None:
    """To a micrometre: the angles in the URDF have twelve digits."""
    object_model = can_model()
    q = configurations(50, 1)
    with BulletScene(panda_scene(object_model), object_model) as world:
        np.testing.assert_allclose(world.arm(q, np.zeros(2))["tcp"], fk(q), atol=1e-6, rtol=0.0)


def test_bodies_that_are_not_asked_are_far(monkeypatch: pytest.MonkeyPatch) -> None:
    """Asking every pair in every configuration gives the same nearest one."""
    object_model = can_model()
    with BulletScene(panda_scene(object_model, [(0.5, 0.25), (0.62, -0.2)]), object_model) as world:
        pairs = [*self_pairs(), *arm_pairs(world), *carried_pairs()]
        T_tcp_object = pose(0.0, 0.0, 0.17)  # beyond the fingers, so that it does not stand in the palm

        def nearest(q: np.ndarray) -> Nearest:
            placed = world.arm(q, np.array([0.033, 0.033]))
            return world.nearest({**placed, "object": placed["tcp"] @ T_tcp_object}, pairs)

        rows = configurations(150, 2)
        asked = [nearest(row[None]) for row in rows]
        monkeypatch.setattr(bullet_scene, "_near", lambda pairs, placed, n: np.ones((len(pairs), n), dtype=bool))
        everything = [nearest(row[None]) for row in rows]
    assert [min(found.room_m, FAR_M) for found in asked] == [found.room_m for found in everything]
    assert 10 < sum(found.room_m < 0.0 for found in everything) < 100


def test_only_neighbours_and_the_documented_pair_overlap_in_a_free_configuration() -> None:
    """What may overlap does so in the ready pose, or is a finger, or is link5 and link7; nothing that is tested does."""
    object_model = can_model()
    with BulletScene(panda_scene(object_model), object_model) as world:
        placed = world.arm(HOME_Q_RAD[None], np.array([0.04, 0.04]))
        assert world.is_free({**placed, "object": pose(5.0, 0.0, 1.0)[None]}, [*self_pairs(), *arm_pairs(world)])
        excused = {pair for pair in ALLOWED_COLLISION_MATRIX if all(name.startswith("link") for name in pair)}
        assert len(excused) == 8
        assert frozenset(("link5", "link7")) in excused
        deep = [world.nearest(placed, [Pair(*sorted(pair))]).room_m < 0.0 for pair in excused - {frozenset(("link5", "link7"))}]
        assert sum(deep) >= 4
