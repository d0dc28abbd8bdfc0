"""Real scenes through the whole chain: any number of workers, any order, one id alone, a repeat in a fresh process: the same rows."""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path

import pyarrow as pa
import pytest

from objects.build import build_object_models
from objects.catalogue import PACKAGED_CATALOGUE, catalogue_order, load_catalogue
from pipelines.codecs import known_in, rows_by_scene
from pipelines.proofs.regenerate import main, make_again, regenerate
from pipelines.proofs.repeats import Repeat, attempt_rows
from pipelines.proofs.shown import ShownError, check_released, recorded, show
from pipelines.recipe import load_recipe
from pipelines.running.data_root import DataRoot
from pipelines.running.join import join_candidates
from pipelines.running.shard_runner import ShardInputs, StageReport, run_stage
from pipelines.scenes.allocation import scene_allocation
from pipelines.stages import STAGES
from tables import schemas as s
from tables.identity import IdentityError, parse_candidate_id
from tables.schemas import OBJECT_TABLES
from tables.store import read_table, write_parquet
from tables.vocabulary import Perturbation
from tests.pipelines.proofs.golden_rows import GOLDEN, golden_rows, stale_versions

SHARD = "mini-000"
# A can, a mug and a cuboid; few grasps, so that the chain takes seconds.
SCENES = ("mini-0000", "mini-0004", "mini-0008")
RECIPE = "[grasp_admission]\nquota = 3\n[camera]\n"


def small_inputs(recipe_path: Path) -> ShardInputs:
    """The three scenes with their objects built anew; writes the recipe."""
    recipe_path.write_text(RECIPE)
    recipe = load_recipe("mini", recipe_path)
    allocations = [scene_allocation(scene_id, catalogue_order(PACKAGED_CATALOGUE)) for scene_id in SCENES]
    wanted = {allocation.object_id for allocation in allocations}
    object_models = build_object_models([spec for spec in load_catalogue() if spec.object_id in wanted], recipe.objects, recipe.seed)
    return ShardInputs(recipe, object_models, allocations, dict.fromkeys(OBJECT_TABLES, "made here"))


def run_chain(root: DataRoot, inputs: ShardInputs, n_workers: int) -> dict[str, StageReport]:
    """Every stage on the three scenes."""
    return {stage.name: run_stage(stage, SHARD, root, inputs, n_workers) for stage in STAGES}


@pytest.fixture(scope="module")
def recipe_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("recipe") / "recipe.toml"


@pytest.fixture(scope="module")
def inputs(recipe_path: Path) -> ShardInputs:
    return small_inputs(recipe_path)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory, inputs: ShardInputs) -> tuple[DataRoot, dict[str, str]]:
    root = DataRoot(tmp_path_factory.mktemp("built"))
    reports = run_chain(root, inputs, 1)
    return root, {name: sidecar.content_hash for report in reports.values() for name, sidecar in report.sidecars.items()}


def test_two_workers_in_another_order_give_the_same_tables(
    tmp_path: Path, inputs: ShardInputs, built: tuple[DataRoot, dict[str, str]]
) -> None:
    backwards = ShardInputs(inputs.recipe, inputs.object_models, inputs.allocations[::-1], inputs.object_hashes)
    reports = run_chain(DataRoot(tmp_path), backwards, 2)
    assert {name: x.content_hash for report in reports.values() for name, x in report.sidecars.items()} == built[1]


def test_a_scene_alone_and_a_candidate_alone_are_identical(
    inputs: ShardInputs, built: tuple[DataRoot, dict[str, str]], recipe_path: Path
) -> None:
    root = built[0]
    candidates = read_table(s.PLANS, root.shard_table(SHARD, "plans"))["candidate_id"].to_pylist()
    assert candidates, "at least one candidate must be planned, else nothing is shown"
    for name in (SCENES[1], candidates[0]):
        comparisons = regenerate(name, root, recipe_path, dict(inputs.object_models))
        assert [c.table for c in comparisons if not c.is_identical] == [], name


def test_a_changed_recipe_is_noticed(inputs: ShardInputs, built: tuple[DataRoot, dict[str, str]], tmp_path: Path) -> None:
    other = tmp_path / "recipe.toml"
    other.write_text(RECIPE + "[planning]\nrelease_height_m = 0.006\n")
    comparisons = {c.table: c.is_identical for c in regenerate(SCENES[0], built[0], other, dict(inputs.object_models))}
    assert comparisons["pick_lift"] is True
    assert comparisons["execution_labels"] is False


def test_a_repeat_in_a_fresh_process_is_identical_and_a_perturbed_one_says_so(
    inputs: ShardInputs, built: tuple[DataRoot, dict[str, str]]
) -> None:
    root = built[0]
    tables = root.read_shard(
        SHARD, [s.SCENES, s.OBSTACLES, s.TARGETS, s.PICK_LIFT, s.CANDIDATE_PAIRS, s.PLANNING_LABELS, s.EXECUTION_LABELS]
    )
    executed = {row["candidate_id"]: row for row in tables["execution_labels"].to_pylist()}
    planned = {row["candidate_id"]: row for row in tables["planning_labels"].to_pylist()}
    name = sorted(executed)[0]
    c = parse_candidate_id(name)
    known = known_in(rows_by_scene(tables, [c.scene_id])[c.scene_id])
    (candidate,) = (candidate for candidate in known.candidates if candidate.candidate_id == name)
    stored = planned[name] | executed[name]
    kinds = (Perturbation.FRESH, Perturbation.FINE_STEP)
    object_model = inputs.object_models[candidate.scene.object_id]
    repeats = [Repeat(inputs.recipe, object_model, candidate, stored, kind, 0) for kind in kinds]
    rows = {row["perturbation"]: row for row in attempt_rows(repeats, 1)}
    assert rows[Perturbation.FRESH.value]["is_identical"]
    assert not rows[Perturbation.FINE_STEP.value]["is_identical"]


def test_rows_that_changed_have_a_new_code_version(built: tuple[DataRoot, dict[str, str]]) -> None:
    assert stale_versions(json.loads(GOLDEN.read_text()), golden_rows(built[0], SHARD)) == []


def test_a_changed_row_and_a_version_without_rows_are_noticed(built: tuple[DataRoot, dict[str, str]]) -> None:
    fresh = golden_rows(built[0], SHARD)
    golden = json.loads(json.dumps(fresh))
    assert stale_versions(golden, fresh) == []
    golden["execution_labels"]["rows"]["execution_labels"][0]["exec_status"] = "collided"
    golden["pick_lift"]["code_version"] = "0"
    rows, version = sorted(stale_versions(golden, fresh))
    assert rows.startswith("execution_labels: rows of ['execution_labels'] changed, code version is still")
    assert version.startswith("pick_lift: code version")


def test_ids_that_do_not_exist_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(IdentityError, match="is not a scene id"):
        regenerate("pilot-0001", DataRoot(Path("nowhere")))
    assert main(["full-9999"]) == 1
    assert "must be in [0, 1235)" in capsys.readouterr().err
    assert main(["full-0000", "--gif", "a.gif"]) == 1
    assert capsys.readouterr().err.startswith("full-0000: a scene, must be a candidate like full-0000-t3-g17")


def test_a_target_and_a_grasp_that_there_are_not_are_told_apart(inputs: ShardInputs, recipe_path: Path) -> None:
    models = dict(inputs.object_models)
    with pytest.raises(IdentityError, match=rf"{SCENES[0]}-t9-g00: target 9, must be in \[0, 8\), the targets of {SCENES[0]}"):
        make_again(f"{SCENES[0]}-t9-g00", recipe_path, models)
    with pytest.raises(IdentityError, match="grasp 63 is not among the lifted grasps"):
        make_again(f"{SCENES[0]}-t0-g63", recipe_path, models)


def test_without_shards_a_candidate_is_compared_with_the_release_of_the_data_folder(
    tmp_path: Path, inputs: ShardInputs, built: tuple[DataRoot, dict[str, str]], recipe_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shard = built[0].read_shard(SHARD, [s.CANDIDATE_PAIRS, s.PLANNING_LABELS, s.EXECUTION_LABELS])
    candidates = join_candidates(shard["candidate_pairs"], shard["planning_labels"], shard["execution_labels"])
    name = candidates["candidate_id"].to_pylist()[0]
    arguments = [name, "--data", str(tmp_path), "--recipe", str(recipe_path)]
    assert main(arguments) == 2, "nothing is there to compare with"
    _write_release(tmp_path / "release" / "mini", candidates, inputs.recipe.hash_of())
    assert main(arguments) == 0
    assert f"every label of {name}, every bit" in capsys.readouterr().out


def test_a_label_is_shown_as_it_was_made_or_not_at_all(
    tmp_path: Path, inputs: ShardInputs, built: tuple[DataRoot, dict[str, str]], recipe_path: Path
) -> None:
    shard = built[0].read_shard(SHARD, [s.CANDIDATE_PAIRS, s.PLANNING_LABELS, s.EXECUTION_LABELS, s.PLANS])
    planned = shard["plans"]["candidate_id"].to_pylist()[0]
    rejected = next(row["candidate_id"] for row in shard["planning_labels"].to_pylist() if not row["y_plan"])
    candidates = join_candidates(shard["candidate_pairs"], shard["planning_labels"], shard["execution_labels"])
    _write_release(tmp_path / "release", candidates, inputs.recipe.hash_of())
    for name, n_moments in ((planned, 20), (rejected, 1)):
        made = make_again(name, recipe_path, dict(inputs.object_models))
        outputs = {"mcap": tmp_path / f"{name}.mcap", "filmstrip": None, "gif": None}
        chosen = argparse.Namespace(name=name, release=tmp_path / "release", **outputs)
        assert show(chosen, made.recipe, made.object_model, made.rows)
        assert (tmp_path / f"{name}.mcap").stat().st_size > 10_000
        assert len(recorded(name, made.recipe, made.object_model, made.rows).moments) >= n_moments
    made = make_again(planned, recipe_path, dict(inputs.object_models))
    label = next(row for row in made.rows["execution_labels"] if row["candidate_id"] == planned)
    label["final_x_m"] = math.nextafter(label["final_x_m"], 9.0)
    with pytest.raises(ShownError, match="final_x_m"):
        recorded(planned, made.recipe, made.object_model, made.rows)
    chosen.mcap, chosen.name = tmp_path / "other.mcap", planned
    with pytest.raises(ShownError, match=r"1 of .* columns differ"):
        show(chosen, made.recipe, made.object_model, made.rows)
    assert not (tmp_path / "other.mcap").exists()
    _write_release(tmp_path / "other", candidates, "0" * 64)
    with pytest.raises(ShownError, match="of recipe 000000000000"):
        check_released(tmp_path / "other", planned, made.recipe, made.rows)
    with pytest.raises(ShownError, match="no release"):
        check_released(tmp_path / "nowhere", planned, made.recipe, made.rows)


def _write_release(directory: Path, candidates: pa.Table, recipe_hash: str) -> None:
    """As much of a release as the comparison reads."""
    write_parquet(s.CANDIDATES, candidates, directory / "candidates" / "split=test" / "candidates.parquet", described=True)
    manifest = {"release_hash": "h" * 64, "version": "0.1.0", "tier": "mini", "provenance": {"recipe_hash": recipe_hash}}
    (directory / "manifest.json").write_text(json.dumps(manifest))
