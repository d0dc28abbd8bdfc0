"""`make curve` on a synthetic release: nested sizes are trained once, and rows of other trainings stay."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from assets_def import rankers
from assets_def.learning_curve import curve_of, curve_table, made_from, make_learning_curve
from assets_def.partitions import RankerKey
from assets_def.ranker_training import RankersError
from assets_def.rankers import Place, make_rankers
from model import networks
from model.settings import Variant
from tables.identity import parse_candidate_id
from tables.schemas import LEARNING_CURVE
from tables.sidecar import Sidecar, find_published
from tables.store import read_table
from tests.assets_def.test_rankers import TIER, released
from tests.model.conftest import TINY_LOCAL

LOCAL, POSES = (RankerKey(TIER, variant, 42) for variant in (Variant.LOCAL, Variant.POSE_ONLY))


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Place:
    monkeypatch.setitem(networks._LOCAL, "light", replace(TINY_LOCAL, name="light", n_epochs=2))
    monkeypatch.setattr(rankers, "SHIPPED", tmp_path / "shipped")
    return released(tmp_path / "data", seed=1)


def test_sizes_are_trained_once_and_other_trainings_stay(place: Place) -> None:
    lines: list[str] = []
    make_learning_curve(place, [LOCAL], [1, 3], 0, lines.append)
    assert [line for line in lines if line.endswith("trained")] == ["1 scenes: 0 of 1 trained", "3 scenes: 0 of 1 trained"]
    assert trainings(place) == {("local", 1): 42, ("local", 3): 42}
    make_rankers(place, [LOCAL], 0, lines.append)
    lines.clear()
    make_learning_curve(place, [LOCAL, POSES], [3], 0, lines.append)
    assert lines[0] == "3 scenes: 1 of 2 trained"
    assert trainings(place) == {("local", 1): 42, ("local", 3): 42, ("pose_only", 3): 42, ("local", 6): 42}


def test_the_table_of_the_asset_is_that_of_the_command(place: Place) -> None:
    curve = curve_of(place, [LOCAL])
    assert [ranker.n for ranker in curve] == [1, 3, 6]  # a quarter and a half of six, and all
    with pytest.raises(RankersError, match="local-42 of 6 scenes is not trained, must be: make rankers ONLY=local"):
        curve_table(curve, 0, lambda text: None)
    make_rankers(place, [LOCAL], 0, lambda text: None)
    make_learning_curve(place, [LOCAL], (), 0, lambda text: None)
    path = place.beside / "learning_curve.parquet"
    assert isinstance(find_published(LEARNING_CURVE, path, made_from(curve), TIER), Sidecar)
    assert read_table(LEARNING_CURVE, path, verify=True).equals(curve_table(curve, 0, lambda text: None))


def trainings(place: Place) -> dict[tuple[str, int], int]:
    """Seeds by variant and size; each has every candidate of the validation scenes of the synthetic release, and no other."""
    rows = read_table(LEARNING_CURVE, place.beside / "learning_curve.parquet", verify=True).to_pylist()
    found = {(row["variant"], row["n_train_scenes"]): row["seed"] for row in rows}
    for key in found:
        own = {row["candidate_id"] for row in rows if (row["variant"], row["n_train_scenes"]) == key}
        assert {parse_candidate_id(candidate_id).scene_id for candidate_id in own} == {"full-0003", "full-0008"}
        assert len(own) == len(rows) // len(found)
    return found
