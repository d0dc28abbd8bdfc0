"""Makes scenes of a release again, each in a fresh process and from its id alone, and compares every row with what the release holds.

python -m splits.regenerate DIR [--scenes N] [--workers N] [--recipe FILE] [--catalogue FILE] [--out FILE]

Scenes are chosen by a hash of their ids. Compared is every table that has rows of a scene or of its object; `splits` and what was made
from the whole release later are no scene's own. Read from the release is nothing but what is compared.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from objects.catalogue import PACKAGED_CATALOGUE, catalogue_hash, load_catalogue
from pipelines.codecs import Row
from pipelines.proofs.regenerate import rows_of_scene
from pipelines.recipe import DEFAULT_RECIPE
from pipelines.running.dataset_record import is_packaged
from pipelines.running.join import join_candidates, join_grasps
from pipelines.running.workers import run_units
from pipelines.stages import STAGES
from splits.errors import ReleaseError
from splits.origin import recipe_of
from splits.provenance import git_commit
from splits.rebuild import other_engines
from splits.release_reader import Release, report_folder
from tables.columns import TableSchema
from tables.errors import INTERRUPTED, PlaceBenchError
from tables.files import write_text_atomically
from tables.identity import order_key
from tables.schemas import ALL_SCHEMAS, ATTEMPTS, CANDIDATES, GRASPS, OBJECT_TABLES, SPLITS, TIMINGS
from tables.store import content_hash, table_from_columns, table_from_rows

N_SCENES = 12
# Of the tables of a release those that no scene has rows of its own in.
_OF_THE_WHOLE = (SPLITS.name, ATTEMPTS.name, TIMINGS.name)


@dataclass(frozen=True, slots=True)
class Regenerated:
    """One scene made again: rows compared by table, rows that differ by table, and the first difference of each such table in words.

    `problem` is why the scene could not be made, "" where it could.
    """

    scene_id: str
    rows: Mapping[str, int]
    differing: Mapping[str, int]
    details: tuple[str, ...] = ()
    problem: str = ""

    @property
    def n_candidates(self) -> int:
        return self.rows.get(CANDIDATES.name, 0)

    @property
    def is_identical(self) -> bool:
        return not self.problem and not self.differing

    def __str__(self) -> str:
        if self.problem:
            return f"{self.scene_id}: NOT MADE, {self.problem}"
        n = sum(self.differing.values())
        verdict = f"{n:,} DIFFERENT: {'; '.join(self.details)}" if n else "0 differences"
        return f"{self.scene_id}: {self.n_candidates:,} candidates, {sum(self.rows.values()):,} rows, {verdict}"


def regenerate_scenes(
    release: Release, n_scenes: int, n_workers: int, recipe_path: Path = DEFAULT_RECIPE, catalogue: Path = PACKAGED_CATALOGUE
) -> Iterator[Regenerated]:
    """Scenes as they finish: those whose ids hash lowest, or all where the release has no more.

    Args:
        n_workers: worker processes, at least 1; each is replaced after one scene.
        recipe_path: the recipe that the release was made with.
        catalogue: the catalogue that it was made from.

    Raises:
        ReleaseError: a release of another recipe or catalogue, or of other code; a number below 1.
        CatalogueError: the catalogue is not what it should be.
    """
    if n_scenes < 1:
        raise ReleaseError(f"scenes to make again: {n_scenes}, must be at least 1")
    recipe = recipe_of(release.manifest, recipe_path, STAGES)
    _check_catalogue(release, catalogue)
    scene_ids = sorted(release.table("scenes")["scene_id"].to_pylist(), key=lambda name: order_key(recipe.seed, "regenerate", name))
    chosen = sorted(scene_ids[:n_scenes])
    units = [(scene_id, recipe_path, catalogue) for scene_id in chosen]
    with closing(run_units(rows_of_scene, units, max(1, n_workers), units_per_life=1)) as outcomes:
        for outcome in outcomes:
            scene_id = chosen[outcome.index]
            if outcome.error is not None:
                yield Regenerated(scene_id, {}, {}, problem=outcome.error.strip().splitlines()[0])
            else:
                yield compared(release, scene_id, outcome.value)


def compared_tables(release: Release) -> list[str]:
    """Names of the tables that scenes are compared in: those of the release that it does not leave out and that have a scene's own rows."""
    return [name for name in sorted(release.manifest.tables) if name not in (*_OF_THE_WHOLE, *release.left_out)]


def compared(release: Release, scene_id: str, rows: Mapping[str, Sequence[Row]]) -> Regenerated:
    """One scene of a release against rows that were made again.

    Args:
        rows: by table, as the stages make them; `grasps` and `candidates` are joined here, as in a release.
    """
    fresh = {name: table_from_rows(ALL_SCHEMAS[name], some) for name, some in rows.items()}
    fresh[GRASPS.name] = join_grasps(*(fresh[name] for name in ("grasp_admission", "pick_lift", "scenes", "grasp_pool")))
    fresh[CANDIDATES.name] = join_candidates(*(fresh[name] for name in ("candidate_pairs", "planning_labels", "execution_labels")))
    object_id = fresh["scenes"]["object_id"][0].as_py()
    n_rows, differing, details = {}, {}, []
    for name in compared_tables(release):
        schema = ALL_SCHEMAS[name]
        stored = _own_rows(schema, release.table(name), scene_id, object_id)
        n_rows[name] = stored.num_rows
        if content_hash(stored) != content_hash(fresh[name]):
            differing[name], detail = _differences(schema, fresh[name], stored)
            details.append(f"{name} {detail}")
    return Regenerated(scene_id, n_rows, differing, tuple(details))


def _own_rows(schema: TableSchema, table: pa.Table, scene_id: str, object_id: str) -> pa.Table:
    """Rows of a scene, or of its object, as a table of their own."""
    if schema.name in OBJECT_TABLES:
        is_own = pc.equal(table["object_id"].cast(pa.string()), object_id)
    elif "scene_id" in schema.names:
        is_own = pc.equal(table["scene_id"].cast(pa.string()), scene_id)
    else:
        is_own = pc.starts_with(table["candidate_id"], f"{scene_id}-")
    own = table.filter(is_own)
    return table_from_columns(schema, {name: own[name] for name in schema.names})


def _differences(schema: TableSchema, fresh: pa.Table, stored: pa.Table) -> tuple[int, str]:
    """How many rows differ, at least one, and the first of them in words."""
    found, held = ({tuple(row[key] for key in schema.key): row for row in table.to_pylist()} for table in (fresh, stored))
    keys = sorted(key for key in found.keys() | held.keys() if found.get(key) != held.get(key))
    if not keys:
        return 1, "has equal values in other bits (0.0 and -0.0)"
    name = "-".join(map(str, keys[0]))
    if keys[0] not in found or keys[0] not in held:
        return len(keys), f"{name} is {'not made again' if keys[0] in held else 'not in the release'}"
    made, there = found[keys[0]], held[keys[0]]
    column = next(column for column in schema.names if made[column] != there[column])
    return len(keys), f"{name} has {column} {made[column]!r}, the release holds {there[column]!r}"


def _check_catalogue(release: Release, catalogue: Path) -> None:
    provenance, own = release.manifest.provenance, catalogue_hash(load_catalogue(catalogue))
    stated, named = provenance["catalogue_hash"], provenance.get("catalogue")
    if stated == own:
        return
    if named is None and is_packaged(catalogue):
        raise ReleaseError(f"catalogue_hash of the release is {stated[:12]}, of this code {own[:12]}; use the code that made it")
    found = f"{stated[:12]} ({named or 'the benchmark'})"
    raise ReleaseError(f"catalogue_hash of the release is {found}, of {catalogue} {own[:12]}; name the one that made it (--catalogue)")


def summary_of(release: Release, scenes: Sequence[Regenerated]) -> dict[str, Any]:
    """What is written: how much was compared and how much of it differs, of which release, by which code; scenes by id."""
    rows: Counter[str] = Counter()
    for scene in scenes:
        rows.update(scene.rows)
    compared_in = compared_tables(release)
    return {
        "tier": release.manifest.tier,
        "version": release.manifest.version,
        "release_hash": release.manifest.release_hash,
        "code_commit": git_commit(),
        "scenes": len(scenes),
        "candidates": sum(scene.n_candidates for scene in scenes),
        "rows": rows.total(),
        "differences": sum(sum(scene.differing.values()) for scene in scenes),
        "scenes_not_made": sum(bool(scene.problem) for scene in scenes),
        "rows_by_table": {name: rows[name] for name in compared_in},
        "tables_not_compared": sorted(release.manifest.tables.keys() - set(compared_in)),
        "by_scene": {scene.scene_id: str(scene).partition(": ")[2] for scene in sorted(scenes, key=lambda scene: scene.scene_id)},
    }


def regenerated(
    directory: Path,
    out: Path | None = None,
    n_scenes: int = N_SCENES,
    n_workers: int = 2,
    recipe_path: Path = DEFAULT_RECIPE,
    catalogue: Path = PACKAGED_CATALOGUE,
    log: Callable[[str], Any] = print,
) -> bool:
    """Make scenes of a release again, tell of each, and write the summary; whether nothing differs.

    Args:
        directory: of the release, whole or light; every file must be what its manifest says.
        out: of the summary; `regenerated.json` among the reports of the tier where None.

    Raises:
        ReleaseError: a damaged release, or as `regenerate_scenes`.
    """
    release = Release.open(directory, verify=True)
    scenes = []
    for scene in regenerate_scenes(release, n_scenes, n_workers, recipe_path, catalogue):
        scenes.append(scene)
        log(f"{scene} ({len(scenes)} of {min(n_scenes, release.manifest.tables['scenes'].rows)})")
    summary = summary_of(release, scenes)
    out = out or report_folder(release) / "regenerated.json"
    write_text_atomically(out, json.dumps(summary, indent=2) + "\n")
    is_identical = all(scene.is_identical for scene in scenes)
    engines = "" if is_identical else other_engines(release.manifest, {name for stage in STAGES for name in stage.engines})
    not_made = f", {summary['scenes_not_made']} NOT MADE" if summary["scenes_not_made"] else ""
    log(
        f"{summary['scenes']} scenes{not_made}, {summary['candidates']:,} candidates, {summary['rows']:,} rows of"
        f" {len(summary['rows_by_table'])} tables: {summary['differences']:,} differences{engines}; not compared:"
        f" {', '.join(summary['tables_not_compared'])}; {out}"
    )
    return is_identical


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line: 0 where nothing differs, 1 where a row does, a scene cannot be made or the release is refused, 130 if interrupted."""
    parser = argparse.ArgumentParser(prog="python -m splits.regenerate", description=__doc__)
    parser.add_argument("directory", type=Path, help="a release, whole or light")
    parser.add_argument("--scenes", type=int, default=N_SCENES, help=f"how many, chosen by hash ({N_SCENES})")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes at a time; the result does not depend on it")
    parser.add_argument("--recipe", type=Path, default=DEFAULT_RECIPE)
    parser.add_argument("--catalogue", type=Path, default=PACKAGED_CATALOGUE, help="that the release was made from (the benchmark's)")
    parser.add_argument("--out", type=Path, help="file of the summary (regenerated.json among the reports of the tier)")
    chosen = parser.parse_args(arguments)
    try:
        return 0 if regenerated(chosen.directory, chosen.out, chosen.scenes, chosen.workers, chosen.recipe, chosen.catalogue) else 1
    except PlaceBenchError as error:
        print(f"not regenerated: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted; nothing was written", file=sys.stderr)
        return INTERRUPTED


if __name__ == "__main__":
    raise SystemExit(main())
