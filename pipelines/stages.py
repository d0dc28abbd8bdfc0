"""The chain from scenes to labels as data: what each stage reads, writes and runs; the stages themselves are one module each."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pyarrow as pa

from objects.object_model import ObjectModel
from pipelines.candidates.pairing import candidate_pair_rows
from pipelines.candidates.policy_features import policy_feature_rows
from pipelines.codecs import Row, admitted_grasps, lifted_grasps, plan_in, scenes_from_tables
from pipelines.engines.planning.collision import CollisionModel
from pipelines.grasps.admission import admission_rows
from pipelines.grasps.pick_lift import pick_lift_rows
from pipelines.labels.execution import execution_rows
from pipelines.labels.planning import planning_rows
from pipelines.recipe import Recipe
from pipelines.scenes.allocation import SceneAllocation
from pipelines.scenes.points import scene_point_rows
from pipelines.scenes.sampling import sample_scene
from pipelines.values import Scene
from tables import schemas as s
from tables.columns import TableSchema
from tables.identity import parse_candidate_id
from tables.store import table_from_rows

SceneRows = Mapping[str, list[Row]]


@dataclass(frozen=True, slots=True)
class Unit:
    """What one unit of work is given: a scene and what is known of it so far, narrowed to one grasp where a stage splits by grasp."""

    recipe: Recipe
    object_model: ObjectModel
    allocation: SceneAllocation
    rows: SceneRows
    grasp_id: int | None = None


@dataclass(frozen=True, slots=True)
class UnitResult:
    """Rows by table, and the core time of each item in them."""

    rows: dict[str, list[Row]]
    timings: list[Row]


@dataclass(frozen=True, slots=True)
class Stage:
    """One stage of the chain. `code_version` changes when its results may change; `grasp_ids` splits a scene into units."""

    name: str
    code_version: str
    inputs: tuple[TableSchema, ...]
    outputs: tuple[TableSchema, ...]
    recipe_sections: tuple[str, ...]
    run: Callable[[Unit], UnitResult]
    grasp_ids: Callable[[SceneRows], list[int]] | None = None


def _sample(unit: Unit) -> UnitResult:
    recipe, allocation = unit.recipe, unit.allocation
    start = time.process_time_ns()
    tables = sample_scene(
        unit.object_model, allocation.scene_id, allocation.n_obstacles, recipe.scene_sampling, recipe.physics, recipe.seed
    )
    rows = {"scenes": tables.scenes, "scene_attempts": tables.scene_attempts, "obstacles": tables.obstacles, "targets": tables.targets}
    return UnitResult(rows, [_timing("scenes", allocation.scene_id, start)])


def _render_points(unit: Unit) -> UnitResult:
    start = time.process_time_ns()
    rows = scene_point_rows(unit.object_model, _scene(unit), unit.recipe.camera, unit.recipe.seed)
    return UnitResult({"scene_points": rows}, [_timing("scene_points", unit.allocation.scene_id, start)])


def _admit(unit: Unit) -> UnitResult:
    start = time.process_time_ns()
    rows = admission_rows(unit.object_model, _scene(unit), unit.recipe.grasp_admission)
    return UnitResult({"grasp_admission": rows}, [_timing("grasp_admission", unit.allocation.scene_id, start)])


def _lift(unit: Unit) -> UnitResult:
    start = time.process_time_ns()
    recipe = unit.recipe
    admitted = [grasp for grasp in admitted_grasps(unit.rows["grasp_admission"]) if grasp.grasp_id == unit.grasp_id]
    rows = pick_lift_rows(unit.object_model, _scene(unit), admitted, recipe.pick_lift, recipe.motion, recipe.physics)
    return UnitResult({"pick_lift": rows}, [_timing("pick_lift", f"{unit.allocation.scene_id}-g{unit.grasp_id:02d}", start)])


def _pair(unit: Unit) -> UnitResult:
    start = time.process_time_ns()
    rows = candidate_pair_rows(unit.allocation, _scene(unit), lifted_grasps(unit.rows["pick_lift"]))
    return UnitResult({"candidate_pairs": rows}, [_timing("candidate_pairs", unit.allocation.scene_id, start)])


def _judge_cheaply(unit: Unit) -> UnitResult:
    scene = _scene(unit)
    grasp_ids = [grasp.grasp_id for grasp in lifted_grasps(unit.rows["pick_lift"])]
    rows, timings = policy_feature_rows(
        unit.object_model, scene, grasp_ids, [target.target_id for target in scene.targets], unit.recipe.planning.n_q7
    )
    return UnitResult({"policy_features": rows}, timings)


def _plan(unit: Unit) -> UnitResult:
    scene, recipe = _scene(unit), unit.recipe
    (grasp,) = (grasp for grasp in lifted_grasps(unit.rows["pick_lift"]) if grasp.grasp_id == unit.grasp_id)
    labels, plans, timings = [], [], []
    for target in scene.targets:
        start = time.process_time_ns()
        model = _collision_model(_ByIdentity(scene.scene_id, scene, unit.object_model))
        label, plan = planning_rows(unit.object_model, scene, grasp, [target.target_id], recipe.planning, recipe.motion, recipe.seed, model)
        labels += label
        plans += plan
        timings.append(_timing("planning_labels", label[0]["candidate_id"], start))
    return UnitResult({"planning_labels": labels, "plans": plans}, timings)


def _execute(unit: Unit) -> UnitResult:
    scene, recipe = _scene(unit), unit.recipe
    (grasp,) = (grasp for grasp in lifted_grasps(unit.rows["pick_lift"]) if grasp.grasp_id == unit.grasp_id)
    plans = {parse_candidate_id(row["candidate_id"]).target_id: plan_in(row) for row in unit.rows["plans"]}
    rows, timings, start = [], [], time.process_time_ns()
    for row in execution_rows(unit.object_model, scene, grasp, plans, recipe.execution, recipe.motion, recipe.physics):
        rows.append(row)
        timings.append(_timing("execution_labels", row["candidate_id"], start))
        start = time.process_time_ns()
    if timings:  # the engine's end
        timings[-1]["core_ms"] += (time.process_time_ns() - start) / 1e6
    return UnitResult({"execution_labels": rows}, timings)


def _admitted_ids(rows: SceneRows) -> list[int]:
    return [grasp.grasp_id for grasp in admitted_grasps(rows["grasp_admission"])]


def _lifted_ids(rows: SceneRows) -> list[int]:
    return [grasp.grasp_id for grasp in lifted_grasps(rows["pick_lift"])]


_SCENE = (s.SCENES, s.OBSTACLES, s.TARGETS)

STAGES = (
    Stage("scenes", "2", (), (s.SCENES, s.SCENE_ATTEMPTS, s.OBSTACLES, s.TARGETS), ("scene_sampling", "physics"), _sample),
    Stage("scene_points", "1", _SCENE, (s.SCENE_POINTS,), ("camera",), _render_points),
    Stage("grasp_admission", "1", _SCENE, (s.GRASP_ADMISSION,), ("grasp_admission",), _admit),
    Stage("pick_lift", "2", (*_SCENE, s.GRASP_ADMISSION), (s.PICK_LIFT,), ("pick_lift", "motion", "physics"), _lift, _admitted_ids),
    Stage("candidate_pairs", "1", (*_SCENE, s.PICK_LIFT), (s.CANDIDATE_PAIRS,), (), _pair),
    Stage("policy_features", "2", (*_SCENE, s.PICK_LIFT), (s.POLICY_FEATURES,), ("planning",), _judge_cheaply),
    Stage(
        "planning_labels",
        "1",
        (*_SCENE, s.PICK_LIFT),
        (s.PLANNING_LABELS, s.PLANS),
        ("planning", "motion"),
        _plan,
        _lifted_ids,
    ),
    Stage(
        "execution_labels",
        "2",
        (*_SCENE, s.PICK_LIFT, s.PLANS),
        (s.EXECUTION_LABELS,),
        ("execution", "motion", "physics"),
        _execute,
        _lifted_ids,
    ),
)
STAGE = {stage.name: stage for stage in STAGES}


def _scene(unit: Unit) -> Scene:
    tables = [table_from_rows(schema, unit.rows[schema.name]) for schema in _SCENE]
    return scenes_from_tables(*tables)[unit.allocation.scene_id]


@dataclass(frozen=True, slots=True)
class _ByIdentity:
    """Cache key of a scene's collision model: the values themselves hold arrays and cannot be hashed."""

    scene_id: str
    scene: Scene
    object_model: ObjectModel

    def _contents(self) -> tuple[bytes, ...]:
        scene = self.scene
        poses = [scene.T_base_object, *(o.T_base_obstacle for o in scene.obstacles), *(o.size_m for o in scene.obstacles)]
        return tuple(np.ascontiguousarray(part).tobytes() for part in (*poses, *(p.vertices_m for p in self.object_model.parts)))

    def __hash__(self) -> int:
        return hash((self.scene_id, self._contents()))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _ByIdentity) and self.scene_id == other.scene_id and self._contents() == other._contents()


@lru_cache(maxsize=1)
def _collision_model(key: _ByIdentity) -> CollisionModel:
    """A worker's units come scene by scene: building the model once a scene instead of once a grasp saves 11 ms a grasp."""
    return CollisionModel(key.scene, key.object_model)


def _timing(stage: str, item_id: str, start_ns: int) -> Row:
    return {"stage": stage, "item_id": item_id, "core_ms": (time.process_time_ns() - start_ns) / 1e6}


def rows_by_scene(tables: Mapping[str, pa.Table], scene_ids: Sequence[str]) -> dict[str, dict[str, list[Row]]]:
    """Rows of some scenes in each table; a table keyed by candidate is matched by the scene in the candidate's id."""
    out: dict[str, dict[str, list[Row]]] = {scene_id: {name: [] for name in tables} for scene_id in scene_ids}
    for name, table in tables.items():
        for row in table.to_pylist():
            scene_id = row["scene_id"] if "scene_id" in row else parse_candidate_id(row["candidate_id"]).scene_id
            if scene_id in out:
                out[scene_id][name].append(row)
    return out


def units_of(stage: Stage, recipe: Recipe, object_model: ObjectModel, allocation: SceneAllocation, rows: SceneRows) -> list[Unit]:
    """The units of one scene: one, or one a grasp; a grasp's unit carries that grasp's plans only."""
    if stage.grasp_ids is None:
        return [Unit(recipe, object_model, allocation, rows)]
    return [Unit(recipe, object_model, allocation, {**rows, **_plans_of(rows, grasp)}, grasp) for grasp in stage.grasp_ids(rows)]


def _plans_of(rows: SceneRows, grasp_id: int) -> dict[str, list[Row]]:
    plans = rows.get("plans")
    return {} if plans is None else {"plans": [p for p in plans if parse_candidate_id(p["candidate_id"]).grasp_id == grasp_id]}
