"""A stage gets what it declares and nothing else, and splits a scene into the units it says."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from pipelines.recipe import Recipe, RecipeError
from pipelines.stage import Unit, part_of
from pipelines.stages import STAGE, STAGES
from pipelines.values import Candidate, Known, SceneAllocation
from tables.columns import TableSchema
from tables.identity import IdentityError
from tables.schemas import OBJECT_TABLES
from tests.pipelines.engines.physics.lifted import lifted

ALLOCATION = SceneAllocation("full-0000", "test_can", "can", 0)


def known() -> Known:
    case = lifted("can")
    candidates = tuple(Candidate(case.scene, grasp, target) for grasp in case.grasps for target in case.scene.targets)
    return Known(case.scene, (), case.grasps, candidates, {candidate.candidate_id: plan for candidate, plan in case.planned})


def test_a_part_of_an_object_model_holds_what_its_tables_say_and_fails_at_once_elsewhere() -> None:
    whole = lifted("can").object_model
    part = part_of(whole, ("object_parts", "grasp_pool"))
    assert part.parts is whole.parts
    assert part.grasps is whole.grasps
    assert part.object_id == whole.object_id
    with pytest.raises(AttributeError):
        part.mesh.vertices_m  # noqa: B018
    with pytest.raises(TypeError):
        len(part.stable_poses)
    same = part_of(whole, OBJECT_TABLES)  # type: ignore[arg-type]
    assert all(getattr(same, field.name) is getattr(whole, field.name) for field in dataclasses.fields(whole))


def test_units_of_a_stage_by_scene_and_by_grasp() -> None:
    case, everything = lifted("can"), known()
    (whole,) = STAGE["policy_features"].units(case.object_model, ALLOCATION, everything, (), 42)
    assert (whole.grasp_id, whole.item_id, len(whole.known.candidates)) == (None, "full-0000", len(everything.candidates))
    units = STAGE["execution_labels"].units(case.object_model, ALLOCATION, everything, (), 42)
    assert [unit.grasp_id for unit in units] == [grasp.grasp_id for grasp in case.grasps]
    for unit in units:
        assert {candidate.grasp.grasp_id for candidate in unit.known.candidates} == {unit.grasp_id}
        assert unit.known.plans.keys() <= {candidate.candidate_id for candidate in unit.known.candidates}
    assert sum(len(unit.known.plans) for unit in units) == len(everything.plans)


def test_a_unit_gets_the_sections_its_stage_declares() -> None:
    recipe, stage = Recipe(), STAGE["planning_labels"]
    unit = Unit(lifted("can").object_model, ALLOCATION, Known(), recipe.sections(*stage.sections), recipe.seed)
    assert unit.params(type(recipe.planning)) is recipe.planning
    with pytest.raises(ValueError, match=r"full-0000: section PhysicsParams of the recipe, must be one that the stage declares"):
        unit.params(type(recipe.physics))
    with pytest.raises(ValueError, match="asked for its scene before it was sampled"):
        unit.scene  # noqa: B018
    with pytest.raises(RecipeError, match="int: no section of the recipe"):
        recipe.sections(int)


def test_a_recipe_hash_of_a_stage_moves_with_its_own_sections_only() -> None:
    recipe = Recipe()
    other = dataclasses.replace(recipe, planning=dataclasses.replace(recipe.planning, preplace_m=0.2))
    moved = {s.name for s in STAGES if recipe.hash_of_sections(*s.sections) != other.hash_of_sections(*s.sections)}
    assert moved == {"policy_features", "planning_labels", "execution_labels"}


def test_values_refuse_ids_they_do_not_hold() -> None:
    scene = lifted("can").scene
    with pytest.raises(IdentityError, match=r"full-0000: target 9, must be one of \[0, 1, 2, 3\]"):
        scene.target(9)


def test_a_candidate_s_poses_are_its_target_and_what_was_measured_in_the_hand() -> None:
    candidate, _ = lifted("can").planned[0]
    released = candidate.release_pose(0.01)
    np.testing.assert_allclose(released - candidate.target.T_base_target, _up(0.01), atol=1e-15)
    np.testing.assert_allclose(candidate.place_pose(0.01) @ candidate.grasp.T_tcp_object, released, atol=1e-12)


def _up(by_m: float) -> np.ndarray:
    T = np.zeros((4, 4))
    T[2, 3] = by_m
    return T


def test_stages_read_only_what_comes_before_them() -> None:
    made: list[TableSchema] = []
    for stage in STAGES:
        assert [schema.name for schema in stage.inputs if schema not in made] == [], stage.name
        assert stage.law.__doc__
        made += stage.outputs
    assert len({schema.name for schema in made}) == len(made)
