"""One synthetic release, as tables and as a folder, for the tests of splits."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pytest

from splits.release import write_release
from tables.store import read_table
from tests.model.synthetic_release import RELEASE_SCHEMAS, TOLERANCES, write_synthetic_release
from tests.splits.damage import PROVENANCE, copy_of


@pytest.fixture(scope="session")
def release_tables(tmp_path_factory: pytest.TempPathFactory) -> dict[str, pa.Table]:
    """Twelve scenes of `full` with about 800 candidates; do not change in place."""
    directory = write_synthetic_release(tmp_path_factory.mktemp("synthetic"), n_scenes=12, seed=1, n_points=40)
    return {schema.name: read_table(schema, Path(directory) / f"{schema.name}.parquet") for schema in RELEASE_SCHEMAS}


@pytest.fixture(scope="session")
def release(release_tables: dict[str, pa.Table], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same as a release folder; tests that change it copy it first."""
    directory = tmp_path_factory.mktemp("release")
    write_release(release_tables, directory, "pilot", "0.1.0", PROVENANCE, TOLERANCES)
    return directory


@pytest.fixture(scope="module")
def own_copy(release: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy that every example damages and mends again."""
    return copy_of(release, tmp_path_factory.mktemp("bytes"))
