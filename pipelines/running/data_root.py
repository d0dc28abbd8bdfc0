"""Where tables lie on disk; nothing else in the project builds a path below the data folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

from tables.columns import TableSchema
from tables.schemas import ALL_SCHEMAS, OBJECT_TABLES
from tables.store import read_table


@dataclass(frozen=True, slots=True)
class DataRoot:
    """`objects/`, `shards/<shard>/`, `tiers/<tier>/`, `release/<tier>/`, `predictions/<tier>/` and `checkpoints/` below one folder."""

    path: Path

    def object_table(self, table: str) -> Path:
        return self.path / "objects" / f"{table}.parquet"

    def built_object(self, object_id: str, table: str) -> Path:
        """One object of the five tables; see object_store.py."""
        return self.path / "objects" / ".built" / object_id / f"{table}.parquet"

    def shard_table(self, shard: str, table: str) -> Path:
        return self.path / "shards" / shard / f"{table}.parquet"

    def timings(self, shard: str, stage: str) -> Path:
        return self.path / "shards" / shard / "timings" / f"{stage}.parquet"

    def scene_part(self, shard: str, stage: str, scene_id: str, table: str) -> Path:
        """A finished scene of a stage that is still running; gone once the stage's tables are published."""
        return self.path / "shards" / shard / ".unfinished" / stage / scene_id / f"{table}.parquet"

    def tier_table(self, tier: str, table: str) -> Path:
        return self.path / "tiers" / tier / f"{table}.parquet"

    def release(self, tier: str) -> Path:
        return self.path / "release" / tier

    def predictions(self, tier: str) -> Path:
        """Folder of the tables about a release that are shipped beside it, named as those of the tier."""
        return self.path / "predictions" / tier

    def validity(self, tier: str) -> Path:
        """Folder of the rows that `make validity` keeps, a file a study."""
        return self.path / "tiers" / tier / "validity"

    def checkpoint(self, tier: str, variant: str, seed: int) -> Path:
        return self.path / "checkpoints" / tier / f"{variant}-{seed}"

    def dataset_record(self) -> Path:
        """Which catalogue the dataset is of, where it is not the benchmark's; see dataset_record.py."""
        return self.path / "dataset.json"

    def objects_lock(self) -> Path:
        """Held by whoever makes the object tables; see lock.py."""
        return self.path / "objects" / ".lock"

    def shard_lock(self, shard: str) -> Path:
        """Held by whoever makes tables of the shard."""
        return self.path / "shards" / shard / ".lock"

    def read_objects(self) -> dict[str, pa.Table]:
        """The five object tables by name."""
        return {name: read_table(ALL_SCHEMAS[name], self.object_table(name)) for name in OBJECT_TABLES}

    def read_shard(self, shard: str, schemas: Sequence[TableSchema]) -> Mapping[str, pa.Table]:
        """Some tables of a shard by name."""
        return {schema.name: read_table(schema, self.shard_table(shard, schema.name)) for schema in schemas}
