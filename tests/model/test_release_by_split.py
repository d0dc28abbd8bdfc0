"""A release whose candidates lie in one file a split gives the ranker the same inputs and labels, and its damage is named."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from model.errors import InputError
from model.inputs import InputReader, read_inputs
from model.labels import read_labels
from model.release_tables import published_sha256, read_table_columns
from tables.store import sidecar_path

SPLITS = ("train", "validation", "test")


@pytest.fixture
def divided(release: Path) -> Path:
    """A copy of `small_release`, its candidates in the folders of a release, and a manifest of its files."""
    path = release / "candidates.parquet"
    rows = pq.read_table(path)
    split_of = {row["scene_id"]: row["split"] for row in pq.read_table(release / "splits.parquet").to_pylist()}
    own = pa.array([split_of[scene_id] for scene_id in rows["scene_id"].to_pylist()])
    for split in SPLITS:
        part = release / "candidates" / f"split={split}" / "part-0.parquet"
        part.parent.mkdir(parents=True)
        pq.write_table(rows.filter(pc.equal(own, split)), part)
    path.unlink()
    sidecar_path(path).unlink()
    names = [file.relative_to(release).as_posix() for file in release.rglob("*.parquet")]
    files = {name: {"sha256": hashlib.sha256((release / name).read_bytes()).hexdigest()} for name in names}
    (release / "manifest.json").write_text(json.dumps({"files": files}))
    return release


def test_inputs_and_labels_are_the_same(small_release: Path, divided: Path) -> None:
    whole, parts = read_inputs(InputReader(small_release)), read_inputs(InputReader(divided))
    assert parts.candidate_ids == whole.candidate_ids
    assert parts.T_grasp_object.tobytes() == whole.T_grasp_object.tobytes()
    a, b = (read_labels(folder, whole.candidate_ids) for folder in (small_release, divided))
    assert (a.y_plan.tolist(), a.y_pipe.tolist()) == (b.y_plan.tolist(), b.y_pipe.tolist())


def test_every_part_is_held_against_the_manifest(divided: Path) -> None:
    before = published_sha256(divided, ["candidates", "targets"])
    assert before == published_sha256(divided, ["candidates", "targets"])
    part = divided / "candidates" / "split=test" / "part-0.parquet"
    rows = pq.read_table(part, partitioning=None)
    pq.write_table(rows.slice(1), part)
    with pytest.raises(InputError, match=r"split=test/part-0\.parquet: SHA-256 \w+, manifest\.json says \w+; the table was changed"):
        published_sha256(divided, ["candidates"])
    part.unlink()
    with pytest.raises(InputError, match=r"split=test/part-0\.parquet: missing, must be a file of table candidates"):
        published_sha256(divided, ["candidates"])
    (divided / "manifest.json").unlink()
    assert published_sha256(divided, ["candidates"]) != before


def test_an_impossible_value_in_a_part_is_named(divided: Path) -> None:
    part = divided / "candidates" / "split=train" / "part-0.parquet"
    rows = pq.read_table(part, partitioning=None)
    pq.write_table(pa.concat_tables([rows, rows.slice(0, 1)]), part)
    with pytest.raises(InputError, match=r"candidates\.parquet: .* has 2 rows or more, must have 1"):
        read_table_columns(divided, "candidates", ["candidate_id", "scene_id"])
    part.write_bytes(b"PAR1")
    with pytest.raises(InputError, match=r"split=train/part-0\.parquet: cannot be read as a table"):
        read_table_columns(divided, "candidates", ["candidate_id"])
