"""The laws of the chain over a whole release: `candidates` and `grasps` are taken apart into the tables that the stages made."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pyarrow as pa
import pyarrow.compute as pc

from pipelines.frames import frame_of
from pipelines.stage import Promise
from pipelines.stages import STAGES
from pipelines.values import SceneAllocation
from tables.columns import TableSchema
from tables.identity import N_TARGETS
from tables.schemas import CANDIDATE_PAIRS, EXECUTION_LABELS, GRASP_ADMISSION, PICK_LIFT, PLANNING_LABELS
from tables.store import table_from_columns
from tables.tolerances import Tolerances

# Which rows of a joined table a stage made: those where this column is not null, or all.
_PARTS: Sequence[tuple[str, TableSchema, str | None]] = (
    ("grasps", GRASP_ADMISSION, None),
    ("grasps", PICK_LIFT, "lift_status"),
    ("candidates", CANDIDATE_PAIRS, None),
    ("candidates", PLANNING_LABELS, None),
    ("candidates", EXECUTION_LABELS, "exec_status"),
)
# What a release may leave out; the laws then say less.
_LEFT_OUT = {"plans", "scene_attempts"}
_EXECUTION_VALUES = [name for name in EXECUTION_LABELS.names if name != "candidate_id"]


def broken_laws(tables: Mapping[str, pa.Table], tolerances: Tolerances) -> list[str]:
    """One sentence for every broken rule; laws about tables that a release leaves out are not asked.

    Args:
        tables: of a release by name, at least `scenes`, `obstacles`, `targets`, `grasps` and `candidates`. What each scene was
            allocated is taken from `scenes` and the object's category there.
        tolerances: what the labels were judged by.
    """
    parts = {**tables, **stage_tables(tables)}
    promise = Promise(allocations_in(tables["scenes"]), N_TARGETS, tolerances)
    errors = _half_executed(tables["candidates"])
    for stage in STAGES:
        reads = {schema.name for schema in (*stage.inputs, *stage.outputs)}
        if reads - _LEFT_OUT <= parts.keys():
            errors += [f"{stage.name}: {error}" for error in stage.law(parts, promise)]
    return errors


def stage_tables(tables: Mapping[str, pa.Table]) -> dict[str, pa.Table]:
    """What the stages made and `grasps` and `candidates` were joined from, by name."""
    return {schema.name: _part(tables[joined], schema, where) for joined, schema, where in _PARTS}


def allocations_in(scenes: pa.Table) -> tuple[SceneAllocation, ...]:
    """What each scene was allocated, taken from its row."""
    return tuple(SceneAllocation(*row) for row in frame_of(scenes, ["scene_id", "object_id", "category", "n_obstacles"]).iter_rows())


def _part(joined: pa.Table, schema: TableSchema, where: str | None) -> pa.Table:
    rows = joined if where is None else joined.filter(pc.is_valid(joined[where]))
    return table_from_columns(schema, {name: rows[name] for name in schema.names})


def _half_executed(candidates: pa.Table) -> list[str]:
    """Values of an execution without its status would be lost where the joined table is taken apart."""
    without = candidates.filter(pc.is_null(candidates["exec_status"]))
    return [
        f"execution_labels: {name} is null where exec_status is; broken by {len(bad)} rows, must be 0; first {bad['candidate_id'][0]}"
        for name in _EXECUTION_VALUES
        if name != "exec_status" and len(bad := without.filter(pc.is_valid(without[name])))
    ]
