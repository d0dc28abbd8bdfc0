"""Finished scenes of a stage that still runs: some seconds in memory, then on disk, so that a killed run keeps them."""

from __future__ import annotations

import logging
import shutil
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import pyarrow as pa

from pipelines.codecs import Row
from pipelines.running.data_root import DataRoot
from pipelines.running.workers import Outcome
from pipelines.stage import Stage, Unit, UnitResult
from tables.columns import TableSchema
from tables.schemas import TIMINGS
from tables.store import Missing, find_published, join_tables, read_table, table_from_rows, write_table

LOG = logging.getLogger(__name__)

# A scene's files cost 25 ms to write: stages that take less than this in all never write any.
SECONDS_IN_MEMORY = 5.0


class SceneParts:
    """The parts of one stage of one shard, made from the same inputs."""

    def __init__(self, stage: Stage, shard: str, root: DataRoot, made_from: Mapping[str, str]) -> None:
        self._stage, self._shard, self._root, self._made_from = stage, shard, root, made_from
        self._schemas = (*stage.outputs, TIMINGS)
        self._in_memory: dict[str, dict[str, pa.Table]] = {}
        self._flushed_s = time.monotonic()

    def is_on_disk(self, scene_id: str) -> bool:
        """Whether an earlier run finished the scene from the same inputs; a damaged part is told to the log and counts as missing."""
        found = [find_published(schema, self._path(schema, scene_id), self._made_from, scene_id) for schema in self._schemas]
        missing = [part for part in found if isinstance(part, Missing)]
        damaged = [part for part in missing if part.is_damaged]
        if damaged:
            LOG.warning("%s.%s: finished scene is damaged, made again: %s", self._shard, self._stage.name, "; ".join(map(str, damaged)))
        return not missing

    def add(self, scene_id: str, results: Sequence[UnitResult]) -> None:
        """Keep a finished scene; raises SchemaError where its rows are not what the schemas say."""
        rows: dict[str, list[Row]] = {schema.name: [] for schema in self._schemas}
        for result in results:
            for name, more in result.rows.items():
                rows[name] += more
            rows["timings"] += result.timings
        self._in_memory[scene_id] = {schema.name: table_from_rows(schema, rows[schema.name]) for schema in self._schemas}

    def flush_if_due(self) -> None:
        """Write what is in memory only, where the last time is long enough ago."""
        if self._in_memory and time.monotonic() - self._flushed_s > SECONDS_IN_MEMORY:
            self.flush()

    def flush(self) -> None:
        """Write what is in memory only."""
        for scene_id, tables in self._in_memory.items():
            for schema in self._schemas:
                write_table(schema, tables[schema.name], self._path(schema, scene_id), self._made_from, of=scene_id)
        self._in_memory.clear()
        self._flushed_s = time.monotonic()

    def joined(self, schema: TableSchema, scene_ids: Sequence[str]) -> pa.Table:
        """One table over scenes that are all finished."""
        return join_tables(schema, [self._table(schema, scene_id) for scene_id in scene_ids])

    def delete(self) -> None:
        """Forget all parts: their tables are published."""
        self._in_memory.clear()
        folder = self._root.scene_part(self._shard, self._stage.name, "scene", "table").parent.parent
        if folder.exists():
            shutil.rmtree(folder)

    def _table(self, schema: TableSchema, scene_id: str) -> pa.Table:
        if scene_id in self._in_memory:
            return self._in_memory[scene_id][schema.name]
        return read_table(schema, self._path(schema, scene_id), of=scene_id)

    def _path(self, schema: TableSchema, scene_id: str) -> Path:
        return self._root.scene_part(self._shard, self._stage.name, scene_id, schema.name)


class SceneCollector:
    """The units of a stage that are still to come, by scene, and what the others gave: a part, or the scene's failure."""

    def __init__(self, units: Sequence[Unit], scene_ids: Sequence[str], parts: SceneParts) -> None:
        self.failures: dict[str, str] = {}
        self.core_ms = self.peak_gib = 0.0
        self._parts = parts
        self._n_left = Counter(unit.allocation.scene_id for unit in units)
        self._results: dict[str, list[UnitResult]] = {scene_id: [] for scene_id in scene_ids}
        for scene_id in scene_ids:
            if self._n_left[scene_id] == 0:
                parts.add(scene_id, [])

    def enter(self, unit: Unit, outcome: Outcome) -> None:
        """A unit's outcome; the scene's last one makes it a part."""
        scene_id = unit.allocation.scene_id
        self.core_ms += outcome.core_ms
        self.peak_gib = max(self.peak_gib, outcome.peak_gib)
        self._n_left[scene_id] -= 1
        if outcome.error is None:
            self._results[scene_id].append(outcome.value)
        else:
            self.failures.setdefault(scene_id, f"{unit.item_id}: {outcome.error}")
        if self._n_left[scene_id] == 0 and scene_id not in self.failures:
            self._parts.add(scene_id, self._results.pop(scene_id))
        self._parts.flush_if_due()
