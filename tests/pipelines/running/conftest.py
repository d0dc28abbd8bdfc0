"""Workers of one and two processes, and stored object tables, for the tests of running."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from objects.build import ObjectParams
from objects.catalogue import ObjectSpec
from pipelines.running import object_tables
from pipelines.running.data_root import DataRoot
from pipelines.running.object_tables import make_object_tables
from pipelines.running.workers import Workers
from tests.objects.test_catalogue import write
from tests.pipelines.running.object_builds import RECIPE, THREE


@pytest.fixture
def two() -> Iterator[Workers]:
    with Workers(2) as workers:
        yield workers


@pytest.fixture
def one() -> Iterator[Workers]:
    with Workers(1) as workers:
        yield workers


@pytest.fixture
def built(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Ids of the objects that were built, in order: the real build, noted."""
    ids: list[str] = []
    real = object_tables.build_object

    def noted(spec: ObjectSpec, params: ObjectParams, seed: int):
        ids.append(spec.object_id)
        return real(spec, params, seed)

    monkeypatch.setattr(object_tables, "build_object", noted)
    return ids


@pytest.fixture(scope="session")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Tables of the three objects, to be copied."""
    folder = tmp_path_factory.mktemp("stored")
    make_object_tables(DataRoot(folder / "data"), RECIPE, write(folder, *THREE), 0, lambda _: None)
    return folder / "data"


@pytest.fixture
def root(stored: Path, tmp_path: Path) -> DataRoot:
    shutil.copytree(stored, tmp_path / "data")
    return DataRoot(tmp_path / "data")
