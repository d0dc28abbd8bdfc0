"""Builds the object tables on all cores and publishes them; how an object is built is objects.build's."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from typing import Any

from objects.build import ObjectParams, ObjectTables, build_object
from objects.catalogue import ObjectSpec, catalogue_hash, load_catalogue
from pipelines.recipe import Recipe
from pipelines.running.data_root import OBJECT_TABLES, DataRoot
from pipelines.running.workers import run_units
from tables.schemas import ALL_SCHEMAS, SCHEMA_VERSION
from tables.store import Sidecar, file_sha256, read_sidecar, sidecar_path, table_from_rows, write_table

OBJECT_CODE_VERSION = "2"


class ObjectTablesError(RuntimeError):
    """Objects of the catalogue that could not be built; names each one and why."""


def make_object_tables(root: DataRoot, recipe: Recipe, n_workers: int, log: Callable[[str], Any] = print) -> dict[str, Sidecar]:
    """Publish `objects`, `object_meshes`, `object_parts`, `stable_poses` and `grasp_pool`, or keep them where nothing changed.

    Raises:
        ObjectTablesError: at least one object failed; nothing is published then.
    """
    specs = load_catalogue()
    made_from = {
        "catalogue": catalogue_hash(specs),
        "recipe": recipe.hash_of("objects"),
        "code": OBJECT_CODE_VERSION,
    }
    paths = {name: root.object_table(name) for name in OBJECT_TABLES}
    if all(path.exists() and sidecar_path(path).exists() for path in paths.values()):
        sidecars = {name: read_sidecar(path) for name, path in paths.items()}
        if all(_is_current(sidecars[name], made_from) and file_sha256(paths[name]) == sidecars[name].sha256 for name in paths):
            log("objects: up to date")
            return sidecars
    built: dict[int, ObjectTables] = {}
    failures = []
    with closing(run_units(_build, [(spec, recipe.objects, recipe.seed) for spec in specs], n_workers)) as outcomes:
        for outcome in outcomes:
            if outcome.error is None:
                built[outcome.index] = outcome.value
                log(f"objects: {specs[outcome.index].object_id} in {outcome.core_ms / 1e3:.1f} s ({len(built)} of {len(specs)})")
            else:
                failures.append(f"{specs[outcome.index].object_id}: {outcome.error}")
    if failures:
        raise ObjectTablesError(f"{len(failures)} of {len(specs)} objects failed, must be 0:\n" + "\n".join(sorted(failures)))
    return {
        name: write_table(
            ALL_SCHEMAS[name],
            table_from_rows(ALL_SCHEMAS[name], [row for k in range(len(specs)) for row in getattr(built[k], name)]),
            paths[name],
            made_from,
        )
        for name in OBJECT_TABLES
    }


def _build(spec: ObjectSpec, params: ObjectParams, seed: int) -> ObjectTables:
    return build_object(spec, params, seed)


def _is_current(sidecar: Sidecar, made_from: dict[str, str]) -> bool:
    return sidecar.made_from == made_from and sidecar.schema_version == SCHEMA_VERSION
