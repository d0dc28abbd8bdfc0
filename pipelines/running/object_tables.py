"""Publishes the object tables: builds the objects that changed, on all cores, and joins them with those that did not.

See objects/build.py for how an object is built and object_store.py for where a built one is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import pyarrow as pa

from objects.build import build_object
from objects.catalogue import ObjectSpec, load_catalogue
from objects.errors import ObjectError
from objects.provenance import catalogue_sources, object_sources
from pipelines.recipe import Recipe
from pipelines.running.data_root import DataRoot
from pipelines.running.lock import locked
from pipelines.running.object_store import ObjectStore, intact_sidecars
from pipelines.running.workers import run_units
from tables.columns import SchemaError
from tables.schemas import ALL_SCHEMAS, OBJECT_TABLES
from tables.store import Sidecar, join_tables, write_table


class ObjectTablesError(ObjectError):
    """Objects of the catalogue that could not be built; names each one and why."""


def make_object_tables(
    root: DataRoot, recipe: Recipe, catalogue: Path, n_workers: int, log: Callable[[str], Any] = print
) -> dict[str, Sidecar]:
    """Publish `objects`, `object_meshes`, `object_parts`, `stable_poses` and `grasp_pool`, or keep them where nothing changed.

    An object is built only where its own sources changed (see objects/provenance.py) or what is kept of it is damaged. The tables are the
    same bits as if all objects had been built at once.

    Args:
        catalogue: file of the objects.
        n_workers: worker processes; 0 stays in this process. The result does not depend on it.
        log: is told of every object that was built.

    Returns:
        Sidecar of each table by name.

    Raises:
        CatalogueError: the catalogue is not what it should be.
        ObjectTablesError: at least one object failed. Nothing is published then; the others are kept, and the next run builds only the
            failed ones.
        LockError: somebody else builds them; names the owner.
    """
    specs = load_catalogue(catalogue)
    published = _published(root, recipe, specs, log)
    if published is not None:
        log("objects: up to date")
        return published
    sources = catalogue_sources(specs, recipe.objects, recipe.seed)
    with locked(root.objects_lock(), "object tables"):
        built = _all_objects(specs, recipe, ObjectStore(root, log), n_workers, log)
        sidecars = {}
        for name in OBJECT_TABLES:
            table = join_tables(ALL_SCHEMAS[name], [built[spec.object_id][name] for spec in specs])
            sidecars[name] = write_table(ALL_SCHEMAS[name], table, root.object_table(name), sources)
        return sidecars


def are_objects_current(root: DataRoot, recipe: Recipe, catalogue: Path) -> bool:
    """Whether `make_object_tables` would keep every table as it is.

    Raises:
        CatalogueError: the catalogue is not what it should be.
    """
    return _published(root, recipe, load_catalogue(catalogue), lambda _: None) is not None


def _published(root: DataRoot, recipe: Recipe, specs: Sequence[ObjectSpec], log: Callable[[str], Any]) -> dict[str, Sidecar] | None:
    """Sidecars of the published tables where they are whole and of today's catalogue and parameters."""
    paths = {name: root.object_table(name) for name in OBJECT_TABLES}
    return intact_sidecars(paths, catalogue_sources(specs, recipe.objects, recipe.seed), "published tables", log)


def _all_objects(
    specs: Sequence[ObjectSpec], recipe: Recipe, store: ObjectStore, n_workers: int, log: Callable[[str], Any]
) -> dict[str, dict[str, pa.Table]]:
    """The five tables of each object by id: from the store where its sources are the same, built and stored where not."""
    sources = {spec.object_id: object_sources(spec, recipe.objects, recipe.seed) for spec in specs}
    kept = {spec.object_id: store.read(spec.object_id, sources[spec.object_id]) for spec in specs}
    done = {object_id: tables for object_id, tables in kept.items() if tables is not None}
    missing = [spec for spec in specs if spec.object_id not in done]
    if done:
        log(f"objects: {len(done)} of {len(specs)} unchanged")
    if not missing:  # no workers to start
        return done
    failures = []
    with closing(run_units(build_object, [(spec, recipe.objects, recipe.seed) for spec in missing], n_workers)) as outcomes:
        for n_done, outcome in enumerate(outcomes, 1):
            object_id, error = missing[outcome.index].object_id, outcome.error
            if error is None:
                try:
                    done[object_id] = store.write(object_id, outcome.value, sources[object_id])
                except SchemaError as failure:
                    error = f"SchemaError: {failure}"
            if error is None:
                log(f"objects: {object_id} in {outcome.core_ms / 1e3:.1f} s ({n_done} of {len(missing)})")
                for note in outcome.value.notes:
                    log(f"objects: {object_id}: its mesh: {note}")
            else:
                failures.append(f"{object_id}: {error}")
    if failures:
        reasons = "\n".join(sorted(failures))
        raise ObjectTablesError(f"{len(failures)} of {len(specs)} objects failed, must be 0; the others are kept:\n{reasons}")
    return done
