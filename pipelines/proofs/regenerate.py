"""Rebuilds one scene or one candidate from its id alone and compares every row with what is stored in the shards of a data folder.

Scenes of a release are compared by splits.regenerate.

`python -m pipelines.regenerate full-0042` or `python -m pipelines.regenerate full-0042-t3-g17`; a candidate also as a film, see shown.py:
`python -m pipelines.regenerate full-0042-t3-g17 --mcap out.mcap --filmstrip out.png --gif out.gif`

Where the shards hold nothing of a candidate, as in a fresh clone, it is compared with the release of its name in the data folder.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path

from objects.build import build_object, build_object_models, object_models_of
from objects.catalogue import PACKAGED_CATALOGUE, catalogue_order, load_catalogue
from objects.errors import ObjectError
from objects.object_model import ObjectModel
from pipelines.codecs import Row, known_in, rows_by_scene
from pipelines.proofs.shown import ShownError, add_film_flags, check_shown, show
from pipelines.recipe import DEFAULT_RECIPE, Recipe, RecipeError, load_recipe
from pipelines.running.data_root import DataRoot
from pipelines.running.dataset_record import DatasetError, check_dataset
from pipelines.scenes.allocation import scene_allocation
from pipelines.stages import STAGES
from pipelines.values import SceneAllocation
from tables.identity import CandidateId, IdentityError, parse_candidate_id, parse_scene_id
from tables.schemas import ALL_SCHEMAS, OBJECT_TABLES
from tables.store import StoreError, content_hash, table_from_rows


@dataclass(frozen=True, slots=True)
class Comparison:
    """One table of a scene or candidate, made again; `stored_hash` is None where nothing is stored."""

    table: str
    rows: int
    fresh_hash: str
    stored_hash: str | None

    @property
    def is_identical(self) -> bool | None:
        return None if self.stored_hash is None else self.fresh_hash == self.stored_hash


def regenerate(
    name: str,
    root: DataRoot,
    recipe_path: Path = DEFAULT_RECIPE,
    object_models: dict[str, ObjectModel] | None = None,
    catalogue: Path = PACKAGED_CATALOGUE,
) -> list[Comparison]:
    """Make all rows of a scene, or those of one candidate, from identity alone: catalogue and recipe in, nothing stored read.

    Args:
        name: a scene id or a candidate id.
        root: where to look for stored rows to compare with.
        object_models: objects built from the catalogue before; built here if None.
        catalogue: file of the objects.

    Raises:
        CatalogueError: the catalogue is not what it should be.
        DatasetError: `root` holds a dataset of another catalogue.
        IdentityError: neither a scene nor a candidate of such a dataset, or a candidate whose grasp did not lift.
    """
    check_dataset(root, catalogue)
    return compared(make_again(name, recipe_path, object_models, catalogue), root)


@dataclass(frozen=True, slots=True)
class MadeAgain:
    """Rows by table of a scene or of one candidate, in key order, and what made them; `candidate` is None for a scene."""

    recipe: Recipe
    object_model: ObjectModel
    scene_id: str
    shard: str
    candidate: CandidateId | None
    rows: dict[str, list[Row]]


def make_again(
    name: str,
    recipe_path: Path = DEFAULT_RECIPE,
    object_models: dict[str, ObjectModel] | None = None,
    catalogue: Path = PACKAGED_CATALOGUE,
) -> MadeAgain:
    """The rows alone, compared with nothing; arguments and errors are those of `regenerate`."""
    candidate = parse_candidate_id(name) if "-t" in name else None
    scene_id = candidate.scene_id if candidate else name
    recipe, order = load_recipe(parse_scene_id(scene_id)[0], recipe_path), catalogue_order(catalogue)
    allocation = scene_allocation(scene_id, order)
    if object_models is None:
        object_models = build_object_models(
            [spec for spec in load_catalogue(catalogue) if spec.object_id == allocation.object_id], recipe.objects, recipe.seed
        )
    rows = _make_rows(recipe, object_models[allocation.object_id], allocation, candidate)
    if candidate and not any(row["candidate_id"] == name for row in rows["planning_labels"]):
        n_targets = len(rows["targets"])
        if candidate.target_id >= n_targets:
            raise IdentityError(f"{name}: target {candidate.target_id}, must be in [0, {n_targets}), the targets of {scene_id}")
        raise IdentityError(f"{name}: grasp {candidate.grasp_id} is not among the lifted grasps of {scene_id}")
    return MadeAgain(recipe, object_models[allocation.object_id], scene_id, order.layout.shard_of_scene(scene_id), candidate, rows)


def compared(made: MadeAgain, root: DataRoot) -> list[Comparison]:
    """Every table that was made again beside what a data folder has of it."""
    return [_comparison(table, root, made) for table in made.rows]


def rows_of_scene(scene_id: str, recipe_path: Path, catalogue: Path) -> dict[str, list[Row]]:
    """All rows of a scene by table, and those of its object in the object tables, from catalogue and recipe alone.

    Raises:
        IdentityError: no such scene.
    """
    recipe = load_recipe(parse_scene_id(scene_id)[0], recipe_path)
    allocation = scene_allocation(scene_id, catalogue_order(catalogue))
    (spec,) = (spec for spec in load_catalogue(catalogue) if spec.object_id == allocation.object_id)
    built = build_object(spec, recipe.objects, recipe.seed)
    rows = _make_rows(recipe, object_models_of([built])[spec.object_id], allocation, None)
    return {name: getattr(built, name) for name in OBJECT_TABLES} | rows


def _make_rows(
    recipe: Recipe, object_model: ObjectModel, allocation: SceneAllocation, candidate: CandidateId | None
) -> dict[str, list[Row]]:
    """The chain of stages in this process; for a candidate only its own grasp is lifted, planned and executed."""
    rows: dict[str, list[Row]] = {}
    for stage in STAGES:
        known = known_in({schema.name: rows[schema.name] for schema in stage.inputs})
        units = stage.units(object_model, allocation, known, recipe.sections(*stage.sections), recipe.seed)
        for schema in stage.outputs:
            rows[schema.name] = []
        for unit in units:
            if candidate is None or unit.grasp_id in (None, candidate.grasp_id):
                for table, more in stage.run(unit).rows.items():
                    rows[table] += more
        for schema in stage.outputs:
            # In key order, as a reader of the table sees them.
            rows[schema.name] = sorted(rows[schema.name], key=itemgetter(*schema.key))
    return rows


def _comparison(table: str, root: DataRoot, made: MadeAgain) -> Comparison:
    schema = ALL_SCHEMAS[table]
    try:
        stored = rows_by_scene(root.read_shard(made.shard, [schema]), [made.scene_id])[made.scene_id][table]
        stored_hash = content_hash(table_from_rows(schema, _own(stored, made.candidate)))
    except StoreError:
        stored_hash = None
    own = _own(made.rows[table], made.candidate)
    return Comparison(table, len(own), content_hash(table_from_rows(schema, own)), stored_hash)


def _own(rows: list[Row], candidate: CandidateId | None) -> list[Row]:
    if candidate is None:
        return rows
    return [row for row in rows if _is_of(row, candidate)]


def _is_of(row: Row, candidate: CandidateId) -> bool:
    if "candidate_id" in row:
        return parse_candidate_id(row["candidate_id"]) == candidate
    return bool(row.get("grasp_id", candidate.grasp_id) == candidate.grasp_id)


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line: 0 where every stored table agrees, 1 where one differs or the id or the recipe is wrong, 2 where nothing is stored."""
    parser = argparse.ArgumentParser(prog="python -m pipelines.regenerate", description=__doc__)
    parser.add_argument("name", help="a scene id or a candidate id")
    parser.add_argument("--data", type=Path, default=Path("data"), help="folder to compare with")
    parser.add_argument("--recipe", type=Path, default=DEFAULT_RECIPE)
    parser.add_argument("--catalogue", type=Path, default=PACKAGED_CATALOGUE, help="that the dataset is of (the benchmark's)")
    add_film_flags(parser)
    chosen = parser.parse_args(arguments)
    try:
        root = DataRoot(chosen.data)
        check_dataset(root, chosen.catalogue)
        check_shown(chosen)
        made = make_again(chosen.name, chosen.recipe, catalogue=chosen.catalogue)
        comparisons = compared(made, root)
        words = {True: "identical", False: "DIFFERENT", None: "not stored"}
        for c in comparisons:
            print(f"{c.table:18s} {c.rows:6d} rows  {c.fresh_hash[:16]}  {words[c.is_identical]}")
        found = {c.is_identical for c in comparisons}
        released = root.release(parse_scene_id(made.scene_id)[0])
        if found == {None} and made.candidate is not None and chosen.release is None and (released / "manifest.json").exists():
            chosen.release = released
        if False not in found and show(chosen, made.recipe, made.object_model, made.rows):
            found.add(True)
    except (DatasetError, IdentityError, ObjectError, RecipeError, ShownError) as error:
        print(error, file=sys.stderr)
        return 1
    return 1 if False in found else 2 if found == {None} else 0


if __name__ == "__main__":
    sys.exit(main())
