"""Laws of the audits: free paths pass, overlaps are found to their depth, wrong labels are told from right ones."""

from __future__ import annotations

import dataclasses
from functools import lru_cache

import numpy as np
import pyarrow as pa
import pytest

from objects.object_model import ObjectModel
from pipelines.codecs import admitted_grasps
from pipelines.engines.planning.collision import CollisionModel
from pipelines.engines.planning.planner import SearchParams
from pipelines.engines.robot.arm import HOME_Q_RAD, fk
from pipelines.grasps.admission import AdmissionParams, admission_rows
from pipelines.labels.planning import Judgement, PlanningParams, judge_candidate, plan_of
from pipelines.proofs.audit.bullet_scene import FAR_M, BulletScene
from pipelines.proofs.audit.params import AuditParams
from pipelines.proofs.audit.paths import executed_path, recheck_path
from pipelines.proofs.audit.rejections import rejudge
from pipelines.proofs.audits import AuditError, AuditItem, audit_rows, audit_unit, choose_audited
from pipelines.recipe import Recipe
from pipelines.values import Candidate, LiftedGrasp, Motion, Obstacle, Scene, Target
from tables.schemas import AUDITS
from tables.store import content_hash, table_from_rows
from tables.vocabulary import Audit, PlanStatus
from tests.builders import box_model, ideally_lifted, panda_scene, pose

RECIPE = Recipe()
PARAMS = AuditParams()
QUICK = AuditParams(n_q7=32, n_restarts=8)  # where the verdict does not hang on the resolution


@dataclasses.dataclass(frozen=True)
class Solved:
    """A solved candidate in a scene without obstacles, with target 0."""

    object_model: ObjectModel
    candidate: Candidate
    judgement: Judgement

    @property
    def motion(self) -> Motion:
        assert self.judgement.motion is not None
        return self.judgement.motion

    @property
    def scene(self) -> Scene:
        return self.candidate.scene

    @property
    def grasp(self) -> LiftedGrasp:
        return self.candidate.grasp

    def elsewhere(self, scene: Scene) -> Candidate:
        """The candidate in another scene, whose target 0 is its target."""
        return Candidate(scene, self.grasp, scene.target(0))

    def item(self, audit: Audit, status: PlanStatus, scene: Scene | None = None, recipe: Recipe = RECIPE) -> AuditItem:
        plan = plan_of(self.motion) if audit is Audit.PATH_GEOMETRY else None
        return AuditItem(recipe, self.object_model, self.elsewhere(scene or self.scene), status, plan, audit)

    def with_box(self, T: np.ndarray, size_m: tuple[float, float, float]) -> Scene:
        return dataclasses.replace(self.scene, obstacles=(Obstacle(0, T, np.array(size_m)),))


@lru_cache(maxsize=4)
def solved(y_m: float = 0.25, axis: int = 1, planning: PlanningParams = RECIPE.planning) -> Solved:
    """A cuboid put down with its faces along x and y by a hand that comes along one of these axes, away from the robot."""
    object_model = box_model()
    scene = dataclasses.replace(panda_scene(object_model), targets=(Target(0, 0, pose(0.5, y_m, 0.06)),))
    for admitted in admitted_grasps(admission_rows(object_model, scene, AdmissionParams())):
        grasp = ideally_lifted(object_model, admitted)
        approach = (scene.targets[0].T_base_target @ np.linalg.inv(grasp.T_tcp_object))[:3, 2]
        candidate = Candidate(scene, grasp, scene.target(0))
        judgement = judge_candidate(object_model, candidate, planning, RECIPE.seed, CollisionModel(scene, object_model))
        if judgement.motion is not None and approach[axis] > 0.9:
            return Solved(object_model, candidate, judgement)
    raise AssertionError("no grasp from that side is solved")


def test_an_executed_path_is_the_commanded_curve_in_small_steps() -> None:
    q = np.stack([HOME_Q_RAD, HOME_Q_RAD + 0.3, HOME_Q_RAD + np.array([0.3, -0.2, 0.1, 0.2, 0.0, 0.4, 0.3])])
    path = executed_path(q, RECIPE.motion, stop_at_waypoints=True, step_rad=0.005)
    steps = np.abs(np.diff(path, axis=0)).max(axis=1)
    assert steps.max() <= 0.005
    assert np.median(steps) > 0.003
    for waypoint in q:
        assert np.abs(path - waypoint).max(axis=1).min() < 1e-9 or np.abs(path - waypoint).max(axis=1).min() < 0.005
    np.testing.assert_array_equal(path[[0, -1]], q[[0, -1]])
    # On one of the two straight pieces, to rounding.
    ahead = np.array([min(_off_segment(row, a, b) for a, b in ((q[0], q[1]), (q[1], q[2]))) for row in path])
    assert ahead.max() < 1e-9


def _off_segment(row: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    s = np.clip((row - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
    return float(np.abs(row - a - s * (b - a)).max())


def test_a_free_path_passes_with_the_room_that_it_has() -> None:
    (row,) = audit_unit([solved().item(Audit.PATH_GEOMETRY, PlanStatus.SOLVED)], PARAMS)
    table_from_rows(AUDITS, [row])
    assert row["agrees"]
    assert row["depth_m"] < 0.0
    # Without obstacles the table is nearest: the object is let go of this high above it.
    assert row["clearance_m"] == pytest.approx(RECIPE.planning.release_height_m, abs=1e-5)
    assert row["n_configurations"] > 200
    # From 5 mm on, distances are not told apart.
    recipe = dataclasses.replace(RECIPE, planning=dataclasses.replace(RECIPE.planning, release_height_m=0.008))
    (higher,) = audit_unit([solved(planning=recipe.planning).item(Audit.PATH_GEOMETRY, PlanStatus.SOLVED, recipe=recipe)], PARAMS)
    assert higher["agrees"]
    assert higher["clearance_m"] == pytest.approx(FAR_M, abs=1e-5)


@pytest.mark.parametrize("depth_m", [0.0005, 0.002, 0.006])
def test_an_obstacle_in_the_way_down_is_found_to_its_depth(depth_m: float) -> None:
    """A box that reaches this far into the object where it is set down, on the side that the hand is not on."""
    s = solved()
    T_target = s.scene.targets[0].T_base_target
    # The hand comes along +y; the object ends at 3 cm on the far side, and the box is low enough to stay below the fingers.
    scene = s.with_box(pose(T_target[0, 3], T_target[1, 3] + 0.03 + 0.05 - depth_m, 0.01), (0.10, 0.10, 0.02))
    (row,) = audit_unit([s.item(Audit.PATH_GEOMETRY, PlanStatus.SOLVED, scene)], PARAMS)
    assert row["deepest_pair"] == "descend: object / obstacle 0"
    assert row["depth_m"] == pytest.approx(depth_m, abs=1e-5)
    assert row["clearance_m"] == pytest.approx(-depth_m, abs=1e-5)
    assert row["agrees"] is (depth_m < 0.001)


def test_a_wall_across_the_transport_is_found() -> None:
    """A wall of 1 cm halfway between start and target, which the planner never saw."""
    s = solved()
    (row,) = audit_unit([s.item(Audit.PATH_GEOMETRY, PlanStatus.SOLVED, s.with_box(pose(0.5, 0.14, 0.3), (0.3, 0.01, 0.6)))], PARAMS)
    assert not row["agrees"]
    assert row["depth_m"] > 0.005
    assert row["deepest_pair"].startswith("transport: ")
    assert row["deepest_pair"].endswith("obstacle 0")


def test_an_object_that_slid_into_a_finger_is_found_in_the_retreat() -> None:
    """The pad closes where the plan believes the cuboid to be, 2 cm away from where it hangs: opening does not free it."""
    s = solved()
    T_tcp_object = s.grasp.T_tcp_object.copy()
    T_tcp_object[1, 3] += 0.02
    slid = dataclasses.replace(s.grasp, T_tcp_object=T_tcp_object)
    T_place = fk(s.motion.descend_q_rad[-1]) @ T_tcp_object
    with BulletScene(s.scene, s.object_model) as world:
        verdict = recheck_path(world, slid, T_place, s.motion, RECIPE.motion, PARAMS.step_rad)
    # 12 mm of room on that side.
    assert verdict.depth_m == pytest.approx(0.008, abs=2e-4)
    assert verdict.deepest_pair is not None
    assert verdict.deepest_pair.startswith("retreat: ")
    assert verdict.deepest_pair.endswith("/ object")


def test_a_solved_candidate_stored_as_rejected_flips() -> None:
    s = solved()
    wrong = [PlanStatus.NO_IK, PlanStatus.DESCEND_BLOCKED]
    rows = [audit_unit([s.item(Audit.REJECTION, status)], QUICK)[0] for status in wrong]
    assert [row["agrees"] for row in rows] == [False, False]
    assert [row["audited_status"] for row in rows] == ["solved", "solved"]
    table_from_rows(AUDITS, rows[:1])


def test_true_rejections_hold_for_the_reason_that_is_the_reason() -> None:
    """One thing after another in the way of a solved candidate; the planner's reasons, found by other means."""
    s = solved(axis=0)
    T_target, T_lifted = s.scene.targets[0].T_base_target, s.grasp.T_base_lifted
    scenes = {
        PlanStatus.PLACE_COLLISION: s.with_box(T_target, (0.1, 0.08, 0.12)),
        PlanStatus.NO_IK: dataclasses.replace(s.scene, targets=(Target(0, 0, pose(1.3, 0.0, 0.06)),)),
        # A slab over the way down, beyond the hand.
        PlanStatus.DESCEND_BLOCKED: s.with_box(pose(T_target[0, 3] + 0.1, T_target[1, 3], 0.2), (0.15, 0.2, 0.02)),
        PlanStatus.START_COLLISION: s.with_box(pose(*T_lifted[:2, 3], T_lifted[2, 3] + 0.085), (0.02, 0.02, 0.06)),
    }
    for status, scene in scenes.items():
        planned = judge_candidate(s.object_model, s.elsewhere(scene), RECIPE.planning, RECIPE.seed, CollisionModel(scene, s.object_model))
        (row,) = audit_unit([s.item(Audit.REJECTION, status, scene)], QUICK)
        assert (planned.status, row["audited_status"], row["agrees"]) == (status, status.value, True)
    slid = s.grasp.T_tcp_object.copy()
    slid[1, 3] += 0.02
    grasp = dataclasses.replace(s.grasp, T_tcp_object=slid, T_base_lifted=fk(s.grasp.lifted_q_rad) @ slid)
    with BulletScene(s.scene, s.object_model, exact=True) as world:
        assert (
            rejudge(world, dataclasses.replace(s.candidate, grasp=grasp), RECIPE.planning, QUICK, RECIPE.seed).status
            is PlanStatus.RETREAT_BLOCKED
        )


def test_ten_times_the_budget_finds_what_a_tenth_missed() -> None:
    """A wall between start and target: a hundred checks are too few for a way around it, and so are ten times none."""
    s = solved(axis=0)
    scene = s.with_box(pose(0.6, 0.12, 0.15), (0.25, 0.01, 0.30))

    def row(max_checks: int) -> dict[str, object]:
        planning = dataclasses.replace(RECIPE.planning, search=SearchParams(max_checks=max_checks))
        stored = judge_candidate(s.object_model, s.elsewhere(scene), planning, RECIPE.seed, CollisionModel(scene, s.object_model))
        assert stored.status is PlanStatus.BUDGET_SPENT
        recipe = dataclasses.replace(RECIPE, planning=planning)
        return audit_unit([s.item(Audit.SEARCH_BUDGET, PlanStatus.BUDGET_SPENT, scene, recipe)], PARAMS)[0]

    few, enough = row(1), row(100)
    assert (few["audited_status"], few["agrees"]) == ("budget_spent", True)
    assert (enough["audited_status"], enough["agrees"]) == ("solved", False)
    assert few["n_configurations"] < enough["n_configurations"]  # type: ignore[operator]


def test_rows_do_not_depend_on_order_company_or_workers() -> None:
    far, near = solved(0.36), solved()
    blocked = far.with_box(pose(0.5, 0.36, 0.06), (0.1, 0.1, 0.12))
    items = [
        near.item(Audit.PATH_GEOMETRY, PlanStatus.SOLVED),
        near.item(Audit.REJECTION, PlanStatus.NO_IK, dataclasses.replace(near.scene, scene_id="full-0001")),
        far.item(Audit.PATH_GEOMETRY, PlanStatus.SOLVED, dataclasses.replace(far.scene, scene_id="full-0002")),
        far.item(Audit.REJECTION, PlanStatus.PLACE_COLLISION, dataclasses.replace(blocked, scene_id="full-0003")),
    ]
    reference = content_hash(table_from_rows(AUDITS, audit_rows(items, 0, QUICK)))
    assert content_hash(table_from_rows(AUDITS, audit_rows(items[::-1], 0, QUICK))) == reference
    assert content_hash(table_from_rows(AUDITS, audit_rows(items, 2, QUICK))) == reference
    alone = [row for item in items for row in audit_rows([item], 0, QUICK)]
    assert content_hash(table_from_rows(AUDITS, alone)) == reference


def test_a_solved_candidate_without_a_plan_is_an_error() -> None:
    item = dataclasses.replace(solved().item(Audit.PATH_GEOMETRY, PlanStatus.SOLVED), plan=None)
    with pytest.raises(AuditError, match=rf"{item.candidate_id}: stored as solved, but has no plan"):
        list(audit_rows([item], 0))


def test_candidates_are_chosen_by_hash_within_their_status() -> None:
    statuses = {"solved": 40, "no_ik": 30, "descend_blocked": 3, "budget_spent": 5}
    rows = [
        {"candidate_id": f"full-{k:04d}-t0-g{n:02d}", "plan_status": status}
        for n, (status, m) in enumerate(statuses.items())
        for k in range(m)
    ]
    chosen = choose_audited(pa.Table.from_pylist(rows), 42, 20, 10)
    assert chosen == choose_audited(pa.Table.from_pylist(rows[::-1]), 42, 20, 10)
    assert chosen != choose_audited(pa.Table.from_pylist(rows), 43, 20, 10)
    status_of = {row["candidate_id"]: row["plan_status"] for row in rows}
    counts: dict[tuple[str, str], int] = {}
    for name, audit in chosen:
        counts[status_of[name], audit.value] = counts.get((status_of[name], audit.value), 0) + 1
    assert counts == {
        ("solved", "path_geometry"): 20,
        ("no_ik", "rejection"): 10,
        ("descend_blocked", "rejection"): 3,
        ("budget_spent", "search_budget"): 5,
    }
    # A candidate that is not chosen decides nothing for the others.
    unchosen = set(status_of) - {name for name, _ in chosen}
    fewer = [row for row in rows if row["candidate_id"] != min(unchosen)]
    assert choose_audited(pa.Table.from_pylist(fewer), 42, 20, 10) == chosen


@pytest.mark.parametrize(("name", "value"), [("step_rad", 0.0), ("max_depth_m", -0.001), ("n_q7", 0), ("budget_factor", 0)])
def test_impossible_parameters_are_refused(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{name} = "):
        AuditParams(**{name: value})
