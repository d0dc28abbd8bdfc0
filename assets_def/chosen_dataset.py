"""The dataset that a command names: the benchmark, or one of another catalogue or recipe.

One of one's own has a data folder and a Dagster instance of its own. The partitions of the graph are the shards of one catalogue, made when
the graph is loaded, which is before any argument is read: so a choice is handed on in the environment of the process that loads it.
"""

from __future__ import annotations

import argparse
import os
import shutil
from pathlib import Path

from assets_def.resources import CATALOGUE_VARIABLE, DATA_VARIABLE, RECIPE_VARIABLE, REPOSITORY, Benchmark
from pipelines.running.dataset_record import check_dataset


def add_choice(parser: argparse.ArgumentParser) -> None:
    """The arguments that name a dataset."""
    parser.add_argument("--catalogue", type=Path, help="file of the objects (the benchmark's)")
    parser.add_argument("--recipe", type=Path, help="file of the recipe (the benchmark's)")
    parser.add_argument("--data", type=Path, help="data folder (data; with a catalogue or a recipe of one's own data/own/NAME)")


def environment_of(chosen: argparse.Namespace) -> dict[str, str]:
    """The variables under which the graph is that of the chosen dataset; empty where the environment says the same already.

    A dataset of one's own has its folder for Dagster from here on.

    Raises:
        CatalogueError: the catalogue is not what it should be.
        RecipeError: nor the recipe.
        DatasetError: the data folder holds another dataset.
    """
    given = {CATALOGUE_VARIABLE: chosen.catalogue, RECIPE_VARIABLE: chosen.recipe, DATA_VARIABLE: chosen.data}
    named = {name: str(path.resolve()) for name, path in given.items() if path is not None}
    if all(os.environ.get(name) == path for name, path in named.items()):
        return {}
    own = Benchmark()
    benchmark = Benchmark(
        catalogue_path=named.get(CATALOGUE_VARIABLE, own.catalogue_path),
        recipe_path=named.get(RECIPE_VARIABLE, own.recipe_path),
        data_dir=named.get(DATA_VARIABLE, own.data_dir),
    )
    check_dataset(benchmark.root, benchmark.catalogue)
    benchmark.recipe("full")
    home = benchmark.root.path / ".dagster_home"
    home.mkdir(parents=True, exist_ok=True)
    shutil.copy(REPOSITORY / ".dagster_home" / "dagster.yaml", home)
    return {**named, "DAGSTER_HOME": str(home)}
