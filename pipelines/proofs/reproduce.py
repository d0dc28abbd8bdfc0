"""Proves that rows depend on identity alone: one worker, two workers in shuffled order, and single scenes and candidates made alone.

`python -m pipelines.reproduce --scenes 10`
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from rich.console import Console
from rich.table import Table

from objects.catalogue import PACKAGED_CATALOGUE
from pipelines.proofs.regenerate import regenerate
from pipelines.recipe import load_recipe
from pipelines.running.data_root import DataRoot
from pipelines.running.object_tables import make_object_tables
from pipelines.running.shard_runner import load_shard_inputs, run_stage
from pipelines.stages import STAGES
from tables.identity import family_of_shard, order_key
from tables.schemas import CANDIDATE_PAIRS, OBJECT_TABLES
from tables.store import read_sidecar, read_table


def reproduce(shard: str, n_scenes: int, n_alone: int, folder: Path, console: Console) -> bool:
    """Build some scenes several ways and compare every table; True where nothing differs."""
    roots = {name: DataRoot(folder / name) for name in ("one worker", "two workers, shuffled")}
    recipe = load_recipe(family_of_shard(shard))
    for n_workers, root in zip((1, 2), roots.values(), strict=True):
        make_object_tables(root, recipe, PACKAGED_CATALOGUE, n_workers, lambda _: None)
    first, second = roots.values()
    whole = load_shard_inputs(first, shard, recipe, PACKAGED_CATALOGUE)
    inputs = replace(whole, allocations=whole.allocations[:n_scenes])
    shuffled = replace(inputs, allocations=sorted(inputs.allocations, key=lambda a: order_key(recipe.seed, "reproduce", a.scene_id)))
    table = Table("table", "rows", *roots, "same")
    is_same = True
    for name in OBJECT_TABLES:
        is_same &= _compare(table, name, [root.object_table(name) for root in roots.values()])
    for stage in STAGES:
        run_stage(stage, shard, first, inputs, 1)
        run_stage(stage, shard, second, shuffled, 2)
        for schema in stage.outputs:
            is_same &= _compare(table, schema.name, [root.shard_table(shard, schema.name) for root in roots.values()])
    console.print(table)

    alone = [allocation.scene_id for allocation in inputs.allocations[:n_alone]]
    candidates = read_table(CANDIDATE_PAIRS, first.shard_table(shard, "candidate_pairs"))["candidate_id"].to_pylist()
    alone += sorted(candidates, key=lambda candidate_id: order_key(recipe.seed, "reproduce", candidate_id))[: 2 * n_alone]
    for name in alone:
        differing = [c.table for c in regenerate(name, first) if c.is_identical is not True]
        console.print(f"{name} alone: {'identical in every table' if not differing else f'DIFFERENT in {differing}'}")
        is_same &= not differing
    verdict = "0 differences" if is_same else "DIFFERENCES, see above"
    console.print(f"{len(candidates)} candidates of {len(inputs.allocations)} scenes: {verdict}")
    return is_same


def _compare(table: Table, name: str, paths: Sequence[Path]) -> bool:
    sidecars = [read_sidecar(path) for path in paths]
    is_same = len({sidecar.content_hash for sidecar in sidecars}) == 1
    table.add_row(name, str(sidecars[0].rows), *(s.content_hash[:16] for s in sidecars), "yes" if is_same else "NO")
    return is_same


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line: 0 where nothing differs, 1 otherwise."""
    parser = argparse.ArgumentParser(prog="python -m pipelines.reproduce", description=__doc__)
    parser.add_argument("--shard", default="full-000")
    parser.add_argument("--scenes", type=int, default=11, help="scenes of the shard; 11 are about 2,000 candidates")
    parser.add_argument("--alone", type=int, default=2, help="scenes, and twice as many candidates, made alone")
    chosen = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="placebench-reproduce-") as folder:
        return 0 if reproduce(chosen.shard, chosen.scenes, chosen.alone, Path(folder), Console()) else 1


if __name__ == "__main__":
    sys.exit(main())
