"""The second engine: laws that it must keep by itself, what both engines say of some candidates, and how their agreement is counted."""

from __future__ import annotations

import dataclasses

import numpy as np
import pyarrow as pa
import pytest
from scipy.spatial.transform import Rotation

from objects.object_model import ObjectModel
from pipelines.codecs import Row
from pipelines.engines.physics.hand_params import HandWorldParams
from pipelines.engines.physics.hand_rollout import hold, move
from pipelines.engines.physics.hand_world import GRAVITY_M_S2
from pipelines.engines.physics.params import PhysicsParams
from pipelines.engines.physics.phases import Phase, pose_difference
from pipelines.engines.physics.world import PhysicsWorld
from pipelines.engines.planning.trajectory import MotionParams, time_path
from pipelines.engines.robot.arm import HOME_Q_RAD, fk
from pipelines.labels.execution import ExecutionParams, ExecutionSetup
from pipelines.proofs.validity.pull_out import DIRECTIONS, across_the_jaw, pull_out_ratio, stated_lever_m, torsion_lever_m
from pipelines.proofs.validity.second_engine import choose, confusion, opinion, summary
from pipelines.proofs.validity.second_engine.both_engines import BULLET_STEPS_PER_TICK, MUJOCO_STEPS_PER_TICK, rigid_pads
from pipelines.proofs.validity.second_engine.bullet_world import BulletHandWorld
from pipelines.values import Target
from tables.poses import inverse
from tests.pipelines.engines.physics.lifted import MOTION, PHYSICS, Lifted, lifted
from tests.pipelines.engines.physics.object_models import can_model, cuboid_model

MODELS = [can_model(), cuboid_model()]
PARAMS = rigid_pads(PHYSICS, BULLET_STEPS_PER_TICK)
SETUP = ExecutionSetup(ExecutionParams(), MOTION, PHYSICS)


def _alone(world: BulletHandWorld, T_base_object: np.ndarray) -> None:
    """The object somewhere, at rest, and no hand."""
    world.start_held("alone", HOME_Q_RAD, [0.04, 0.04], inverse(fk(HOME_Q_RAD)) @ T_base_object)
    world.remove_hand()


@pytest.mark.parametrize("object_model", MODELS, ids=lambda m: m.object_id)
def test_what_rests_stays_and_weighs_what_it_weighs(object_model: ObjectModel) -> None:
    with BulletHandWorld(object_model, (), PARAMS) as world:
        for stable in object_model.stable_poses:
            T = stable.T_plane_object.copy()
            T[:2, 3] += [0.5, 0.3]
            _alone(world, T)
            for _ in range(120):
                world.step()
            moved_m, turned_rad = pose_difference(T, world.object_pose())
            # Sunk in by micrometres. A lying can, on four points of a facet 4 mm wide, is over by one of them: 2 mrad.
            assert moved_m < 1e-4
            assert turned_rad < 3e-3
            assert abs(T[2, 3] - world.object_pose()[2, 3]) < 1e-5
            assert world.impulse_n_s("object", "table") == pytest.approx(0.5 * object_model.mass_kg * GRAVITY_M_S2, rel=0.02)


def test_worlds_of_scenes_do_not_know_that_it_ran() -> None:
    """Bullet keeps some numbers once a process, not once a world."""

    def landing() -> bytes:
        T = MODELS[0].stable_poses[0].T_plane_object.copy()
        T[:3, 3] += 0.5, 0.0, 0.02
        T[:3, :3] = Rotation.from_rotvec([0.3, 0.1, 0.0]).as_matrix() @ T[:3, :3]
        with PhysicsWorld(MODELS[0], (), PhysicsParams()) as world:
            world.rebuild("landing")
            world.set_object(T)
            for _ in range(120):
                world.step()
            return world.object_pose().tobytes()

    before = landing()
    with BulletHandWorld(MODELS[0], (), PARAMS) as world:
        _alone(world, MODELS[0].stable_poses[0].T_plane_object)
        world.step()
    assert landing() == before


@pytest.mark.parametrize(
    ("object_model", "grasp_id"), [(MODELS[0], 2), (MODELS[0], 9), (MODELS[1], 3)], ids=["can side", "can top", "cuboid"]
)
def test_a_hold_does_not_creep(object_model: ObjectModel, grasp_id: int) -> None:
    grasp = object_model.grasp(grasp_id)
    with BulletHandWorld(object_model, (), PARAMS) as world:
        world.start_taking("hold", HOME_Q_RAD, grasp.jaw_width_m / 2 + 0.002, inverse(grasp.T_object_grasp), 0.1)
        hold(world, Phase.HOLD, 0.1)
        T = world.inhand_pose()
        hold(world, Phase.HOLD, 0.5)
        creep_m, creep_rad = pose_difference(T, world.inhand_pose())
    assert creep_m < 2e-5
    assert creep_rad < 2e-4


@pytest.mark.parametrize("direction", DIRECTIONS[:2])
def test_pull_out_force_is_coulombs(direction: tuple[float, float, float]) -> None:
    """A tenth less than 2 mu F does not move a flat box, a tenth more pulls it out."""
    object_model = cuboid_model()
    T, width_m = across_the_jaw(object_model)
    bound_n = 2 * PARAMS.pad_friction * object_model.friction * PARAMS.finger_force_n
    moved_m = []
    with BulletHandWorld(object_model, (), PARAMS) as world:
        for share in (0.9, 1.1):
            world.start_taking("pull", HOME_Q_RAD, width_m / 2 + 0.002, T, 0.1)
            T_taken = world.inhand_pose()
            for k in range(60):
                world.load(share * min(1.0, k / 30) * bound_n * np.array(direction), np.zeros(3), is_weightless=True)
                world.step()
            moved_m.append(pose_difference(T_taken, world.inhand_pose())[0])
    assert moved_m[0] < 1e-4
    assert moved_m[1] > 0.05


def test_rigid_pads_of_the_label_engine_hold_by_their_corners() -> None:
    """Half a diagonal of the pad, 12.7 mm, instead of the 6.9 mm of even pressure; what they hold of a pull is the same."""
    params = rigid_pads(PHYSICS, MUJOCO_STEPS_PER_TICK)
    assert pull_out_ratio(cuboid_model(), DIRECTIONS[2], params) == pytest.approx(1.0, abs=0.03)
    assert torsion_lever_m(cuboid_model(), params) > 1.5 * stated_lever_m(params)


def test_what_a_turning_hand_does_not_hold_falls_freely() -> None:
    """In the hand's frame, handed over to the base frame: gravity and inertia forces add up to a plain fall."""
    object_model = cuboid_model()
    T = np.eye(4)
    T[:3, 3] = 0.5, 0.3, 1.2
    far = HOME_Q_RAD + np.array([0.9, 0.3, 0.3, 0.4, 0.5, -0.4, 0.8])
    swing = time_path(np.stack([HOME_Q_RAD, far]), MotionParams(), PARAMS.dt_s, stop_at_waypoints=True)
    with BulletHandWorld(object_model, (), PARAMS) as world:
        world.start_held("fall", HOME_Q_RAD, [0.03, 0.03], inverse(fk(HOME_Q_RAD)) @ T)
        assert not move(world, Phase.TRANSPORT, swing)
        assert world.is_lost
        while world.n_steps < 60:
            world.step()
        fallen, time_s = world.object_pose(), 60 * PARAMS.dt_s
    T[2, 3] -= 0.5 * GRAVITY_M_S2 * time_s**2
    # A step late or early is 0.5 g t dt, 0.6 mm.
    assert pose_difference(T, fallen)[0] < 1e-3
    assert pose_difference(T, fallen)[1] < 1e-3


def test_the_same_bits_in_any_order() -> None:
    def run(world: BulletHandWorld, grasp_id: int) -> bytes:
        grasp = world.object_model.grasp(grasp_id)
        world.start_taking("run", HOME_Q_RAD, grasp.jaw_width_m / 2 + 0.002, inverse(grasp.T_object_grasp), 0.05)
        world.command_fingers(0.05)
        for _ in range(40):
            world.step()
        world.remove_hand()
        world.step()
        return world.object_pose().tobytes()

    with BulletHandWorld(can_model(), (), PARAMS) as world:
        forwards = [run(world, 0), run(world, 9)]
    with BulletHandWorld(can_model(), (), PARAMS) as world:
        assert [run(world, 9), run(world, 0)] == forwards[::-1]


def test_pads_that_yield_are_refused() -> None:
    with pytest.raises(ValueError, match="cells_per_side = 3"):
        BulletHandWorld(can_model(), (), HandWorldParams())


def _opinion(case: Lifted, setup: ExecutionSetup, shift_m: float = 0.0) -> Row:
    candidate, motion = case.planned[0]
    T = candidate.target.T_base_target.copy()
    T[0, 3] += shift_m
    return opinion(case.object_model, dataclasses.replace(candidate, target=Target(candidate.target.target_id, 0, T)), motion, setup)


def test_both_engines_say_the_same() -> None:
    """A can and a carton that are carried well, one that is put beside its target, and one whose hand cannot hold it."""
    slippery = dataclasses.replace(SETUP, physics=dataclasses.replace(PHYSICS, finger_force_n=30.0, friction_scale=0.5, pad_friction=0.1))
    rows = [
        _opinion(lifted("can"), SETUP),
        _opinion(lifted("cuboid"), SETUP),
        _opinion(lifted("cuboid"), SETUP, shift_m=0.03),
        _opinion(lifted("can"), slippery),
    ]
    assert [row["bullet_status"] for row in rows] == ["success", "success", "off_target", "dropped_in_transport"]
    assert [row["mujoco_status"] for row in rows] == [row["bullet_status"] for row in rows]
    for row in rows[:3]:
        assert row["apart_m"] < 0.002
        assert abs(row["bullet_slip_m"] - row["mujoco_slip_m"]) < 2e-4
    numbers = summary(rows)
    assert numbers["engine2_agreement"] == numbers["engine2_kappa"] == 1.0
    assert numbers["n_engine2"] == 4
    assert sum(confusion(rows).values()) == 4


def _counted(mujoco: str, bullet: str, n: int) -> list[Row]:
    row: Row = {"category": "can", "mujoco_status": mujoco, "bullet_status": bullet}
    row |= {"mujoco_success": mujoco == "success", "bullet_success": bullet == "success", "yielding_success": mujoco == "success"}
    return [row | {"candidate_id": f"{mujoco}-{bullet}-{k}"} for k in range(n)]


def test_kappa_is_cohens() -> None:
    """The textbook's table: 20 yes-yes, 5 yes-no, 10 no-yes, 15 no-no; agreement 0.7, kappa 0.4."""
    rows = [*_counted("success", "success", 20), *_counted("success", "collided", 5), *_counted("collided", "success", 10)]
    rows += _counted("collided", "collided", 15)
    numbers = summary(rows)
    assert numbers["engine2_agreement"] == pytest.approx(0.7)
    assert numbers["engine2_kappa"] == numbers["engine2_kappa_can"] == pytest.approx(0.4)
    weights = {row["candidate_id"]: 3.0 for row in rows if row["mujoco_status"] == row["bullet_status"]}
    assert summary(rows, weights)["engine2_agreement_weighted"] == pytest.approx(105 / 120)


def test_the_sample_has_failures_and_stands_for_all() -> None:
    statuses = ["success"] * 300 + ["dropped_in_transport"] * 20 + ["off_target"] * 4 + [None] * 50
    table = pa.table(
        {
            "candidate_id": [f"{category}-{k}" for category in ("can", "mug", "cuboid") for k in range(len(statuses))],
            "category": [category for category in ("can", "mug", "cuboid") for _ in statuses],
            "exec_status": statuses * 3,
        }
    )
    chosen = choose(table, 42, 60)
    status_of = dict(zip(table["candidate_id"].to_pylist(), table["exec_status"].to_pylist(), strict=True))
    counts = [sum(status_of[one.candidate_id] == status for one in chosen) for status in ("success", "dropped_in_transport", "off_target")]
    # Of each category all 4 that missed; the other 26 places in halves.
    assert counts == [26, 26, 8]
    assert sum(one.weight for one in chosen) == pytest.approx(2 * 324)
    assert not any(one.candidate_id.startswith("mug") for one in chosen)
    shuffled = table.take(np.random.default_rng(1).permutation(table.num_rows))
    assert choose(shuffled, 42, 60) == chosen
