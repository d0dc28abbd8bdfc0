"""One synthetic release, as tables, for the tests of splits."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pytest

from tables.store import read_table
from tests.model.synthetic_release import RELEASE_SCHEMAS, write_synthetic_release


@pytest.fixture(scope="session")
def release_tables(tmp_path_factory: pytest.TempPathFactory) -> dict[str, pa.Table]:
    """Twelve scenes of `full` with about 800 candidates; do not change in place."""
    directory = write_synthetic_release(tmp_path_factory.mktemp("synthetic"), n_scenes=12, seed=1, n_points=40)
    return {schema.name: read_table(schema, Path(directory) / f"{schema.name}.parquet") for schema in RELEASE_SCHEMAS}
