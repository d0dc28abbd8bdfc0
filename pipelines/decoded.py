"""The tables of a release as values by id, decoded where they are asked for; see splits/ for whether the release is sound."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TypeVar

import pyarrow as pa

from objects.object_model import ObjectModel, object_models_from_tables
from pipelines.codecs import Row, lifted_grasps, plan_in, rows_by, scenes_from_tables
from pipelines.values import Candidate, LiftedGrasp, Plan, Scene
from tables.identity import IdentityError, parse_candidate_id
from tables.schemas import OBJECT_TABLES

_T = TypeVar("_T")


class Decoded:
    """Candidates, scenes and object models of some tables.

    Args:
        tables: by name; each method needs those it names, and decodes the small ones whole and the large ones row by row.
    """

    def __init__(self, tables: Mapping[str, pa.Table]) -> None:
        self._tables = tables
        self._lifted: dict[str, dict[int, LiftedGrasp]] = {}

    @cached_property
    def object_models(self) -> dict[str, ObjectModel]:
        """Object models by id (the five object tables)."""
        return object_models_from_tables(*(self._tables[name] for name in OBJECT_TABLES))

    @cached_property
    def scenes(self) -> dict[str, Scene]:
        """Scenes by id (`scenes`, `obstacles`, `targets`)."""
        return scenes_from_tables(*(self._tables[name] for name in ("scenes", "obstacles", "targets")))

    @cached_property
    def grasp_rows(self) -> dict[str, list[Row]]:
        """Rows of `grasps` by scene."""
        return rows_by(self._tables["grasps"], "scene_id")

    def scene(self, scene_id: str) -> Scene:
        """A scene; raises IdentityError where the tables have none of that id."""
        return _found("scene", scene_id, self.scenes)

    def lifted(self, scene_id: str) -> dict[int, LiftedGrasp]:
        """Lifted grasps of a scene by id (`grasps`)."""
        if scene_id not in self._lifted:
            self._lifted[scene_id] = {grasp.grasp_id: grasp for grasp in lifted_grasps(self.grasp_rows.get(scene_id, []))}
        return self._lifted[scene_id]

    def object_model_of(self, candidate: Candidate) -> ObjectModel:
        """The object of a candidate's scene."""
        return self.object_models[candidate.scene.object_id]

    def candidate(self, candidate_id: str) -> Candidate:
        """A candidate; raises IdentityError where the tables have no such scene, target or lifted grasp."""
        c = parse_candidate_id(candidate_id)
        scene, lifted = self.scene(c.scene_id), self.lifted(c.scene_id)
        if c.grasp_id not in lifted:
            raise IdentityError(f"{candidate_id}: grasp {c.grasp_id} was not lifted, must be one of {sorted(lifted)}")
        return Candidate(scene, lifted[c.grasp_id], scene.target(c.target_id))

    def labels(self, candidate_id: str) -> Row:
        """A row of `candidates`; raises IdentityError where there is none."""
        return self._row("candidates", self._candidate_index, candidate_id)

    def plan(self, candidate_id: str) -> Plan | None:
        """The stored plan of a candidate, None where it has none (`plans`)."""
        return plan_in(self._row("plans", self._plan_index, candidate_id)) if candidate_id in self._plan_index else None

    @cached_property
    def _candidate_index(self) -> dict[str, int]:
        return _index(self._tables["candidates"])

    @cached_property
    def _plan_index(self) -> dict[str, int]:
        return _index(self._tables["plans"])

    def _row(self, table: str, index: Mapping[str, int], candidate_id: str) -> Row:
        row: Row = self._tables[table].slice(_found("candidate", candidate_id, index), 1).to_pylist()[0]
        return row


def _index(table: pa.Table) -> dict[str, int]:
    return {name: k for k, name in enumerate(table["candidate_id"].to_pylist())}


def _found(kind: str, name: str, values: Mapping[str, _T]) -> _T:
    try:
        return values[name]
    except KeyError:
        raise IdentityError(f"{name}: no such {kind} among {len(values)}") from None
