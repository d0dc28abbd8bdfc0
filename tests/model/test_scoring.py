"""Laws of scoring: every candidate once, the same whatever it is scored beside, and no score from a changed checkpoint."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from model.batches import encode_release
from model.checkpoint import load_checkpoint
from model.errors import CheckpointError, InputError
from model.inputs import InputReader, read_inputs, restricted
from model.predictions import RELEASE_KEY, SPLIT_KEY, rounded
from model.release_tables import release_hash
from model.scoring import decision_times, main, predict, score, success_at_1
from reports.evaluate import main as evaluate
from splits.manifest import read_manifest
from splits.release import write_release
from tables.schemas import OBJECTS, PREDICTIONS
from tables.store import check_table, content_hash, read_sidecar, read_table, table_from_rows
from tests.model.damage import edit_json
from tests.model.synthetic_release import RELEASE_SCHEMAS, TOLERANCES
from tests.splits.damage import PROVENANCE


def test_every_candidate_of_every_split_is_scored_once(small_release: Path, checkpoint: Path) -> None:
    predictions = score(small_release, checkpoint)
    check_table(PREDICTIONS, predictions)
    stored = pq.read_table(small_release / "candidates.parquet")["candidate_id"].to_pylist()
    assert sorted(stored) == sorted(predictions["candidate_id"].to_pylist())
    assert set(predictions["variant"].to_pylist()) == {"full"}
    assert set(predictions["seed"].to_pylist()) == {7}
    assert all(np.all(predictions[name].to_numpy() < 0) for name in ("log_p_plan", "log_p_exec"))


def test_stored_columns_are_what_the_ranker_says_with_fifteen_bits(small_release: Path, checkpoint: Path) -> None:
    ranker, identity, _ = load_checkpoint(checkpoint)
    release = encode_release(read_inputs(InputReader(small_release)), identity.settings, identity.variant)
    own = predict(ranker, release, np.arange(len(release.group_scene)))
    stored = score(small_release, checkpoint)
    for name in ("log_p_plan", "log_p_exec"):
        values = stored[name].to_numpy()
        assert values.dtype == np.float32
        np.testing.assert_allclose(values, getattr(own, name).numpy(), rtol=2.0**-16, atol=0)


@given(arrays(np.float32, 20, elements=st.floats(-(2.0**100), 2.0**100, width=32, allow_subnormal=False)))
def test_rounding_keeps_order_sign_and_itself(values: np.ndarray) -> None:
    few = rounded(values)
    assert few.dtype == np.float32
    assert np.all(np.abs(few.astype(float) - values) <= 2.0**-16 * np.abs(values.astype(float)))
    assert not np.any(few.view(np.uint32) & 0xFF), "the last 8 bits of a single"
    assert np.all(np.diff(few[np.argsort(values)]) >= 0)
    np.testing.assert_array_equal(rounded(few), few)


def test_scoring_twice_gives_the_same_table(small_release: Path, checkpoint: Path) -> None:
    assert content_hash(score(small_release, checkpoint)) == content_hash(score(small_release, checkpoint))


def test_a_group_scored_alone_has_the_scores_it_has_among_others(small_release: Path, checkpoint: Path) -> None:
    ranker, identity, _ = load_checkpoint(checkpoint)
    inputs = read_inputs(InputReader(small_release))
    together = encode_release(inputs, identity.settings, identity.variant)
    among = predict(ranker, together, np.arange(len(inputs.group_scene))).score.numpy()
    for group in (0, 9, len(inputs.group_scene) - 1):
        alone = encode_release(restricted(inputs, np.array([group])), identity.settings, identity.variant)
        # float32 sums whose order the matrix library chooses by batch size
        np.testing.assert_allclose(predict(ranker, alone, np.array([0])).score, among[inputs.candidate_group == group], atol=1e-4)


def test_decision_times_cover_the_groups_of_the_split(small_release: Path, checkpoint: Path) -> None:
    times = decision_times(small_release, checkpoint, split="test")
    inputs = read_inputs(InputReader(small_release), ["full-0004"])
    joint, fixed = ([t for t in times if t.task == task] for task in ("joint", "fixed"))
    assert [(t.scene_id, t.n_candidates) for t in joint] == [("full-0004", len(inputs.candidate_ids))]
    assert [t.target_id for t in fixed] == inputs.group_target_id.tolist()
    assert [t.n_candidates for t in fixed] == np.bincount(inputs.candidate_group).tolist()
    assert all(t.prepare_s > 0 and t.forward_s > 0 for t in times)


@given(seed=st.integers(0, 2**32 - 1))
def test_success_at_1_equals_brute_force(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 30))
    scores, success, group = rng.integers(0, 4, n).astype(float), rng.random(n) < 0.3, rng.integers(0, 5, n)
    hits = []
    for number in range(5):
        mine = [k for k in range(n) if group[k] == number]
        if any(success[k] for k in mine):
            hits.append(success[max(mine, key=lambda k: (scores[k], -k))])
    assert success_at_1(scores, success, group) == ((float(np.mean(hits)) if hits else None), len(hits))


def test_a_changed_checkpoint_is_refused(checkpoint: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(checkpoint, tmp_path / "copy"))
    weights = bytearray((copy / "ranker.safetensors").read_bytes())
    weights[-1] ^= 1
    (copy / "ranker.safetensors").write_bytes(bytes(weights))
    with pytest.raises(CheckpointError, match=r"ranker\.safetensors: SHA-256"):
        load_checkpoint(copy)


def test_a_checkpoint_of_another_contract_is_refused(checkpoint: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(checkpoint, tmp_path / "copy"))
    described = json.loads((copy / "ranker.json").read_text())
    (copy / "ranker.json").write_text(json.dumps(described | {"contract_hash": "other"}))
    with pytest.raises(CheckpointError, match="contract_hash is other"):
        load_checkpoint(copy)


def test_command_line_writes_predictions_or_says_why_not(
    small_release: Path, checkpoint: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "predictions.parquet"
    assert main(["--release", str(small_release), "--checkpoint", str(checkpoint), "--out", str(out)]) == 0
    assert content_hash(read_table(PREDICTIONS, out, verify=True)) == content_hash(score(small_release, checkpoint))
    assert main(["--release", str(small_release), "--checkpoint", str(tmp_path), "--out", str(out)]) == 1
    assert "ranker.json: missing" in capsys.readouterr().err


def test_predictions_say_of_which_release_they_are_copied_or_not(
    small_release: Path, checkpoint: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tables = {schema.name: read_table(schema, small_release / f"{schema.name}.parquet") for schema in RELEASE_SCHEMAS}
    heavier = table_from_rows(OBJECTS, [row | {"mass_kg": 0.4} for row in tables["objects"].to_pylist()])
    release, other = tmp_path / "data" / "release" / "full", tmp_path / "other"
    for folder, own in ((release, tables), (other, tables | {"objects": heavier})):
        write_release(own, folder, "full", "0.1.0", PROVENANCE, TOLERANCES)
    of = {folder: read_manifest(folder).release_hash for folder in (release, other)}
    written, copied = tmp_path / "predictions.parquet", tmp_path / "copied.parquet"
    assert main(["--release", str(release), "--checkpoint", str(checkpoint), "--out", str(written)]) == 0
    assert read_sidecar(written).made_from == {"split_scheme": "scene", "release": of[release]}
    shutil.copyfile(written, copied)
    assert pq.read_schema(copied).metadata == {RELEASE_KEY.encode(): of[release].encode(), SPLIT_KEY.encode(): b"scene"}
    for path in (written, copied):
        capsys.readouterr()
        assert evaluate([str(path), "--release", str(release)]) == 0
        assert evaluate([str(path), "--release", str(other)]) == 1
        assert capsys.readouterr().err == f"error: {path}: about release {of[release][:12]}, must be about {of[other][:12]}\n"


def test_predictions_of_loose_tables_say_nothing_of_a_release(small_release: Path, checkpoint: Path, tmp_path: Path) -> None:
    out = tmp_path / "predictions.parquet"
    assert main(["--release", str(small_release), "--checkpoint", str(checkpoint), "--out", str(out)]) == 0
    assert read_sidecar(out).made_from == {"split_scheme": "scene"}
    assert pq.read_schema(out).metadata == {SPLIT_KEY.encode(): b"scene"}


@pytest.mark.parametrize("stated", [None, 7, "", "0" * 63, "Z" * 64])
def test_a_manifest_without_the_hash_of_its_release_is_named(release: Path, stated: object) -> None:
    assert release_hash(release) is None
    (release / "manifest.json").write_text("{}")
    edit_json(release / "manifest.json", lambda manifest: manifest.update(release_hash=stated))
    with pytest.raises(InputError, match=r"manifest\.json: release_hash is '.*', must be a SHA-256 in hexadecimal"):
        release_hash(release)
