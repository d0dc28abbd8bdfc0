"""What is shipped about the published release: checkpoints that load and read only what they may, predictions that are theirs."""

from __future__ import annotations

import pytest

from assets_def.ranker_training import SHIPPED, settings_of
from assets_def.rankers import SCORED, Place, keys_of, scored_of
from assets_def.resources import Benchmark
from model.checkpoint import input_errors, load_checkpoint, weights_sha256
from model.inputs import contract_hash
from model.settings import Variant
from reports.predictions import check_scheme
from splits.release_reader import Release
from tables.identity import parse_candidate_id
from tables.schemas import PREDICTIONS
from tables.sidecar import read_sidecar
from tables.store import read_table
from tables.vocabulary import SplitScheme

TIER = "full"
# Splits whose rankers are judged in what is shipped.
BESIDE = {scheme: Place.of(Benchmark(), TIER, scheme).beside for scheme in SplitScheme}
SCHEMES = [scheme for scheme, folder in BESIDE.items() if folder.is_dir()]
FOLDERS = sorted(path for path in (SHIPPED / TIER).iterdir() if path.is_dir())


@pytest.fixture(scope="module")
def release() -> Release:
    return Release.open(Benchmark().root.release(TIER))


@pytest.fixture(scope="module")
def place() -> Place:
    return Place.of(Benchmark(), TIER, SplitScheme.SCENE)


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_a_shipped_checkpoint_is_what_the_settings_of_today_train(folder, place: Place) -> None:
    _, identity, progress = load_checkpoint(folder)
    key = next(key for key in keys_of(TIER, SplitScheme.SCENE) if folder.name == f"{key.variant.value}-{key.seed}")
    assert identity.settings == settings_of(key)
    assert progress.n_epochs_done == identity.settings.n_epochs, "it was trained to the end"
    assert input_errors(folder) == []


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("name", ["predictions", "tree_predictions"])
def test_predictions_are_about_the_published_release(name: str, scheme: SplitScheme, release: Release) -> None:
    """Of every candidate of the splits that are judged, of their scheme, by the weights that are shipped wherever they are."""
    path = BESIDE[scheme] / f"{name}.parquet"
    made_from = read_sidecar(path).made_from
    check_scheme(path, made_from, scheme)
    assert made_from["release"] == release.manifest.release_hash
    assert made_from["contract"] == contract_hash()
    splits = {row["scene_id"]: row[scheme.column] for row in release.table("splits").to_pylist()}
    in_split: dict[str, list[str]] = {}
    for candidate_id in release.table("candidates")["candidate_id"].to_pylist():
        in_split.setdefault(splits[parse_candidate_id(candidate_id).scene_id], []).append(candidate_id)
    rows = read_table(PREDICTIONS, path, verify=True).select(["variant", "seed", "candidate_id"]).to_pylist()
    by_training: dict[tuple[str, int], list[str]] = {}
    for row in rows:
        by_training.setdefault((row["variant"], row["seed"]), []).append(row["candidate_id"])
    for training, ids in by_training.items():
        of = scored_of(Variant(training[0])) if name == "predictions" else SCORED
        assert ids == sorted(candidate_id for split in of for candidate_id in in_split[split]), f"{training} scores every candidate once"
    if name == "predictions" and scheme is SplitScheme.SCENE:
        stated = {name: sha256 for name, sha256 in made_from.items() if name.startswith("ranker.")}
        assert set(stated) == {f"ranker.{variant}.{seed}" for variant, seed in by_training}
        shipped = {f"ranker.{folder.name.replace('-', '.')}": weights_sha256(folder) for folder in FOLDERS}
        assert shipped.items() <= stated.items()


def test_what_is_shipped_stays_small() -> None:
    files = [path for folder in FOLDERS for path in folder.iterdir()]
    assert sum(path.stat().st_size for path in files) < 20e6
    beside = Benchmark().root.predictions(TIER)
    assert sum(path.stat().st_size for path in beside.rglob("*.*")) < 20e6
