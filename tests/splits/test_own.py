"""A release of somebody's own says what it is made from, has the scenes of its own catalogue, and never claims to be the benchmark."""

from __future__ import annotations

import json
from pathlib import Path

import pyarrow as pa
import pytest

from splits.citation import load_citation
from splits.errors import ReleaseError
from splits.manifest import read_manifest
from splits.provenance import OWN_KEYS, layout_of_release, own_provenance
from splits.release import verify_release, write_release
from splits.release_reader import Release, report_folder
from tables.layout import INTERLEAVED, layout_of
from tables.vocabulary import Allocation
from tests.model.synthetic_release import TOLERANCES
from tests.splits.damage import PROVENANCE

OWN = {**PROVENANCE, **own_provenance("my_objects.toml", "my_recipe.toml", Allocation.APPENDED)}
# What only the benchmark may say of itself.
CLAIMS = (
    *("30 objects", "PlaceBench pilot", "{PlaceBench", "placebench-pilot", "The PlaceBench contributors", "western supermarkets"),
    *("CC-BY-4.0", "the benchmark: every", "6 objects", "- benchmark", "printed metal"),
)


@pytest.fixture(scope="module")
def own(release_tables: dict[str, pa.Table], tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("own") / "release" / "pilot"
    write_release(release_tables, directory, "pilot", load_citation().version, OWN, TOLERANCES)
    return directory


def test_it_verifies_and_knows_its_layout(own: Path, release_tables: dict[str, pa.Table]) -> None:
    manifest = verify_release(own)
    assert manifest.layout == layout_of(Allocation.APPENDED, release_tables["objects"].num_rows)
    assert report_folder(Release.open(own)) == own.parent.parent / "reports" / "pilot"


def test_no_text_claims_to_be_the_benchmark(own: Path, release: Path) -> None:
    texts = {name: (own / name).read_text() for name in ("README.md", "DATASHEET.md", "croissant.json")}
    for name, text in texts.items():
        assert [claim for claim in CLAIMS if claim in text] == [], name
    benchmark = "".join((release / name).read_text() for name in texts)
    assert [claim for claim in CLAIMS if claim not in benchmark] == [], "a claim that nothing makes proves nothing"
    assert json.loads(texts["croissant.json"])["name"] == "own-dataset-pilot"
    assert "datePublished" not in json.loads(texts["croissant.json"])


def test_card_and_manifest_name_catalogue_and_recipe(own: Path) -> None:
    card, provenance = (own / "README.md").read_text(), read_manifest(own).provenance
    assert "# Dataset of my_objects.toml, pilot\n" in card
    assert "**This is not the PlaceBench benchmark.**" in card
    assert "pipelines.regenerate ID --release DIR --data DATA --catalogue CATALOGUE [--recipe RECIPE] --mcap" in card
    for key in (*OWN_KEYS, "catalogue_hash", "recipe_hash"):
        assert f"| `{key}` | `{provenance[key]}` |" in card


def test_a_release_of_the_benchmark_has_no_such_words(release: Path) -> None:
    assert read_manifest(release).layout == INTERLEAVED
    assert "not the PlaceBench benchmark" not in (release / "README.md").read_text()


@pytest.mark.parametrize(
    ("changes", "n_objects", "message"),
    [
        ({"catalogue": ""}, 3, "catalogue is missing, must be there beside catalogue, recipe, allocation"),
        ({"allocation": "random"}, 3, "allocation 'random', must be one of"),
        ({}, 0, "0 objects, must be 1 to"),
    ],
)
def test_a_provenance_of_one_s_own_is_whole_or_refused(changes: dict[str, str], n_objects: int, message: str) -> None:
    with pytest.raises(ReleaseError, match=message):
        layout_of_release(OWN | changes, n_objects)


def test_scenes_that_the_catalogue_does_not_have_are_refused(release_tables: dict[str, pa.Table], tmp_path: Path) -> None:
    """The synthetic scenes are the first twelve of `full`, none of `mini`."""
    with pytest.raises(ReleaseError, match="full-0000 is not in tier mini"):
        write_release(release_tables, tmp_path, "mini", "1.0.0", OWN, TOLERANCES)
