"""A few rows of every stage, rounded, beside the code version that made them; rewritten by `python -m tests.pipelines.proofs.golden_rows`.

A stage whose rows change must raise its code version: tables made before would otherwise count as up to date.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pipelines.running.data_root import DataRoot
from pipelines.stages import STAGES

GOLDEN = Path(__file__).resolve().parents[2] / "golden" / "stage_rows.json"
N_ROWS = 4  # of each scene and table

Golden = dict[str, dict[str, Any]]


def golden_rows(root: DataRoot, shard: str) -> Golden:
    """By stage: its code version, and by table the first rows of each scene; numbers to six digits, lists as length, first and last."""
    return {
        stage.name: {
            "code_version": stage.code_version,
            "rows": {name: _first_rows(table.to_pylist()) for name, table in root.read_shard(shard, stage.outputs).items()},
        }
        for stage in STAGES
    }


def stale_versions(golden: Mapping[str, Mapping[str, Any]], fresh: Golden) -> list[str]:
    """What must be done about stages whose rows or versions moved, one sentence a stage."""
    errors = []
    for name, now in fresh.items():
        before = golden.get(name)
        if before is None or before["code_version"] != now["code_version"]:
            errors.append(f"{name}: code version {now['code_version']} has no golden rows; rewrite them (see golden_rows.py)")
        elif before["rows"] != now["rows"]:
            tables = [table for table, rows in now["rows"].items() if before["rows"].get(table) != rows]
            errors.append(f"{name}: rows of {tables} changed, code version is still {now['code_version']}; raise it, then rewrite the rows")
    return errors


def _first_rows(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    kept: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        scene = kept.setdefault(row.get("scene_id") or row["candidate_id"].split("-t")[0], [])
        if len(scene) < N_ROWS:
            scene.append({name: _rounded(value) for name, value in row.items()})
    return [row for some in kept.values() for row in some]


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        # Nothing below a nanometre or a nanoradian: rounding of one processor is not another's.
        return float(f"{round(value, 9):.6g}")
    if isinstance(value, list):
        return [len(value), *map(_rounded, (value[0], value[-1]))] if value else [0]
    return value


def main() -> None:
    """Build the small chain of test_reproducible and write its rows."""
    from tests.pipelines.proofs.test_reproducible import SHARD, run_chain, small_inputs

    with tempfile.TemporaryDirectory() as folder:
        recipe_path = Path(folder) / "recipe.toml"
        root = DataRoot(Path(folder) / "data")
        run_chain(root, small_inputs(recipe_path), 2)
        GOLDEN.write_text(json.dumps(golden_rows(root, SHARD), indent=0, sort_keys=True) + "\n")


if __name__ == "__main__":
    main()
