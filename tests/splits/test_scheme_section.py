"""The card's section of the split schemes against counts by hand."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc

from splits.release import write_release
from tables.vocabulary import Split, SplitScheme
from tests.model.synthetic_release import TOLERANCES
from tests.splits.damage import PROVENANCE


def test_the_card_states_every_split_scheme(release: Path, release_tables: dict[str, pa.Table]) -> None:
    """Sizes by counting by hand; categories and obstacles as they are in each part."""
    card = (release / "README.md").read_text()
    scene_of = {row["scene_id"]: row for row in release_tables["scenes"].to_pylist()}
    rows = release_tables["candidates"].to_pylist()
    for scheme in list(SplitScheme)[1:]:
        for split in Split:
            own = {row["scene_id"] for row in release_tables["splits"].to_pylist() if row[scheme.column] == split.value}
            candidates = [row for row in rows if row["scene_id"] in own]
            (line,) = [line for line in card.splitlines() if line.startswith(f"| `{scheme.column}` | {split.value} |")]
            cells = [cell.strip() for cell in line.strip("|").split("|")][2:]
            assert cells[:3] == [
                f"{len(own)} ({100 * len(own) / 12:.1f} %)",
                str(len({scene_of[scene_id]["object_id"] for scene_id in own})),
                f"{len(candidates)} ({100 * len(candidates) / len(rows):.1f} %)",
            ]
            assert cells[3] == f"{100 * sum(row['y_plan'] for row in candidates) / len(candidates):.1f} %"
            assert cells[4] == f"{100 * sum(bool(row['y_pipe']) for row in candidates) / len(candidates):.1f} %"
            assert cells[5] == ", ".join(sorted({scene_of[scene_id]["category"] for scene_id in own}))
            assert cells[6] == ", ".join(map(str, sorted({scene_of[scene_id]["n_obstacles"] for scene_id in own})))
    assert "No part is empty in this tier." in card
    # The larger cuboid of two is the one of 0.36 litres; the other is in test.
    assert "| larger cuboid | 0.36 to 0.36 | `cuboid_01` | – | – | – |" in card
    assert "| smaller cuboid | 0.25 to 0.25 | – | – | `cuboid_02` | – |" in card


def test_the_card_says_which_parts_are_empty(release_tables: dict[str, pa.Table], tmp_path: Path) -> None:
    """Of five scenes, one is for validation by scene, and it has a can."""
    tables = {name: table if "scene_id" not in table.column_names else few(table) for name, table in release_tables.items()}
    of_few = pc.is_in(tables["policy_features"]["candidate_id"], tables["candidates"]["candidate_id"].combine_chunks())
    tables["policy_features"] = tables["policy_features"].filter(of_few)
    write_release(tables, tmp_path, "pilot", "0.1.0", PROVENANCE, TOLERANCES)
    card = (tmp_path / "README.md").read_text()
    assert "**Empty in this tier: `split_object` test, `split_category_can` validation.** A scene keeps its split" in card
    assert "| `split_category_can` | validation | 0 | 0 | 0 | – | – | – | – |" in card
    assert "| smaller cuboid | 0.25 to 0.25 | – | – | – | `cuboid_02` |" in card


def few(table: pa.Table) -> pa.Table:
    """The rows of the first five scenes."""
    return table.filter(pc.less(table["scene_id"].cast(pa.string()), "full-0005"))
