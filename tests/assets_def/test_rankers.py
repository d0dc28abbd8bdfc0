"""`make rankers` on a synthetic release: what is trained, taken over, scored again and kept; the networks are real and small."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from assets_def import rankers
from assets_def.partitions import RankerKey, rankers_of_tier
from assets_def.ranker_training import RankersError
from assets_def.rankers import Place, keys_of, make_rankers
from assets_def.resources import Benchmark
from model import networks
from model.inputs import InputReader, scenes_of_split
from model.settings import LIGHT, SCHEME_OF_PREDICTIONS, Variant
from splits.release import write_release
from tables.identity import parse_candidate_id
from tables.schemas import PREDICTIONS
from tables.sidecar import read_sidecar
from tables.store import read_table
from tables.vocabulary import SplitScheme
from tests.model.conftest import TINY_LOCAL
from tests.model.synthetic_release import RELEASE_SCHEMAS, TOLERANCES, write_synthetic_release
from tests.splits.damage import PROVENANCE

TIER = "pilot"
LOCAL, POSES = (RankerKey(TIER, variant, 42) for variant in (Variant.LOCAL, Variant.POSE_ONLY))


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Place:
    """A synthetic release of `pilot` with ten scenes, the smallest networks, and nothing shipped."""
    monkeypatch.setitem(networks._LOCAL, "light", replace(TINY_LOCAL, name="light", n_epochs=2))
    monkeypatch.setitem(networks._OF_THE_PAPER, "light", replace(LIGHT, n_epochs=1))
    monkeypatch.setattr(rankers, "SHIPPED", tmp_path / "shipped")
    return released(tmp_path / "data", seed=1)


def released(data: Path, seed: int) -> Place:
    benchmark = Benchmark(data_dir=str(data))
    loose = write_synthetic_release(data.with_name("loose"), n_scenes=10, seed=seed, n_points=40)
    tables = {schema.name: read_table(schema, loose / f"{schema.name}.parquet") for schema in RELEASE_SCHEMAS}
    write_release(tables, benchmark.root.release(TIER), TIER, "0.1.0", PROVENANCE, TOLERANCES)
    return Place.of(benchmark, TIER, SplitScheme.SCENE)


def lines_of(place: Place, *keys: RankerKey) -> list[str]:
    """What a run logs; in this process, where the small settings are."""
    lines: list[str] = []
    make_rankers(place, keys, 0, lines.append)
    return lines


def rows_of(place: Place, variant: str) -> list[dict[str, object]]:
    rows = read_table(PREDICTIONS, place.beside / "predictions.parquet", verify=True).to_pylist()
    return [row for row in rows if row["variant"] == variant]


def test_predictions_are_of_validation_and_test_and_made_once(place: Place) -> None:
    lines_of(place, LOCAL)
    reader = InputReader(place.release_dir)
    expected = {scene_id for split in ("validation", "test") for scene_id in scenes_of_split(reader, split)}
    for name in ("predictions", "tree_predictions"):
        ids = read_table(PREDICTIONS, place.beside / f"{name}.parquet", verify=True)["candidate_id"].to_pylist()
        assert {parse_candidate_id(candidate_id).scene_id for candidate_id in ids} == expected
    again = lines_of(place, LOCAL)
    assert again == ["rankers: 1 of 1 there", "predictions: there already, 1 rankers", "tree_predictions: there already"]


def test_rows_of_a_ranker_that_is_not_here_any_more_stay(place: Place) -> None:
    lines_of(place, LOCAL)
    before = rows_of(place, "local")
    shutil.rmtree(place.trained / "local-42")
    lines = lines_of(place, POSES)
    assert any(line.startswith("predictions: 1 of 2 rankers scored") for line in lines)
    assert rows_of(place, "local") == before
    assert len(rows_of(place, "pose_only")) == len(before)


def test_other_weights_are_scored_again(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    lines_of(place, LOCAL)
    before = rows_of(place, "local")
    monkeypatch.setitem(networks._LOCAL, "light", replace(TINY_LOCAL, name="light", n_epochs=3))
    lines = lines_of(place, LOCAL)
    assert lines[0] == "rankers: 0 of 1 there", "of other settings, so not the one that is asked for"
    assert any(line.startswith("predictions: 1 of 1 rankers scored") for line in lines)
    assert rows_of(place, "local") != before


def test_predictions_of_another_release_are_not_kept(place: Place) -> None:
    lines_of(place, LOCAL, POSES)
    other = released(place.release_dir.parent.parent, seed=2)
    lines_of(other, LOCAL)
    assert rows_of(other, "pose_only") == []
    assert set(read_sidecar(other.beside / "predictions.parquet").made_from) >= {"release", "ranker.local.42"}


def test_a_shipped_checkpoint_is_taken_as_it_is(place: Place) -> None:
    lines_of(place, LOCAL)
    before = rows_of(place, "local")
    shutil.copytree(place.trained, rankers.SHIPPED / TIER)
    shutil.rmtree(place.trained)
    shutil.rmtree(place.beside)
    assert lines_of(place, LOCAL)[0] == "rankers: 1 of 1 there"
    assert rows_of(place, "local") == before


def test_a_failed_training_is_named_and_the_others_are_kept(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(networks._OF_THE_PAPER, "light", replace(LIGHT, n_epochs=1, learning_rate=1e30))
    paper = next(key for key in rankers_of_tier(TIER) if key.variant is Variant.FULL)
    with pytest.raises(RankersError, match=r"^1 of 2 trainings failed, must be 0: full-42: TrainingError: .* must be finite"):
        lines_of(place, paper, LOCAL)
    assert lines_of(place, LOCAL)[0] == "rankers: 1 of 1 there"


def test_under_another_split_one_seed_of_ours_into_a_folder_of_its_name(place: Place) -> None:
    keys = keys_of(TIER, SplitScheme.LAYOUT)
    assert keys == (LOCAL,)
    own = replace(place, scheme=SplitScheme.LAYOUT, trained=place.trained / "layout", beside=place.beside / "layout")
    lines_of(own, *keys)
    for name in ("predictions", "tree_predictions"):
        assert read_sidecar(own.beside / f"{name}.parquet").made_from[SCHEME_OF_PREDICTIONS] == "layout"
    assert not (place.beside / "predictions.parquet").exists()


def test_a_choice_is_a_variant_or_a_variant_and_a_seed() -> None:
    assert keys_of("full", SplitScheme.SCENE, ["local"]) == tuple(RankerKey("full", Variant.LOCAL, seed) for seed in (42, 43, 44))
    assert keys_of("full", SplitScheme.SCENE, ["direct.43"]) == (RankerKey("full", Variant.DIRECT, 43),)
    with pytest.raises(RankersError, match=r"^local\.41: no ranker of full under split scene, must be one of full\.42"):
        keys_of("full", SplitScheme.SCENE, ["local.41"])
    with pytest.raises(RankersError, match=r"^full: no ranker of full under split object"):
        keys_of("full", SplitScheme.OBJECT, ["full"])
