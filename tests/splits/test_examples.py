"""The card names a candidate of every outcome that a release holds, and films are made of it too."""

from __future__ import annotations

import re
from pathlib import Path

import polars as pl

from reports.sample_films import chosen_candidates
from splits.examples import chosen_by_outcome
from splits.release_reader import Release
from tests.splits.damage import PROVENANCE

SEED = int(PROVENANCE.get("recipe_seed", "42"))


def test_the_card_names_one_of_every_outcome(release: Path) -> None:
    card = (release / "README.md").read_text(encoding="utf-8")
    section = card.split("## Look at a candidate")[1].split("\n## ")[0]
    named = {name: outcome for outcome, name in re.findall(r"^\| `(\w+)` \| `([\w-]+)` \|$", section, flags=re.MULTILINE)}
    candidates = Release.open(release).candidates.with_columns(pl.coalesce("exec_status", "plan_status").alias("outcome"))
    outcomes = dict(candidates.select("candidate_id", "outcome").iter_rows())
    assert set(named.values()) == set(outcomes.values())
    assert len(named) == len(set(named.values()))
    assert all(outcomes[name] == outcome for name, outcome in named.items())
    assert set(named) <= set(chosen_candidates(Release.open(release), SEED, 1))


def test_the_choice_depends_on_no_order_of_rows(release: Path) -> None:
    candidates = Release.open(release).candidates
    chosen = chosen_by_outcome(candidates, SEED, 2, by=["category"])
    assert chosen_by_outcome(candidates.reverse(), SEED, 2, by=["category"]) == chosen
    assert chosen_by_outcome(candidates, SEED + 1, 2, by=["category"]) != chosen
