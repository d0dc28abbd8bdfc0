"""croissant.json is valid Croissant 1.1 with RAI, says what the schemas and the manifest say, and its records are the tables' rows."""

from __future__ import annotations

import json
import math
from collections import Counter
from itertools import islice
from pathlib import Path
from typing import Any

import mlcroissant as mlc
import pyarrow as pa
import pytest

from splits.citation import load_citation
from splits.croissant import CONFORMS_TO
from splits.data_card import limits
from splits.manifest import CROISSANT, read_manifest
from splits.release import make_light, write_release
from tables.schemas import ALL_SCHEMAS
from tests.model.synthetic_release import TOLERANCES
from tests.splits.damage import PROVENANCE


@pytest.fixture(scope="module")
def current(release_tables: dict[str, pa.Table], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A release of the version that CITATION.cff describes, without its heavy tables."""
    folder = tmp_path_factory.mktemp("croissant")
    write_release(release_tables, folder / "whole", "pilot", load_citation().version, PROVENANCE, TOLERANCES)
    make_light(folder / "whole", folder / "light")
    return folder / "light"


@pytest.fixture(scope="module")
def content(current: Path) -> dict[str, Any]:
    loaded = json.loads((current / CROISSANT).read_text(encoding="utf-8"))
    assert isinstance(loaded, dict)
    return loaded


def test_it_is_valid_without_errors_or_warnings(current: Path) -> None:
    metadata = mlc.Dataset(jsonld=str(current / CROISSANT)).metadata
    assert metadata.ctx.issues.report() == ""
    assert metadata.ctx.is_v1_1()
    assert metadata.conforms_to == list(CONFORMS_TO)
    assert metadata.version == load_citation().version
    assert metadata.data_limitations == limits(PROVENANCE)
    assert all((metadata.data_collection, metadata.data_biases, metadata.data_use_cases, metadata.date_published, metadata.license))


def test_the_validator_would_find_a_fault(content: dict[str, Any], tmp_path: Path) -> None:
    del content["distribution"][0]["encodingFormat"]
    (tmp_path / CROISSANT).write_text(json.dumps(content))
    with pytest.raises(mlc.ValidationError, match="encodingFormat"):
        mlc.Dataset(jsonld=str(tmp_path / CROISSANT))


@pytest.mark.parametrize("name", ["targets", "grasps", "splits", "objects"])
def test_records_are_the_rows(current: Path, release_tables: dict[str, pa.Table], name: str) -> None:
    records = list(islice(mlc.Dataset(jsonld=str(current / CROISSANT)).records(name), 5))
    for record, row in zip(records, release_tables[name].to_pylist(), strict=False):
        assert {key.removeprefix(f"{name}/"): _plain(value) for key, value in record.items()} == row


def test_candidates_come_with_their_split(current: Path, release_tables: dict[str, pa.Table]) -> None:
    split_of = {row["scene_id"]: row["split"] for row in release_tables["splits"].to_pylist()}
    expected = Counter(split_of[scene_id] for scene_id in release_tables["candidates"]["scene_id"].to_pylist())
    records = list(mlc.Dataset(jsonld=str(current / CROISSANT)).records("candidates"))
    assert Counter(record["candidates/split"].decode() for record in records) == expected
    assert all(record["candidates/split"].decode() == split_of[record["candidates/scene_id"].decode()] for record in records)


def test_every_column_has_meaning_unit_and_type(content: dict[str, Any], release_tables: dict[str, pa.Table]) -> None:
    fields = {field["@id"]: field for record_set in content["recordSet"] for field in record_set["field"]}
    for schema in map(ALL_SCHEMAS.__getitem__, release_tables):
        for column in schema.columns:
            field = fields[f"{schema.name}/{column.name}"]
            assert field["description"].startswith(column.meaning)
            assert field.get("unitText", "") == column.unit
            assert (f"Unit: {column.unit}" in field["description"]) == bool(column.unit)
            assert all(value in field["description"] for value in column.values)
            assert field["dataType"].removeprefix("cr:").removeprefix("sc:").lower() in _names_of(column.dtype)
    keys = {record_set["@id"]: record_set["key"] for record_set in content["recordSet"]}
    assert all(keys[name] == [{"@id": f"{name}/{column}"} for column in ALL_SCHEMAS[name].key] for name in release_tables)


def test_every_file_has_the_checksum_of_the_manifest(content: dict[str, Any], current: Path) -> None:
    manifest = read_manifest(current)
    stated = {part["@id"]: part for part in content["distribution"] if part["@type"] == "cr:FileObject"}
    of_tables = {file for entry in manifest.tables.values() for file in entry.files}
    assert stated.keys() == of_tables
    assert all(stated[file]["sha256"] == manifest.files[file].sha256 for file in of_tables)
    heavy = {file for file, part in stated.items() if "a light release leaves it out" in part["description"]}
    assert heavy == {file for file in of_tables if not (current / file).exists()} == {"scene_points.parquet", "timings.parquet"}


def test_responsible_ai_is_answered(content: dict[str, Any], release_tables: dict[str, pa.Table]) -> None:
    said = {key.removeprefix("rai:"): value for key, value in content.items() if key.startswith("rai:")}
    assert {"dataCollection", "dataBiases", "dataLimitations", "dataUseCases", "personalSensitiveInformation"} <= said.keys()
    assert said["dataLimitations"] == limits(PROVENANCE)
    assert len(said["dataLimitations"]) >= 5
    assert f"{release_tables['candidates'].num_rows:,} candidates" in said["dataCollection"]
    assert any(tool.startswith("mujoco-core ") for tool in said["machineAnnotationTools"])
    assert all(value for value in said.values())


def _plain(value: Any) -> Any:
    """A value as Arrow gives it: readers of Croissant give bytes for text and NaN for null."""
    if isinstance(value, bytes):
        return value.decode()
    value = value.item() if hasattr(value, "item") else value
    return None if isinstance(value, float) and math.isnan(value) else value


def _names_of(dtype: pa.DataType) -> tuple[str, ...]:
    inner = dtype.value_type if pa.types.is_list(dtype) or pa.types.is_dictionary(dtype) else dtype
    return {"string": ("text",), "bool": ("boolean",), "float": ("float32",), "double": ("float64",)}.get(str(inner), (str(inner),))
