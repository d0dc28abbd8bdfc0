"""The knob table: what it says of the recipe is what the recipe has, and a row is made of a shard's tables."""

from __future__ import annotations

import re

import pytest

from assets_def import knobs
from pipelines.recipe import RecipeError, load_recipe
from tables.schemas import ALL_SCHEMAS
from tables.store import read_table
from tests.assets_def.conftest import Built
from tests.assets_def.small import SHARD, small_benchmark

RECIPE = load_recipe("full")
SHOWN = re.compile(r"^([0-9.]+)(?: → ([0-9.]+))")


@pytest.mark.parametrize("knob", knobs.KNOBS, ids=lambda knob: knob.name)
def test_a_variant_is_a_recipe_and_changes_what_it_says(knob: knobs.Knob) -> None:
    other = knobs.changed(RECIPE, knob.values)
    assert (other == RECIPE) == (not knob.values)
    shown = SHOWN.match(knob.change)
    if shown and knob.name != "tolerance":
        before, after = map(float, shown.groups())
        for key, value in knob.values.items():
            assert knobs.at(RECIPE, key) == before
            assert value == after


def test_a_key_that_the_recipe_lacks_and_a_value_that_it_forbids_are_errors() -> None:
    with pytest.raises(AttributeError, match="no_such_knob"):
        knobs.changed(RECIPE, {"scene_sampling.no_such_knob": 1})
    with pytest.raises(RecipeError, match=r"scene_sampling.target_gap_m = 0.015, must be at least execution.position_tolerance_m = 0.02"):
        knobs.changed(RECIPE, {"execution.position_tolerance_m": 0.02})


def test_a_row_has_the_shares_that_the_tables_have(built: Built) -> None:
    root = small_benchmark(built.folder).root
    cells = knobs.row(knobs.KNOBS[0], root, 42, (SHARD,))
    planned = read_table(ALL_SCHEMAS["planning_labels"], root.shard_table(SHARD, "planning_labels"))["y_plan"].to_pylist()
    executed = read_table(ALL_SCHEMAS["execution_labels"], root.shard_table(SHARD, "execution_labels"))["y_pipe"].to_pylist()
    failures = executed.count(False) / len(executed)
    assert cells[:4] == ["–", "the recipe", f"{100 * sum(planned) / len(planned):.0f} %", f"{100 * failures:.0f} %"]
    assert len(cells) == len(knobs.HEADER)
