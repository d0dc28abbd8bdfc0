"""Which catalogue a data folder is of, so that datasets of two catalogues never mix; that of the benchmark has no record.

A record holds the ids of the objects in their order: scenes are allocated by it, so the catalogue may only grow behind them.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from objects.catalogue import PACKAGED_CATALOGUE, catalogue_order
from pipelines.running.data_root import DataRoot
from tables.errors import PlaceBenchError
from tables.files import write_text_atomically
from tables.vocabulary import Allocation

_PARTS = ("objects", "shards", "tiers", "release")


class DatasetError(PlaceBenchError, ValueError):
    """A data folder that holds a dataset of another catalogue; names both."""


@dataclass(frozen=True, slots=True)
class DatasetRecord:
    """What `dataset.json` says: file name of the catalogue, allocation, ids of the objects in file order."""

    catalogue: str
    allocation: str
    objects: tuple[str, ...]


def is_packaged(catalogue: Path) -> bool:
    """Whether a catalogue file is the benchmark's."""
    return catalogue.resolve() == PACKAGED_CATALOGUE.resolve()


def check_dataset(root: DataRoot, catalogue: Path) -> None:
    """Raise DatasetError where a data folder holds a dataset of another catalogue than the one given.

    An appended catalogue may have more objects than were recorded, behind those, and other values in its entries: what they change is
    made again. Raises CatalogueError where the catalogue is not what it should be.
    """
    found, own = _read(root), _record_of(catalogue)
    if is_packaged(catalogue):
        if found is not None:
            raise DatasetError(f"{root.path}: holds a dataset of catalogue {found.catalogue}, not of the benchmark's; name that catalogue")
        return
    if found is None:
        if any((root.path / part).exists() for part in _PARTS):
            raise DatasetError(f"{root.path}: holds a dataset of the benchmark's catalogue; one of {catalogue.name} needs another folder")
        return
    may_grow = own.allocation == Allocation.APPENDED
    kept = own.objects[: len(found.objects)] if may_grow else own.objects
    if (found.allocation, found.objects) != (own.allocation, kept):
        holds = f"holds a dataset of catalogue {found.catalogue} ({found.allocation}: {', '.join(found.objects)})"
        remedy = "append new objects behind those" if may_grow else "keep its objects"
        given = f"{catalogue.name} is {own.allocation}: {', '.join(own.objects)}"
        raise DatasetError(f"{root.path}: {holds}, {given}; {remedy}, or use another folder")


def claim_dataset(root: DataRoot, catalogue: Path) -> None:
    """Record the catalogue of a data folder, where it is not the benchmark's; raises as `check_dataset`."""
    check_dataset(root, catalogue)
    record = _record_of(catalogue)
    if not is_packaged(catalogue) and _read(root) != record:
        write_text_atomically(root.dataset_record(), json.dumps(asdict(record), indent=1) + "\n")


def _record_of(catalogue: Path) -> DatasetRecord:
    order = catalogue_order(catalogue)
    return DatasetRecord(catalogue.name, order.allocation.value, tuple(object_id for object_id, _ in order.objects))


def _read(root: DataRoot) -> DatasetRecord | None:
    path = root.dataset_record()
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        return DatasetRecord(str(content["catalogue"]), str(content["allocation"]), tuple(map(str, content["objects"])))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DatasetError(f"{path}: cannot be read: {type(error).__name__}: {error}") from error
