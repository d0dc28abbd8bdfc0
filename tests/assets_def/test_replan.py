"""Candidates of a real release planned once more: timed, of one split, and only if every label comes out as it is stored."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from reports.planner_costs import planner_costs
from splits.errors import ReleaseError
from splits.release import make_light
from splits.release_reader import Release
from splits.replan import candidates_of, planned_again
from tables.schemas import CANDIDATES
from tables.store import table_from_rows
from tables.vocabulary import Split
from tests.assets_def.conftest import Built
from tests.assets_def.small import TIER, small_benchmark
from tests.splits.damage import republished


@pytest.fixture
def whole(built: Built) -> Path:
    return small_benchmark(built.folder).root.release(TIER)


@pytest.fixture
def recipe(built: Built) -> Path:
    return Path(small_benchmark(built.folder).recipe_path)


def a_split(release: Release) -> Split:
    """One that holds candidates: the small release has few scenes."""
    return next(split for split in (Split.TEST, Split.VALIDATION, Split.TRAIN) if candidates_of(release, split).num_rows)


def test_every_candidate_of_the_split_is_timed_and_no_other(whole: Path, recipe: Path, tmp_path: Path) -> None:
    make_light(whole, tmp_path / "light")
    release = Release.open(tmp_path / "light")
    split = a_split(release)
    timings = planned_again(release, split, 0, recipe, lambda _: None)
    costs = planner_costs(timings, candidates_of(release, split))
    assert costs["candidate_id"].to_pylist() == timings["item_id"].to_pylist() != []
    assert min(costs["core_ms"].to_pylist()) > 0.0
    assert not [path for path in tmp_path.iterdir() if path.name != "light"], "the work folder is gone"


def test_a_label_that_comes_out_otherwise_is_named(whole: Path, recipe: Path, tmp_path: Path) -> None:
    split = a_split(Release.open(whole))

    directory = tmp_path / "flipped"
    shutil.copytree(whole, directory)
    rows = Release.open(whole).table("candidates").to_pylist()
    own = set(candidates_of(Release.open(whole), split)["candidate_id"].to_pylist())
    row = next(row for row in rows if row["candidate_id"] in own and row["plan_status"] != "solved")
    true = row["plan_status"]
    row["plan_status"] = "start_in_collision"
    republished(directory, "candidates", table_from_rows(CANDIDATES, rows))
    of = rf"row \d+ \({row['candidate_id']}\) has plan_status '{true}', the release holds 'start_in_collision'"
    with pytest.raises(ReleaseError, match=f"^planning_labels made again: {of}"):
        planned_again(Release.open(directory), split, 0, recipe, lambda _: None)
