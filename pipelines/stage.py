"""What a stage of the chain is: the one record that assets, gates, progress and provenance are derived from.

Each stage declares its record beside its function; stages.py puts them in order, running/ runs them.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeVar, cast

import pyarrow as pa

from objects.object_model import ObjectModel
from pipelines.codecs import Row
from pipelines.values import AdmittedGrasp, Known, LiftedGrasp, Scene, SceneAllocation
from tables.columns import TableSchema
from tables.tolerances import Tolerances

ObjectTable = Literal["objects", "object_meshes", "object_parts", "stable_poses", "grasp_pool"]

_P = TypeVar("_P")

# What an object model holds of each object table.
_FIELDS: dict[ObjectTable, tuple[str, ...]] = {
    "objects": ("category", "symmetry", "mass_kg", "friction", "com_m", "inertia_kg_m2"),
    "object_meshes": ("mesh",),
    "object_parts": ("parts",),
    "stable_poses": ("stable_poses",),
    "grasp_pool": ("grasps",),
}


@dataclass(frozen=True, slots=True)
class Unit:
    """What one unit of work is given: an object, a scene and what is known of it; of one grasp where the stage splits by grasp."""

    object_model: ObjectModel
    allocation: SceneAllocation
    known: Known
    sections: tuple[Any, ...]
    seed: int
    grasp_id: int | None = None

    @property
    def scene(self) -> Scene:
        """The scene, which every stage but the first is given."""
        if self.known.scene is None:
            raise ValueError(f"{self.allocation.scene_id}: asked for its scene before it was sampled")
        return self.known.scene

    @property
    def item_id(self) -> str:
        """Scene id, or scene and grasp."""
        return self.allocation.scene_id if self.grasp_id is None else f"{self.allocation.scene_id}-g{self.grasp_id:02d}"

    def params(self, kind: type[_P]) -> _P:
        """A section of the recipe by its type; raises ValueError where the stage did not declare it."""
        for section in self.sections:
            if isinstance(section, kind):
                return section
        declared = [type(section).__name__ for section in self.sections]
        raise ValueError(f"{self.item_id}: section {kind.__name__} of the recipe, must be one that the stage declares: {declared}")


@dataclass(frozen=True, slots=True)
class UnitResult:
    """Rows by table, and the core time of each item in them."""

    rows: dict[str, list[Row]]
    timings: list[Row]


@dataclass(frozen=True, slots=True)
class Promise:
    """What identity and recipe promise before anything is made; laws hold tables against it."""

    allocations: tuple[SceneAllocation, ...]
    n_targets: int
    tolerances: Tolerances


# Tables that the stage makes and reads, by name; one sentence for every rule that is broken.
Law = Callable[[Mapping[str, pa.Table], Promise], list[str]]


@dataclass(frozen=True, slots=True)
class Stage:
    """One stage of the chain.

    Attributes:
        group: of the asset graph, and the folder it lives in.
        description: the sentence a user reads in the UI.
        code_version: changes whenever its results may change; golden rows in the tests insist on it.
        inputs: tables of the same shard that `run` or `law` reads.
        objects: object tables that `run` reads; units get an object model with these parts and no others.
        sections: the types of the recipe's sections that `run` reads; it gets these and no others.
        engines: packages whose versions may change its results.
        run: makes the rows of one unit, from its argument alone.
        law: what must hold of the tables, before they are published and ever after.
        split: a unit of work is a whole scene, one of its admitted grasps, or one of its lifted grasps.
        time_share: of the core time of a shard, for the first estimate of a progress bar.
    """

    name: str
    group: str
    description: str
    code_version: str
    inputs: tuple[TableSchema, ...]
    objects: tuple[ObjectTable, ...]
    outputs: tuple[TableSchema, ...]
    sections: tuple[type, ...]
    engines: tuple[str, ...]
    run: Callable[[Unit], UnitResult]
    law: Law
    split: Literal["scene", "admitted", "lifted"] = "scene"
    time_share: float = 0.0

    def units(
        self, object_model: ObjectModel, allocation: SceneAllocation, known: Known, sections: tuple[Any, ...], seed: int
    ) -> list[Unit]:
        """The units of one scene, in grasp order where there is one a grasp."""
        whole = Unit(part_of(object_model, self.objects), allocation, known, sections, seed)
        if self.split == "scene":
            return [whole]
        grasps: tuple[AdmittedGrasp | LiftedGrasp, ...] = known.admitted if self.split == "admitted" else known.lifted
        return [dataclasses.replace(whole, known=known.of_grasp(g.grasp_id), grasp_id=g.grasp_id) for g in grasps]


def part_of(object_model: ObjectModel, tables: tuple[ObjectTable, ...]) -> ObjectModel:
    """An object model that holds what some object tables say, and None for everything else: reading that is a bug and fails at once."""
    left_out = {name: cast(Any, None) for table, names in _FIELDS.items() if table not in tables for name in names}
    return dataclasses.replace(object_model, **left_out)


def timing_row(stage: str, item_id: str, start_ns: int) -> Row:
    """A row of `timings` for the core time since `start_ns` of `time.process_time_ns`."""
    return {"stage": stage, "item_id": item_id, "core_ms": (time.process_time_ns() - start_ns) / 1e6}
