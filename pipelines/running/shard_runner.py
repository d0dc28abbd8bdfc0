"""Runs one stage on one shard: what is already published is kept, what is missing is made, a failed scene costs only itself."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc

from objects.catalogue import catalogue_order
from objects.object_model import ObjectModel, object_models_from_tables
from pipelines import stages
from pipelines.codecs import known_in, rows_by_scene
from pipelines.recipe import Recipe
from pipelines.running.data_root import DataRoot
from pipelines.running.kernels import check_kernels
from pipelines.running.lock import locked
from pipelines.running.unfinished import SceneCollector, SceneParts
from pipelines.running.workers import run_units
from pipelines.scenes.allocation import scene_allocation
from pipelines.stage import Promise, Stage, Unit
from pipelines.values import SceneAllocation
from tables.columns import TableSchema
from tables.errors import PlaceBenchError
from tables.schemas import ALL_SCHEMAS, OBJECT_TABLES, TIMINGS
from tables.sidecar import Missing, Sidecar, StoreError, find_published, read_sidecar
from tables.store import content_hash, read_tables, table_from_columns, write_table
from tables.versions import library_versions
from tables.vocabulary import Allocation


class StageError(PlaceBenchError, RuntimeError):
    """Scenes of a shard that could not be made; the message has each one's id and reason, the others are kept."""


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a stage is: units done, units in all."""

    stage: str
    shard: str
    done: int
    total: int


@dataclass(frozen=True, slots=True)
class StageReport:
    """What a run of a stage published, and what it cost in this run."""

    sidecars: dict[str, Sidecar]
    is_reused: bool
    n_units: int = 0
    wall_s: float = 0.0
    core_s: float = 0.0
    peak_gib: float = 0.0


@dataclass(frozen=True, slots=True)
class ShardInputs:
    """What a stage reads besides tables of the same shard: recipe, objects and the hashes of their tables, allocations of the scenes."""

    recipe: Recipe
    object_models: Mapping[str, ObjectModel]
    allocations: Sequence[SceneAllocation]
    object_hashes: Mapping[str, str]

    @property
    def promise(self) -> Promise:
        """What the tables of the shard must hold."""
        return self.recipe.promise(self.allocations)


def load_shard_inputs(root: DataRoot, shard: str, recipe: Recipe, catalogue: Path) -> ShardInputs:
    """Inputs of a whole shard, with the objects that are published below `root`.

    Args:
        catalogue: file that the objects are of.

    Raises:
        CatalogueError: the catalogue is not what it should be.
        IdentityError: a dataset of this catalogue has no such shard.
        StoreError: the object tables are not published.
    """
    order = catalogue_order(catalogue)
    allocations = [scene_allocation(scene_id, order) for scene_id in order.layout.scenes_of_shard(shard)]
    hashes = {name: read_sidecar(root.object_table(name)).content_hash for name in OBJECT_TABLES}
    tables = root.read_objects()
    if order.allocation is Allocation.APPENDED:
        # Of its own object alone: a shard stays as it is when the catalogue gets another one.
        own = sorted({allocation.object_id for allocation in allocations})
        hashes = {name: content_hash(_of_objects(ALL_SCHEMAS[name], table, own)) for name, table in tables.items()}
    return ShardInputs(recipe, object_models_from_tables(**tables), allocations, hashes)


def _of_objects(schema: TableSchema, table: pa.Table, object_ids: Sequence[str]) -> pa.Table:
    own = table.filter(pc.is_in(table["object_id"].cast(pa.string()), pa.array(object_ids, pa.string())))
    return table_from_columns(schema, {name: own[name] for name in schema.names})


def run_stage(
    stage: Stage,
    shard: str,
    root: DataRoot,
    inputs: ShardInputs,
    n_workers: int,
    on_progress: Callable[[Progress], None] = lambda _: None,
    log: Callable[[str], object] = lambda _: None,
) -> StageReport:
    """Publish the tables of one stage for one shard.

    Args:
        n_workers: worker processes; 0 stays in this process. The result does not depend on it.
        on_progress: called after every unit.
        log: told of what was damaged and is made again.

    Raises:
        StageError: at least one scene failed. Finished scenes stay on disk, and the next run makes only the missing ones.
        StoreError: an upstream table is not published.
        LockError: somebody else builds this shard; names the owner.
        KernelsError: OpenBLAS runs kernels of another processor.
    """
    check_kernels()
    with locked(root.shard_lock(shard), f"shard {shard}"):
        return _run_stage(stage, shard, root, inputs, n_workers, on_progress, log)


def _run_stage(
    stage: Stage,
    shard: str,
    root: DataRoot,
    inputs: ShardInputs,
    n_workers: int,
    on_progress: Callable[[Progress], None],
    log: Callable[[str], object],
) -> StageReport:
    start = time.perf_counter()
    made_from = _made_from(stage, shard, root, inputs)
    published = _published(stage, shard, root, made_from, log)
    parts = SceneParts(stage, shard, root, made_from)
    if published is not None:
        parts.delete()
        return StageReport(published, is_reused=True)
    upstream = root.read_shard(shard, stage.inputs)
    missing = [allocation for allocation in inputs.allocations if not parts.is_on_disk(allocation.scene_id)]
    units = units_of_shard(stage, inputs, upstream, missing)
    collector = SceneCollector(units, [allocation.scene_id for allocation in missing], parts)
    try:
        with closing(run_units(stage.run, [(unit,) for unit in units], n_workers, preload=(stages,))) as outcomes:
            for n_done, outcome in enumerate(outcomes, 1):
                collector.enter(units[outcome.index], outcome)
                on_progress(Progress(stage.name, shard, n_done, len(units)))
        if collector.failures:
            reasons = "\n".join(collector.failures[scene_id] for scene_id in sorted(collector.failures))
            n_failed, n_scenes = len(collector.failures), len(inputs.allocations)
            raise StageError(f"{shard}.{stage.name}: {n_failed} of {n_scenes} scenes failed, must be 0; the others are kept:\n{reasons}")
        sidecars = _publish(stage, shard, root, inputs, upstream, parts, made_from)
    except BaseException as why:
        # Whatever ended the stage early, an interrupt too: finished scenes are not made again.
        try:
            parts.flush()
        except OSError as failure:
            why.add_note(f"and finished scenes of {shard}.{stage.name} could not be kept: {failure}")
        raise
    return StageReport(sidecars, False, len(units), time.perf_counter() - start, collector.core_ms / 1e3, collector.peak_gib)


def units_of_shard(
    stage: Stage, inputs: ShardInputs, upstream: Mapping[str, pa.Table], allocations: Sequence[SceneAllocation]
) -> list[Unit]:
    """The units of some scenes, scene by scene; what earlier stages found out is decoded here, once a scene."""
    rows = rows_by_scene(upstream, [allocation.scene_id for allocation in allocations])
    sections = inputs.recipe.sections(*stage.sections)
    return [
        unit
        for allocation in allocations
        for unit in stage.units(
            inputs.object_models[allocation.object_id], allocation, known_in(rows[allocation.scene_id]), sections, inputs.recipe.seed
        )
    ]


def is_published(stage: Stage, shard: str, root: DataRoot, inputs: ShardInputs) -> bool:
    """Whether the tables of a stage are on disk, unchanged, of this shard, and made from what would be used today."""
    try:
        made_from = _made_from(stage, shard, root, inputs)
    except StoreError:
        return False
    return _published(stage, shard, root, made_from, lambda _: None) is not None


def _made_from(stage: Stage, shard: str, root: DataRoot, inputs: ShardInputs) -> dict[str, str]:
    """What identifies the inputs of a stage; equal inputs give equal tables, so a stored table with these is up to date.

    Versions of the engines belong to it: an upgrade is never silently mixed with older labels.
    """
    return {
        "stage": stage.name,
        "code": stage.code_version,
        "recipe": inputs.recipe.hash_of_sections(*stage.sections),
        **{f"object.{name}": inputs.object_hashes[name] for name in stage.objects},
        **{f"table.{t.name}": read_sidecar(root.shard_table(shard, t.name)).content_hash for t in stage.inputs},
        **{f"engine.{name}": version for name, version in library_versions(stage.engines).items()},
    }


def _published(
    stage: Stage, shard: str, root: DataRoot, made_from: Mapping[str, str], log: Callable[[str], object]
) -> dict[str, Sidecar] | None:
    """The sidecars of a stage's tables, None where one has to be made; what is damaged is told in one line and counts as missing."""
    found = {schema.name: find_published(schema, root.shard_table(shard, schema.name), made_from, shard) for schema in stage.outputs}
    for missing in found.values():
        if isinstance(missing, Missing) and missing.is_damaged:
            log(f"{missing}; made again")
    sidecars = {name: sidecar for name, sidecar in found.items() if isinstance(sidecar, Sidecar)}
    return sidecars if len(sidecars) == len(found) else None


def _publish(
    stage: Stage,
    shard: str,
    root: DataRoot,
    inputs: ShardInputs,
    upstream: Mapping[str, pa.Table],
    parts: SceneParts,
    made_from: Mapping[str, str],
) -> dict[str, Sidecar]:
    """Join the scenes, hold them against the law of the stage, and write what is lawful: a published table always is."""
    scene_ids = [allocation.scene_id for allocation in inputs.allocations]
    made = {schema.name: parts.joined(schema, scene_ids) for schema in stage.outputs}
    errors = stage.law({**upstream, **made}, inputs.promise)
    if errors:
        parts.delete()
        raise StageError(f"{shard}.{stage.name}: {len(errors)} laws broken, must be 0; nothing is published:\n" + "\n".join(errors))
    write_table(TIMINGS, parts.joined(TIMINGS, scene_ids), root.timings(shard, stage.name), made_from, of=shard)
    sidecars = {s.name: write_table(s, made[s.name], root.shard_table(shard, s.name), made_from, of=shard) for s in stage.outputs}
    parts.delete()
    return sidecars


def read_timings(root: DataRoot, shards: Sequence[str], stages: Sequence[Stage]) -> pa.Table:
    """Timings of some stages over some shards."""
    return read_tables(TIMINGS, [root.timings(shard, stage.name) for shard in shards for stage in stages])
