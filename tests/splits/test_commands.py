"""A command shown of a release makes the objects of that release: whoever follows it gets the benchmark's only from the benchmark."""

from __future__ import annotations

import shlex

import pytest

from objects.catalogue import catalogue_hash, load_catalogue
from pipelines.recipe import load_recipe
from splits.commands import ANY_ID, make_command, regenerate_command, what_to_put_in
from splits.provenance import own_provenance
from tables.vocabulary import Allocation

PACKAGED = {"recipe_hash": load_recipe("mini").hash_of(), "catalogue_hash": catalogue_hash(load_catalogue()), "git_commit": "a" * 40}
OTHER = "0" * 64
OWN = {**PACKAGED, **own_provenance("mine.toml", "recipe.toml", Allocation.APPENDED)}


def flags(provenance: dict[str, str]) -> dict[str, str]:
    words = shlex.split(regenerate_command("mini-0000-t0-g00", provenance, "mini", "--gif out.gif"))
    assert words[:4] == ["python", "-m", "pipelines.regenerate", "mini-0000-t0-g00"]
    return dict(zip(words[4::2], words[5::2], strict=True))


def test_of_the_benchmark_it_names_the_release_alone() -> None:
    assert flags(PACKAGED) == {"--release": "data/release/mini", "--gif": "out.gif"}
    assert flags({**PACKAGED, "recipe_hash": OTHER}) == {"--release": "data/release/mini", "--gif": "out.gif"}
    assert what_to_put_in(PACKAGED, "mini") == ""
    assert make_command(["plans", "films"], PACKAGED, "mini") == "make plans films TIER=mini"


@pytest.mark.parametrize(
    ("changes", "folder", "named"),
    [
        ({"catalogue_hash": OTHER}, "data/own/mine", {"--catalogue": "mine.toml"}),
        ({"recipe_hash": OTHER, "recipe": "slow.toml", "catalogue": "catalogue.toml"}, "data/own/slow", {"--recipe": "slow.toml"}),
        # A recipe of one's own may have the name of the benchmark's.
        ({"catalogue_hash": OTHER, "recipe_hash": OTHER}, "data/own/mine", {"--catalogue": "mine.toml", "--recipe": "recipe.toml"}),
    ],
)
def test_of_one_s_own_it_names_what_is_own_and_where_it_lies(changes: dict[str, str], folder: str, named: dict[str, str]) -> None:
    provenance = OWN | changes
    assert flags(provenance) == {"--release": f"{folder}/release/mini", "--data": folder, **named, "--gif": "out.gif"}
    assert all(path in what_to_put_in(provenance, "mini") for path in (*named.values(), folder))
    made = make_command(["films"], provenance, "mini")
    assert made.split()[3:] == [f"{flag.strip('-').upper()}={path}" for flag, path in named.items()]


def test_the_first_id_of_a_command_is_that_of_the_candidate() -> None:
    """Pages put an id in its place, wherever else these two letters stand."""
    provenance = OWN | {"catalogue_hash": OTHER, "catalogue": "GRID.toml"}
    command = regenerate_command(ANY_ID, provenance, "mini", "--gif out.gif").replace(ANY_ID, "mini-0000-t0-g00", 1)
    assert command == regenerate_command("mini-0000-t0-g00", provenance, "mini", "--gif out.gif")
