"""A report under another split scheme judges the groups of that scheme's test split, and rankers that were not trained on them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pytest

from model.settings import SCHEME_OF_PREDICTIONS
from reports import ablation, paper, profile, success_at_k, trees_probe
from reports.ablation import ablation_report
from reports.load import Task, candidate_frame, check_parts, group_frame
from reports.predictions import read_predictions
from reports.profile import profile_report
from reports.report import Report, ReportError
from reports.success_at_k import success_at_k_report
from splits.release import write_release
from tables.schemas import PREDICTIONS, SPLITS
from tables.store import read_sidecar, read_table, table_from_rows, write_table
from tables.vocabulary import Split, SplitScheme
from tests.model.synthetic_release import TOLERANCES
from tests.reports.conftest import scores_of
from tests.splits.damage import PROVENANCE

Tables = dict[str, pa.Table]
Command = Callable[[list[str]], int]


@pytest.fixture(scope="module")
def folder(release_tables: Tables, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("release")
    write_release(release_tables, folder, "pilot", "0.1.0", PROVENANCE, TOLERANCES)
    return folder


@pytest.fixture(scope="module")
def by_object(predictions: pa.Table, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The predictions as a file of rankers that were trained under scheme `object`."""
    path = tmp_path_factory.mktemp("predictions") / "predictions.parquet"
    write_table(PREDICTIONS, predictions, path, {SCHEME_OF_PREDICTIONS: "object"})
    return path


def scenes_in(tables: Tables, scheme: SplitScheme, split: str) -> set[str]:
    return {row["scene_id"] for row in tables["splits"].to_pylist() if row[scheme.column] == split}


@pytest.mark.parametrize("scheme", list(SplitScheme))
def test_candidates_and_groups_have_the_split_of_the_scheme(release_tables: Tables, scheme: SplitScheme) -> None:
    frame, groups = candidate_frame(release_tables, 42, scheme), group_frame(release_tables, Task.FIXED, scheme)
    assert frame.columns == candidate_frame(release_tables, 42).columns
    assert groups.columns == group_frame(release_tables, Task.FIXED).columns
    for split in Split:
        own = scenes_in(release_tables, scheme, split.value)
        assert set(frame.filter(frame["split"] == split.value)["scene_id"]) == own
        assert groups.filter(groups["split"] == split.value).height == 8 * len(own)


@pytest.mark.parametrize("scheme", [SplitScheme.OBJECT, SplitScheme.CATEGORY_MUG, SplitScheme.LAYOUT])
def test_success_is_counted_over_the_test_groups_of_the_scheme(release_tables: Tables, predictions: pa.Table, scheme: SplitScheme) -> None:
    report = success_at_k_report(release_tables, predictions, tier="pilot", seed=42, scheme=scheme)
    test = scenes_in(release_tables, scheme, "test")
    scores = [scores_of(predictions, "full", seed) for seed in (42, 43)]
    groups: dict[tuple[str, int], list[tuple[str, bool]]] = {}
    for row in release_tables["candidates"].to_pylist():
        if row["scene_id"] in test:
            groups.setdefault((row["scene_id"], row["target_id"]), []).append((row["candidate_id"], bool(row["y_pipe"])))
    covered = [group for group in groups.values() if any(success for _, success in group)]
    assert report.metrics["test.fixed.n_groups"] == 8 * len(test)
    assert report.metrics["test.fixed.n_covered"] == len(covered)
    firsts = [max((score[name], success) for name, success in group) for score in scores for group in covered]
    assert report.metrics["test.fixed.ranker.s1"] == pytest.approx(sum(success for _, success in firsts) / len(firsts))
    assert scenes_in(release_tables, SplitScheme.SCENE, "test") != test


def test_a_report_says_its_scheme_and_puts_no_figure_of_the_paper_beside_it(release_tables: Tables, predictions: pa.Table) -> None:
    for make, title, figures in (
        (success_at_k_report, "# S_K on tier pilot", ("85.78", "74.66", f"{paper.COVERAGE['test', Task.JOINT]:.2f} %")),
        (
            ablation_report,
            "# Ablation on tier pilot",
            (str(paper.ABLATION["full"][0]), f"{paper.COVERAGE['validation', Task.FIXED]:.2f} %"),
        ),
    ):
        by_scene, by_object = (
            make(release_tables, predictions, tier="pilot", seed=42, scheme=scheme) for scheme in (SplitScheme.SCENE, SplitScheme.OBJECT)
        )
        assert by_scene == make(release_tables, predictions, tier="pilot", seed=42)
        assert by_object.markdown.startswith(f"{title}, split `object`")
        assert "> **Split `split_object`**: train, validation or test by object: an object is in one of them alone" in by_object.markdown
        assert "split_object" not in by_scene.markdown
        for figure in figures:
            assert figure in by_scene.markdown
            assert figure not in by_object.markdown


def test_the_profile_counts_the_splits_of_the_scheme(release_tables: Tables) -> None:
    report = profile_report(release_tables, tier="pilot", seed=42, scheme=SplitScheme.LAYOUT)
    test = scenes_in(release_tables, SplitScheme.LAYOUT, "test")
    is_test = [row["scene_id"] in test for row in release_tables["candidates"].to_pylist()]
    n, n_test = len(is_test), sum(is_test)
    assert f"| candidates of test | {n_test:,} ({100 * n_test / n:.1f} %) | – |" in report.markdown
    by_scene = profile_report(release_tables, tier="pilot", seed=42)
    assert by_scene.metrics == report.metrics
    assert by_scene.markdown != report.markdown


@pytest.mark.parametrize(
    ("command", "name", "takes_predictions"),
    [(success_at_k.main, "success_at_k", True), (ablation.main, "ablation", True), (profile.main, "profile", False)],
    ids=["success_at_k", "ablation", "profile"],
)
def test_the_commands_report_under_a_split(
    command: Command,
    name: str,
    takes_predictions: bool,
    folder: Path,
    by_object: Path,
    release_tables: Tables,
    predictions: pa.Table,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    scores = ["--predictions", str(by_object)] if takes_predictions else []
    assert command([str(folder), "--split", "object", *scores, "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert (tmp_path / f"{name}.md").read_text() in printed
    assert ", split `object`" in printed.splitlines()[0]
    make: dict[str, Callable[[], Report]] = {
        "success_at_k": lambda: success_at_k_report(release_tables, predictions, tier="pilot", seed=42, scheme=SplitScheme.OBJECT),
        "ablation": lambda: ablation_report(release_tables, predictions, tier="pilot", seed=42, scheme=SplitScheme.OBJECT),
        "profile": lambda: profile_report(release_tables, tier="pilot", seed=42, scheme=SplitScheme.OBJECT),
    }
    assert json.loads((tmp_path / f"{name}.json").read_text()) == make[name]().metrics
    assert command([str(folder), "--split", "kitchen", *scores, "--out", str(tmp_path / "none")]) == 1
    assert "split 'kitchen', must be one of ['scene'," in capsys.readouterr().err
    assert not (tmp_path / "none").exists()


def test_rankers_of_another_split_are_refused(folder: Path, by_object: Path, predictions: pa.Table, tmp_path: Path, capsys) -> None:
    """They may have been trained on the scenes that they would be judged on; a file that does not say is of the paper's split."""
    by_scene = tmp_path / "by_scene.parquet"
    write_table(PREDICTIONS, predictions, by_scene)
    for path, split, trained in ((by_object, "scene", "object"), (by_object, "layout", "object"), (by_scene, "object", "scene")):
        assert success_at_k.main([str(folder), "--split", split, "--predictions", str(path)]) == 1
        (line,) = capsys.readouterr().err.splitlines()
        assert line == f"error: {path}: of rankers that were trained under split '{trained}', must be '{split}', the split asked for"
    read = read_predictions([by_scene], SplitScheme.SCENE)
    assert read is not None
    assert read.equals(predictions)


def test_a_split_that_a_release_has_no_scene_of_is_refused(release_tables: Tables) -> None:
    rows = [row | {"split_object": "train"} for row in release_tables["splits"].to_pylist()]
    tables = release_tables | {"splits": table_from_rows(SPLITS, rows)}
    check_parts(tables, SplitScheme.SCENE, list(Split))
    check_parts(tables, SplitScheme.OBJECT, [Split.TRAIN])
    with pytest.raises(ReportError, match="splits: 0 scenes in test of scheme object, must be at least 1: take a larger tier"):
        check_parts(tables, SplitScheme.OBJECT, [Split.TRAIN, Split.TEST])


def test_the_trees_are_trained_and_judged_under_the_split(folder: Path, release_tables: Tables, tmp_path: Path, capsys) -> None:
    assert trees_probe.main([str(folder), "--split", "layout", "--out", str(tmp_path)]) == 0
    assert "split `layout`" in capsys.readouterr().out.splitlines()[0]
    assert read_sidecar(tmp_path / "predictions.parquet").made_from == {SCHEME_OF_PREDICTIONS: "layout"}
    scores = read_table(PREDICTIONS, tmp_path / "predictions.parquet")
    again = trees_probe.trees_probe_report(release_tables, scores, split="test", seed=42, title="Trees", scheme=SplitScheme.LAYOUT)
    assert json.loads((tmp_path / "trees_probe.json").read_text()) == again.metrics
    by_scene = trees_probe.trees_probe_report(release_tables, scores, split="test", seed=42, title="Trees")
    assert by_scene.metrics != again.metrics
    assert trees_probe.main([str(folder), "--split", "layout", "--cross-validate", "2"]) == 1
    assert "cross-validation is over all scenes" in capsys.readouterr().err
