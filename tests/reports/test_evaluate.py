"""Anyone's predictions: order alone decides, the truth scores 100, and every kind of bad file ends in one line that names what is wrong."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from model.predictions import RELEASE_KEY, SPLIT_KEY
from model.settings import SCHEME_OF_PREDICTIONS
from reports.calibration import N_BINS, Fit, Judged
from reports.evaluate import evaluation_report, main
from reports.report import Report, ReportError
from reports.submission import read_submission
from splits.manifest import read_manifest
from splits.release import make_light, write_release
from splits.release_reader import Release
from tables.schemas import PREDICTIONS
from tables.store import read_sidecar, table_from_columns, write_table
from tables.vocabulary import SplitScheme
from tests.model.synthetic_release import TOLERANCES
from tests.reports.reference import expected_calibration_error
from tests.splits.damage import PROVENANCE

Tables = dict[str, pa.Table]


@pytest.fixture(scope="module")
def folder(release_tables: Tables, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A light release: what it leaves out is not needed."""
    data = tmp_path_factory.mktemp("data")
    write_release(release_tables, data / "whole", "full", "0.1.0", PROVENANCE, TOLERANCES)
    make_light(data / "whole", data / "release" / "full")
    return data / "release" / "full"


@pytest.fixture(scope="module")
def candidates(folder: Path) -> pl.DataFrame:
    return Release.open(folder).candidates.select("candidate_id", "split", "scene_id", "y_plan", success=pl.col("y_pipe").fill_null(False))


@pytest.fixture(scope="module")
def noisy(candidates: pl.DataFrame) -> pl.DataFrame:
    """Probabilities of every candidate: the labels with noise."""
    rng = np.random.default_rng(4)
    logits = {name: 4.0 * candidates[label].to_numpy() - 2.0 for name, label in (("p_plan", "y_plan"), ("p_exec", "success"))}
    return candidates.select("candidate_id").with_columns(
        **{name: pl.Series(1.0 / (1.0 + np.exp(-(own + rng.normal(0.0, 1.5, len(own)))))) for name, own in logits.items()}
    )


def report_of(folder: Path, frame: pl.DataFrame, path: Path, scheme: SplitScheme = SplitScheme.SCENE) -> Report:
    frame.write_parquet(path)
    release = Release.open(folder)
    known = release.candidates.select("candidate_id", pl.col(scheme.column).alias("split"))
    submission = read_submission(path, known, release.manifest.release_hash, scheme)
    tables = release.tables("candidates", "splits", "scenes", "targets", "policy_features")
    return evaluation_report(tables, submission, release="full", seed=42, scheme=scheme)


def test_the_truth_scores_a_hundred(folder: Path, candidates: pl.DataFrame, tmp_path: Path) -> None:
    truth = candidates.select("candidate_id", score=pl.col("success").cast(pl.Float64))
    report = report_of(folder, truth, tmp_path / "truth.parquet")
    for task in ("joint", "fixed"):
        for k in (1, 3, 5):
            assert report.metrics[f"test.{task}.submission.s{k}"] == 1.0
        assert report.metrics.get(f"test.{task}.submission.hard_s1") == (1.0 if task == "fixed" else None), "no joint group is hard"
        assert report.metrics[f"test.{task}.submission.first_success_rank"] == 1.0
        assert report.metrics[f"test.{task}.submission_minus_full_planner.s1_low"] >= 0.0
    assert report.metrics["test.fixed.submission.solvability.auroc"] == 1.0
    assert report.metrics["test.fixed.submission.solvability.balanced_accuracy"] == 1.0
    assert "No probabilities were given" in report.markdown
    upside_down = truth.with_columns(score=-pl.col("score"))
    assert report_of(folder, upside_down, tmp_path / "worst.parquet").metrics["test.fixed.submission.solvability.auroc"] < 0.5


def test_equal_scores_are_the_hash_order(folder: Path, candidates: pl.DataFrame, tmp_path: Path) -> None:
    metrics = report_of(folder, candidates.select("candidate_id", score=pl.lit(0)), tmp_path / "equal.parquet").metrics
    for task in ("joint", "fixed"):
        for k in (1, 3, 5):
            assert metrics[f"test.{task}.submission.s{k}"] == metrics[f"test.{task}.random.s{k}"]


@given(st.integers(0, 2**32 - 1), st.floats(-50.0, 50.0), st.floats(1e-3, 1e3))
@settings(max_examples=8, deadline=None)
def test_rows_and_scale_mean_nothing(
    folder: Path, noisy: pl.DataFrame, tmp_path_factory: pytest.TempPathFactory, shuffle: int, offset: float, scale: float
) -> None:
    path = tmp_path_factory.getbasetemp() / "same_name.parquet"
    scored = noisy.select("candidate_id", score=pl.col("p_plan") * pl.col("p_exec"))
    report = report_of(folder, scored, path)
    assert report_of(folder, scored.sample(fraction=1.0, shuffle=True, seed=shuffle), path) == report
    grown = report_of(folder, scored.with_columns(pl.col("score").rank("dense").cast(pl.Float64) * scale + offset), path)
    assert unscaled(grown) == unscaled(report)


def unscaled(report: Report) -> dict[str, float]:
    """Metrics that no growing function of the scores changes: all but the threshold."""
    return {name: value for name, value in report.metrics.items() if not name.endswith(".threshold")}


def test_probabilities_and_their_logarithms_say_the_same(folder: Path, noisy: pl.DataFrame, tmp_path: Path) -> None:
    log = noisy.select("candidate_id", log_p_plan=pl.col("p_plan").log(), log_p_exec=pl.col("p_exec").log())
    plain, logarithmic = report_of(folder, noisy, tmp_path / "a.parquet"), report_of(folder, log, tmp_path / "b.parquet")
    assert unscaled(plain) == pytest.approx(unscaled(logarithmic))
    assert "ordered by `p_plan * p_exec`" in plain.markdown
    assert "ordered by `log_p_plan + log_p_exec`" in logarithmic.markdown
    assert 0.0 < plain.metrics["test.submission.calibration.success.ece"] < 0.5
    both = noisy.with_columns(score=pl.lit(0.0))
    ordered_by_score = report_of(folder, both, tmp_path / "c.parquet")
    assert "ordered by `score`" in ordered_by_score.markdown
    assert ordered_by_score.metrics["test.submission.calibration.plan.brier"] == plain.metrics["test.submission.calibration.plan.brier"]


def test_the_validation_split_may_be_left_out_and_train_does_not_matter(
    folder: Path, candidates: pl.DataFrame, noisy: pl.DataFrame, tmp_path: Path
) -> None:
    of_test = noisy.join(candidates.filter(pl.col("split") == "test").select("candidate_id"), on="candidate_id")
    whole, test = report_of(folder, noisy, tmp_path / "a.parquet"), report_of(folder, of_test, tmp_path / "b.parquet")
    # Every joint group of the validation split is solvable, so none has a threshold there.
    judged = {
        f"test.fixed.submission.solvability.{name}{end}"
        for name in ("balanced_accuracy", "recall_solvable", "recall_unsolvable")
        for end in ("", "_low", "_high")
    }
    assert set(whole.metrics) - set(test.metrics) == judged | {"test.fixed.submission.solvability.threshold"}
    assert "there is no threshold to choose" in test.markdown
    assert {name: whole.metrics[name] for name in test.metrics} == test.metrics


def test_any_string_and_number_type_will_do(folder: Path, noisy: pl.DataFrame, tmp_path: Path) -> None:
    expected = report_of(folder, noisy.select("candidate_id", score=pl.col("p_plan").cast(pl.Float32)), tmp_path / "x.parquet").metrics
    table = noisy.select("candidate_id", score=pl.col("p_plan").cast(pl.Float32)).to_arrow()
    for dtype in (pa.string(), pa.large_string(), pa.dictionary(pa.int32(), pa.string())):
        path = tmp_path / "x.parquet"
        pq.write_table(table.set_column(0, "candidate_id", table["candidate_id"].cast(pa.string()).cast(dtype)), path)
        assert main([str(path), "--release", str(folder), "--out", str(tmp_path)]) == 0
        assert json.loads((tmp_path / "evaluation.json").read_text()) == expected


def test_the_command_writes_what_it_prints_beside_the_committed_predictions(
    folder: Path, noisy: pl.DataFrame, predictions: pa.Table, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, beside = tmp_path / "mine.parquet", tmp_path / "beside"
    noisy.write_parquet(path)
    release_hash = read_manifest(folder).release_hash
    write_table(PREDICTIONS, predictions, beside / "predictions.parquet", {"release": release_hash}, of="full")
    assert main([str(path), "--release", str(folder), "--beside", str(beside), "--out", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("# mine.parquet on full 0.1.0")
    assert (tmp_path / "out" / "evaluation.md").read_text() in printed
    metrics = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    for other in ("random_mean", "ik_only", "ik_and_gripper", "full_planner", "ranker"):
        assert f"test.fixed.submission_minus_{other}.s1_low" in metrics
    assert metrics["test.fixed.submission.s1"] - metrics["test.fixed.ranker.s1"] == pytest.approx(
        metrics["test.fixed.submission_minus_ranker.s1"]
    )
    assert metrics["test.fixed.submission.s1"] - metrics["test.fixed.random.s1_expected"] == pytest.approx(
        metrics["test.fixed.submission_minus_random_mean.s1"]
    )


@pytest.mark.parametrize("scheme", [SplitScheme.SCENE, SplitScheme.OBJECT])
@pytest.mark.parametrize("there", [("predictions", "tree_predictions"), ("tree_predictions",)])
def test_networks_and_trees_are_both_compared_with_where_they_lie_beside(
    there: tuple[str, ...], scheme: SplitScheme, folder: Path, noisy: pl.DataFrame, predictions: pa.Table, tmp_path: Path
) -> None:
    """Both files hold the same scores here, under the name of the paper's network and of the trees."""
    of_network = predictions.filter(pc.equal(predictions["variant"].cast(pa.string()), "full"))
    as_trees = {name: of_network[name] for name in PREDICTIONS.names} | {"variant": ["trees"] * of_network.num_rows}
    tables = {"predictions": of_network, "tree_predictions": table_from_columns(PREDICTIONS, as_trees)}
    made_from = {"release": read_manifest(folder).release_hash, SCHEME_OF_PREDICTIONS: scheme.value}
    for name in there:
        write_table(PREDICTIONS, tables[name], tmp_path / "beside" / f"{name}.parquet", made_from, of="full")
    noisy.write_parquet(tmp_path / "mine.parquet")
    arguments = [str(tmp_path / "mine.parquet"), "--release", str(folder), "--split", scheme.value]
    assert main([*arguments, "--beside", str(tmp_path / "beside"), "--out", str(tmp_path)]) == 0
    metrics = json.loads((tmp_path / "evaluation.json").read_text())
    of_trees = "test.joint.submission_minus_trees.s1"
    assert metrics[of_trees] == pytest.approx(metrics["test.joint.submission.s1"] - metrics["test.joint.trees.s1"])
    assert metrics.get("test.joint.submission_minus_ranker.s1") == (metrics[of_trees] if "predictions" in there else None)


Frame = pl.DataFrame


def with_value(frame: Frame, name: str, value: float | None, n: int = 2) -> Frame:
    """The first n rows of a column, which is otherwise 0.25, set to a value."""
    return frame.with_columns(pl.when(pl.int_range(pl.len()) < n).then(pl.lit(value)).otherwise(0.25).alias(name))


SCORED = {"score": 0.5}
FIRST = "full-0000-t0-g04"
BAD: Mapping[str, tuple[Callable[[Frame], Frame], str]] = {
    "no id": (lambda f: f.drop("candidate_id").with_columns(score=1.0), "no column 'candidate_id' among"),
    "nothing to order by": (lambda f: f, "must have 'score', or 'log_p_plan' and 'log_p_exec', or 'p_plan' and 'p_exec'"),
    "half a pair": (lambda f: f.with_columns(score=1.0, p_plan=0.5), "column 'p_plan' without 'p_exec', must have both or neither"),
    "two pairs": (
        lambda f: f.with_columns(p_plan=0.5, p_exec=0.5, log_p_plan=-1.0, log_p_exec=-1.0),
        "both ['log_p_plan', 'log_p_exec'] and ['p_plan', 'p_exec'], must have one of them",
    ),
    "ids as numbers": (
        lambda f: f.select(candidate_id=pl.int_range(pl.len()), score=1.0),
        "'candidate_id' is of type int64, must be string",
    ),
    "scores as text": (lambda f: f.with_columns(score=pl.lit("high")), "'score' is of type"),
    "scores as flags": (lambda f: f.with_columns(score=True), "'score' is of type bool, must be a number"),
    "no rows": (lambda f: f.with_columns(score=1.0).clear(), "0 rows, must have one a candidate"),
    "null id": (
        lambda f: f.with_columns(score=1.0, candidate_id=pl.when(pl.int_range(pl.len()) > 1).then("candidate_id")),
        "'candidate_id' has 2 nulls, must be 0",
    ),
    "null score": (lambda f: with_value(f, "score", None), f"column 'score' is null at {FIRST} (2 values are null, must be 0)"),
    "NaN": (lambda f: with_value(f, "score", float("nan")), f"column 'score' is NaN at {FIRST} (2 values are NaN, must be 0)"),
    "infinity": (
        lambda f: with_value(f, "score", float("-inf"), 1),
        f"column 'score' is infinite at {FIRST} (1 values are infinite, must be 0)",
    ),
    "probability above 1": (
        lambda f: with_value(f, "p_exec", 1.5).with_columns(p_plan=0.5),
        f"column 'p_exec' is 1.5 at {FIRST} (2 values are outside [0, 1])",
    ),
    "probability below 0": (lambda f: with_value(f, "p_plan", -0.01).with_columns(p_exec=0.5), "column 'p_plan' is -0.01 at"),
    "log-probability above 0": (
        lambda f: with_value(f, "log_p_plan", 0.5).with_columns(log_p_exec=-0.5),
        f"column 'log_p_plan' is 0.5 at {FIRST} (",
    ),
    "log of zero": (
        lambda f: with_value(f.with_columns(log_p_exec=-1.0), "log_p_plan", float("-inf")),
        f"column 'log_p_plan' is infinite at {FIRST}",
    ),
    "repeated": (
        lambda f: pl.concat([f, f.tail(3), f.tail(1)]).with_columns(score=1.0),
        "is there 2 times, must be once (4 rows too many)",
    ),
    "foreign": (
        lambda f: pl.concat([f, pl.DataFrame({"candidate_id": ["mini-0000-t0-g00", "a"]})]).with_columns(score=1.0),
        "'a' is no candidate of the release (2 ids are not, must be 0)",
    ),
    "missing": (
        lambda f: f.filter(~pl.col("candidate_id").str.starts_with("full-0004-t0")).with_columns(score=1.0),
        "of the test split has no row (",
    ),
    "missing in validation": (
        lambda f: f.filter(~pl.col("candidate_id").str.starts_with("full-0003-t0")).with_columns(score=1.0),
        "of the validation split has no row (",
    ),
}


@pytest.mark.parametrize("kind", BAD)
def test_a_bad_file_is_one_clear_line(
    kind: str, folder: Path, candidates: pl.DataFrame, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    damage, expected = BAD[kind]
    path = tmp_path / "mine.parquet"
    damage(candidates.select("candidate_id").sort("candidate_id")).write_parquet(path)
    assert main([str(path), "--release", str(folder), "--out", str(tmp_path / "out")]) == 1
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith(f"error: {path}: ")
    assert said.err.count("\n") == 1
    assert expected in said.err
    assert not (tmp_path / "out").exists()


def test_what_is_no_table_is_one_clear_line(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = tmp_path / "scores.csv"
    text.write_text("candidate_id,score\n")
    for path, expected in ((tmp_path / "none.parquet", "no such file"), (tmp_path, "no such file"), (text, "cannot be read as Parquet")):
        assert main([str(path), "--release", str(folder)]) == 1
        said = capsys.readouterr().err
        assert said.startswith(f"error: {path}: {expected}")
        assert said.count("\n") == 1
    assert main([str(text), "--release", str(tmp_path / "nothing")]) == 1
    assert capsys.readouterr().err == f"error: {tmp_path / 'nothing'}: no such folder\n"


def test_predictions_that_name_another_release_or_split_are_refused(
    folder: Path, noisy: pl.DataFrame, predictions: pa.Table, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    release_hash = read_manifest(folder).release_hash
    path = tmp_path / "mine.parquet"

    def said(metadata: dict[str, str], *more: str) -> str:
        pq.write_table(noisy.to_arrow().replace_schema_metadata(metadata), path)
        code = main([str(path), "--release", str(folder), *more])
        text = capsys.readouterr().err
        assert (code == 0) == (text == "")
        return text

    assert said({RELEASE_KEY: release_hash, SPLIT_KEY: "scene"}) == ""
    assert said({RELEASE_KEY: release_hash[:12]}) == ""
    assert said({RELEASE_KEY: "0" * 64}) == f"error: {path}: about release {'0' * 12}, must be about {release_hash[:12]}\n"
    assert f"about release {release_hash[:3]}, must be about" in said({RELEASE_KEY: release_hash[:3]})
    assert "was trained under split 'object', must be 'scene' as --split says" in said({SPLIT_KEY: "object"})
    assert said({SPLIT_KEY: "object"}, "--split", "object") == ""
    assert "split 'kitchen', must be one of" in said({}, "--split", "kitchen")
    ours = predictions.filter(pa.array([row["variant"] == "full" and row["seed"] == 42 for row in predictions.to_pylist()]))
    for made_from, expected in (
        ({"release": "f" * 64}, "about release ffffffffffff, must be about"),
        ({SCHEME_OF_PREDICTIONS: "layout"}, "trained under split 'layout'"),
        ({"release": release_hash}, ""),
    ):
        write_table(PREDICTIONS, ours, path, made_from)
        assert main([str(path), "--release", str(folder)]) == (1 if expected else 0)
        assert expected in capsys.readouterr().err
    assert read_sidecar(path).made_from == {"release": release_hash}


def test_several_trainings_in_one_file_are_too_many(folder: Path, predictions: pa.Table, tmp_path: Path) -> None:
    release = Release.open(folder)
    pq.write_table(predictions, tmp_path / "all.parquet")
    with pytest.raises(ReportError, match=r"full-0000-t0-g\d\d is there 8 times, must be once"):
        read_submission(
            tmp_path / "all.parquet", release.candidates.select("candidate_id", "split"), release.manifest.release_hash, SplitScheme.SCENE
        )


@given(st.lists(st.tuples(st.floats(0.0, 1.0), st.booleans()), min_size=1, max_size=40))
@settings(max_examples=60, deadline=None)
def test_the_calibration_error_is_as_defined(units: list[tuple[float, bool]]) -> None:
    p, happened = np.array([p for p, _ in units]), np.array([y for _, y in units])
    fit = Fit.of(Judged(p[None], happened, ["s"] * len(p)), 1, "x")
    assert fit.ece.value == pytest.approx(expected_calibration_error(p, happened, N_BINS))
    assert fit.brier.value == pytest.approx(np.mean((p - happened) ** 2))
    assert set(fit.metrics("x")) <= {"x.ece", "x.brier", "x.auroc", "x.auroc_low", "x.auroc_high"}, "one scene tells no interval of a mean"


def test_brier_is_the_mean_squared_error_and_that_of_the_rate_its_reference() -> None:
    happened = np.array([True, True, True, False] * 10)
    scenes = [f"s{k // 2}" for k in range(40)]
    exact, rate = (Judged(p[None], happened, scenes) for p in (happened.astype(float), np.full(40, 0.75)))
    sure, unsure = (Fit.of(own, 1, "x") for own in (exact, rate))
    assert (sure.brier.value, sure.ece.value) == (0.0, 0.0)
    assert sure.auroc is not None
    assert (sure.auroc.value, sure.auroc.high) == (1.0, 1.0)
    assert unsure.brier.value == pytest.approx(rate.brier_of_rate)
    assert unsure.brier.low < unsure.brier.value < unsure.brier.high
    assert unsure.ece.value == pytest.approx(0.0)
