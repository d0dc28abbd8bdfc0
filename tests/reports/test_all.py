"""`make reports` on a small release: what it can make it makes, what it cannot it names with the file that is missing."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pytest

from model.settings import SCHEME_OF_PREDICTIONS
from reports import ablation, success_at_k
from reports.all import main
from reports.costs import Costs
from reports.kinds import KINDS
from reports.learning_curve import learning_curve_table
from reports.planner_costs import planner_costs
from reports.ranking import timing_frame
from reports.report import ReportError
from reports.sources import BESIDE, Sources
from reports.success_at_k import success_at_k_report
from splits.manifest import read_manifest
from splits.release import make_light, write_release
from splits.release_reader import Release
from tables import schemas
from tables.store import join_tables, table_from_columns, table_from_rows, write_table
from tables.vocabulary import SplitScheme
from tests.model.synthetic_release import TOLERANCES
from tests.reports.replicates import replicates_of
from tests.splits.damage import PROVENANCE

# The synthetic release has no meshes to draw.
MADE = tuple(name for name in KINDS if name != "gallery")
READ_SCORES = ("success_at_k", "planner_calls", "seed_robustness", "solvability", "calibration", "errors", "ablation", "trees_probe")
OF_LEARNED = ("seed_robustness", "solvability", "calibration", "errors")


def about(release_tables: dict[str, pa.Table], predictions: pa.Table) -> dict[str, pa.Table]:
    """The tables about the release by the names of their files."""
    rows = predictions.to_pylist()
    trees = [
        row | {"variant": {"full": "trees", "direct": "trees_poses"}[row["variant"]]}
        for row in rows
        if row["variant"] in ("full", "direct")
    ]
    first = release_tables["candidates"].to_pylist()[:40]
    labels = ("candidate_id", "plan_status", "exec_status", "final_position_error_m", "final_rotation_error_rad")
    same = {"perturbation": "fresh_process", "repeat": 0, "plan_matches": True, "exec_matches": True, "is_identical": True}
    audited = {"depth_m": None, "deepest_pair": None, "clearance_m": None, "n_configurations": 1, "agrees": True, "audit": "rejection"}
    statuses = [(row["candidate_id"], row["plan_status"]) for row in first if not row["y_plan"]]
    audits = [{"candidate_id": name, "stored_status": status, "audited_status": status, **audited} for name, status in statuses]
    groups = [row["scene_id"] for row in release_tables["splits"].to_pylist() if row["split"] == "test"]
    times = {stage: {"stage": [stage] * len(groups), "item_id": groups, "core_ms": [1.0] * len(groups)} for stage in ("ranker", "trees")}
    full = predictions.filter(pa.compute.equal(predictions["variant"], "full"))
    return {
        "predictions": predictions,
        "decision_times": table_from_columns(schemas.TIMINGS, times["ranker"]),
        "tree_decision_times": table_from_columns(schemas.TIMINGS, times["trees"]),
        "planner_costs": planner_costs(release_tables["timings"], release_tables["candidates"]),
        "learning_curve": learning_curve_table({36: [full]}, release_tables["candidates"], release_tables["splits"]),
        "tree_predictions": table_from_rows(schemas.PREDICTIONS, trees),
        "object/predictions": predictions,
        "attempts": table_from_rows(schemas.ATTEMPTS, [{name: row[name] for name in labels} | same for row in first]),
        "audits": table_from_rows(schemas.AUDITS, audits),
        "test_replicates": replicates_of(release_tables),
    }


@pytest.fixture(scope="module")
def data(release_tables: dict[str, pa.Table], predictions: pa.Table, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data folder with the release and all that is shipped beside it; tests that change it copy it first."""
    root = tmp_path_factory.mktemp("data")
    whole = write_release(release_tables, root / "release" / "full", "full", "0.1.0", PROVENANCE, TOLERANCES)
    for name, table in about(release_tables, predictions).items():
        path = root / "predictions" / "full" / f"{name}.parquet"
        trained = {SCHEME_OF_PREDICTIONS: "object"} if name.startswith("object/") else {}
        write_table(BESIDE[name], table, path, {"release": whole.release_hash, **trained}, of="full")
    return root


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def test_every_report_is_made_twice_the_same(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(data / "release" / "full"), "--out", str(tmp_path / "one")]) == 0
    out = capsys.readouterr().out
    lines = {line.partition(":")[0]: line for line in out.splitlines()}
    assert [name for name in KINDS if "left out" in lines[name]] == ["gallery"], "the synthetic release has no meshes"
    assert f"{data}/release/full/object_meshes.parquet is missing: the release has no such table" in lines["gallery"]
    assert {path.stem for path in (tmp_path / "one").glob("*.md")} == set(MADE)
    assert lines["15 of 16 reports in " + str(tmp_path / "one") + "; left out"].endswith(": gallery")
    moved = tmp_path / "elsewhere"
    shutil.copytree(data / "predictions" / "full", moved)
    assert main([str(data / "release" / "full"), "--predictions", str(moved), "--out", str(tmp_path / "two")]) == 0
    assert files(tmp_path / "one") == files(tmp_path / "two")


def test_a_report_is_the_one_of_its_module(data: Path, release_tables: dict[str, pa.Table], predictions: pa.Table) -> None:
    sources = Sources(Release.open(data / "release" / "full"), data / "predictions" / "full")
    times = join_tables(schemas.TIMINGS, [sources.table(name) for name in ("decision_times", "tree_decision_times")])
    both = join_tables(schemas.PREDICTIONS, [predictions, sources.table("tree_predictions")])
    costs = Costs(timing_frame(release_tables, times), sources.table("planner_costs"))
    expected = success_at_k_report(release_tables, both, costs, tier="full", seed=42)
    made = KINDS["success_at_k"].make(sources)
    assert (made.markdown, dict(made.metrics)) == (expected.markdown, dict(expected.metrics))
    assert made.metrics["test.joint.ranker.decision_ms"] == made.metrics["test.joint.trees.decision_ms"] == 1.0


def test_a_light_release_without_predictions_says_what_it_lacks(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    light, out_dir = tmp_path / "data" / "release" / "full-light", tmp_path / "out"
    make_light(data / "release" / "full", light)
    assert main([str(light), "--out", str(out_dir)]) == 0
    lines = {line.partition(":")[0]: line for line in capsys.readouterr().out.splitlines()}
    folder = tmp_path / "data" / "predictions" / "full"
    for name, file in (
        ("repeatability", "attempts"),
        ("audit", "audits"),
        ("ablation", "predictions"),
        ("trees_probe", "tree_predictions"),
        ("ceiling", "test_replicates"),
        ("learning_curve", "learning_curve"),
        *((name, "predictions") for name in OF_LEARNED),
    ):
        assert lines[name] == f"{name}: left out, {folder / f'{file}.parquet'} is missing"
    assert f"{light / 'timings.parquet'} is missing" in lines["profile"]
    assert f"{folder / 'predictions.parquet'} is missing" in lines["success_at_k"]
    assert {path.stem for path in out_dir.glob("*.md")} == {"shard_diagnostics", "profile", "success_at_k", "planner_calls"}
    calls = (out_dir / "planner_calls.md").read_text()
    costs, timings = folder / "planner_costs.parquet", light / "timings.parquet"
    assert f"Not known: {costs} is missing, and {timings} is missing" in calls
    assert "`python -m reports.planner_costs` makes the one from the other." in calls
    assert "Not measured." in (out_dir / "profile.md").read_text()
    text = (out_dir / "success_at_k.md").read_text()
    assert "No ranker was scored" in text
    assert "not measured" in text


def test_tables_about_another_release_and_damaged_ones_fail_alone(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "about"
    shutil.copytree(data / "predictions" / "full", folder)
    path = folder / "audits.parquet"
    path.write_bytes(path.read_bytes() + b"?")
    sources = Sources(Release.open(data / "release" / "full"), folder)
    write_table(
        schemas.PREDICTIONS, sources.table("tree_predictions"), folder / "tree_predictions.parquet", {"release": "0" * 64}, of="full"
    )
    assert main([str(data / "release" / "full"), "--predictions", str(folder), "--out", str(tmp_path / "out")]) == 1
    out = capsys.readouterr().out
    lines = {line.partition(":")[0]: line for line in out.splitlines()}
    about_this = read_manifest(data / "release" / "full").release_hash[:12]
    assert (
        f"FAILED, ReportError: {folder / 'tree_predictions.parquet'}: about release {'0' * 12}, must be about {about_this}"
        in lines["trees_probe"]
    )
    assert "FAILED, StoreError" in lines["audit"]
    of_trees = {"success_at_k", "planner_calls", *OF_LEARNED, "trees_probe", "generalisation", "ceiling"}
    failed = [name for name in KINDS if name in {"audit", *of_trees}]
    assert out.splitlines()[-1].endswith(f"left out: gallery; failed: {', '.join(failed)}")
    assert {path.stem for path in (tmp_path / "out").glob("*.md")} == set(MADE) - set(failed)


def under(scheme: str, data: Path, folder: Path) -> Path:
    """The predictions of both kinds as those of rankers that were trained under a scheme."""
    sources = Sources(Release.open(data / "release" / "full"), data / "predictions" / "full")
    for name in ("predictions", "tree_predictions"):
        write_table(schemas.PREDICTIONS, sources.table(name), folder / f"{name}.parquet", {SCHEME_OF_PREDICTIONS: scheme}, of="full")
    return folder


def test_under_a_scheme_only_what_a_split_decides_is_made(
    data: Path, release_tables: dict[str, pa.Table], predictions: pa.Table, tmp_path: Path, monkeypatch, capsys
) -> None:
    copied = Path(shutil.copytree(data, tmp_path / "data"))
    under("object", data, copied / "predictions" / "full" / "object")
    monkeypatch.chdir(tmp_path)
    assert main([str(copied / "release" / "full"), "--split", "object"]) == 0
    out = tmp_path / "reports" / "out" / "full" / "object"
    decided = {"profile", "success_at_k", "planner_calls", *OF_LEARNED, "ablation", "trees_probe"}
    assert {path.stem for path in out.glob("*.md")} == decided
    assert capsys.readouterr().out.splitlines()[-1] == "9 of 9 reports in reports/out/full/object"
    for name in decided:
        assert ", split `object`" in (out / f"{name}.md").read_text().splitlines()[0], name
    both = join_tables(schemas.PREDICTIONS, [predictions, about(release_tables, predictions)["tree_predictions"]])
    expected = success_at_k_report(release_tables, both, tier="full", seed=42, scheme=SplitScheme.OBJECT)
    # Decision times are measured again under another scheme: there are none here, and those of the paper's split are not shown.
    assert (json.loads((out / "success_at_k.json").read_text())) == dict(expected.metrics)
    assert main([str(copied / "release" / "full"), "--split", "kitchen"]) == 1
    assert capsys.readouterr().err.startswith("error: split 'kitchen', must be one of ")


@pytest.mark.parametrize(("trained", "asked"), [("object", "scene"), ("scene", "layout"), ("object", "layout")])
def test_predictions_of_another_scheme_are_refused_by_every_report_alike(
    trained: str, asked: str, data: Path, tmp_path: Path, capsys
) -> None:
    folder, release = under(trained, data, tmp_path / "about"), data / "release" / "full"
    sources = Sources(Release.open(release), folder, scheme=SplitScheme(asked))
    for name, file in ((name, "tree_predictions" if name == "trees_probe" else "predictions") for name in READ_SCORES):
        says = f"{folder / file}.parquet: of rankers that were trained under split {trained!r}, must be {asked!r}, the split asked for"
        with pytest.raises(ReportError, match=f"^{re.escape(says)}$"):
            KINDS[name].make(sources)
    for command in (success_at_k.main, ablation.main):
        path = str(folder / "predictions.parquet")
        assert command([str(release), "--split", asked, "--predictions", path]) == 1
        says = f"of rankers that were trained under split {trained!r}, must be {asked!r}, the split asked for"
        assert capsys.readouterr().err == f"error: {path}: {says}\n"


def test_a_part_of_a_scheme_that_a_small_tier_lacks_is_named(data: Path, tmp_path: Path) -> None:
    sources = Sources(Release.open(data / "release" / "full"), under("layout", data, tmp_path), scheme=SplitScheme.LAYOUT)
    rows = [row | {"split_layout": "train"} for row in sources.table("splits").to_pylist()]
    sources.release._tables["splits"] = table_from_rows(schemas.SPLITS, rows)
    for name in READ_SCORES:
        with pytest.raises(
            ReportError, match=r"splits: 0 scenes in (test|validation) of scheme layout, must be at least 1: take a larger tier"
        ):
            KINDS[name].make(sources)


def test_rankers_and_tasks_that_are_not_there_are_named(data: Path, tmp_path: Path) -> None:
    release = Release.open(data / "release" / "full")
    whole, some = Sources(release, data / "predictions" / "full"), Sources(release, tmp_path)

    def keep(name: str, is_kept: Callable[[dict], bool]) -> None:
        rows = [row for row in whole.table(name).to_pylist() if is_kept(row)]
        write_table(BESIDE[name], table_from_rows(BESIDE[name], rows), some.path(name), of="full")

    keep("predictions", lambda row: row["variant"] == "no_object_relative" or (row["variant"], row["seed"]) == ("direct", 42))
    keep("tree_predictions", lambda row: row["variant"] == "trees")
    keep("decision_times", lambda row: True)
    keep("tree_decision_times", lambda row: True)
    without = f"{some.path('predictions')} is there without"
    times = f"{some.path('decision_times')} is there without task fixed"
    assert KINDS["success_at_k"].goes_without(some) == [f"{without} full", times]
    assert KINDS["success_at_k"].goes_without(whole) == [f"{whole.path('decision_times')} is there without task fixed"]
    assert KINDS["ablation"].goes_without(some) == [f"{without} direct of seed 43, no_target_hypothesis, full"]
    assert KINDS["trees_probe"].lacks(some) == [f"{some.path('tree_predictions')} is there without trees_poses"]
    assert KINDS["ablation"].lacks(some) == [f"{without} full"], "of which the others are ablations"
    assert not any((KINDS["ablation"].goes_without(whole), KINDS["ablation"].lacks(whole), KINDS["trees_probe"].lacks(whole)))


def test_no_release_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(tmp_path / "nothing")]) == 1
    assert capsys.readouterr().err == f"error: {tmp_path / 'nothing'}: no such folder\n"
