"""Built objects, each in five small tables of its own below the data root; the published tables are joined from them.

Why not take the rows of unchanged objects out of the published tables: those are written last and together, so a killed build would have
kept nothing, and one damaged table would cost every object. Here a change, a kill and a damaged file each cost the objects they hit.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa

from objects.build import ObjectTables
from pipelines.running.data_root import DataRoot
from tables.schemas import ALL_SCHEMAS, OBJECT_TABLES
from tables.sidecar import is_table_of_today
from tables.store import Sidecar, StoreError, file_sha256, read_sidecar, read_table, sidecar_path, table_from_rows, write_table


class ObjectStore:
    """The last build of each object, with the sources it was made from; what leaves the catalogue stays, and is found if it returns."""

    def __init__(self, root: DataRoot, log: Callable[[str], Any]) -> None:
        self._root, self._log = root, log

    def read(self, object_id: str, sources: Mapping[str, str]) -> dict[str, pa.Table] | None:
        """The five tables of one object by name; None where they are not there, made from other sources, or (with a log line) damaged."""
        paths = self._paths(object_id)
        if intact_sidecars(paths, sources, object_id, self._log) is None:
            return None
        return {name: read_table(ALL_SCHEMAS[name], path) for name, path in paths.items()}

    def write(self, object_id: str, built: ObjectTables, sources: Mapping[str, str]) -> dict[str, pa.Table]:
        """Keep a built object in place of its last build, and return its tables.

        Raises:
            SchemaError: a row that is not what its table allows; the last build is kept then.
        """
        tables = {name: table_from_rows(ALL_SCHEMAS[name], getattr(built, name)) for name in OBJECT_TABLES}
        paths = self._paths(object_id)
        # Whatever is there was made from other sources or is damaged; a kill in between leaves some of the five, never old beside new.
        shutil.rmtree(paths[OBJECT_TABLES[0]].parent, ignore_errors=True)
        for name, table in tables.items():
            write_table(ALL_SCHEMAS[name], table, paths[name], sources)
        return tables

    def _paths(self, object_id: str) -> dict[str, Path]:
        return {name: self._root.built_object(object_id, name) for name in OBJECT_TABLES}


def intact_sidecars(
    paths: Mapping[str, Path], sources: Mapping[str, str], what: str, log: Callable[[str], Any]
) -> dict[str, Sidecar] | None:
    """Sidecars of tables that belong together, or None where the tables are of no use.

    Args:
        paths: path of each table by name.
        sources: what the tables must have been made from.
        what: the name of the tables in the log.
        log: is told, in one line, where some of the tables are missing, cut off or changed.
    """
    if not any(path.exists() or sidecar_path(path).exists() for path in paths.values()):
        return None
    sidecars = {}
    try:
        for name, path in paths.items():
            sidecar = read_sidecar(path)
            if sidecar.made_from != sources or not is_table_of_today(ALL_SCHEMAS[name], sidecar.schema_version):
                return None
            if sidecar.table != name or file_sha256(path) != sidecar.sha256:
                raise StoreError(f"{path}: is not the table {name} that its sidecar tells of")
            sidecars[name] = sidecar
    except (StoreError, OSError, ValueError, TypeError) as error:  # a sidecar that was cut off is no JSON, or not the fields of one
        log(f"objects: {what} damaged or half written, made again: {error}")
        return None
    return sidecars
