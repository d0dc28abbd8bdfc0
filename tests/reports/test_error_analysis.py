from __future__ import annotations

from collections import Counter

import polars as pl
import pyarrow as pa
import pytest

from reports.error_analysis import errors_report, worst_groups
from reports.error_films import Films
from reports.load import Task
from reports.policies import RANKER
from reports.report import Report
from tables import schemas
from tables.store import table_from_rows
from tests.reports.conftest import scores_of


@pytest.fixture(scope="module")
def report(release_tables: dict[str, pa.Table], predictions: pa.Table) -> Report:
    return errors_report(release_tables, predictions, Films(why_not="no plans here"), tier="pilot", seed=42)


def test_worst_groups_by_hand() -> None:
    """Latest first success first, equal ones by regret; what succeeds at once and what never does is no error of the order."""
    rows = [  # group, score, success, plan
        ("late", -1.0, False, True), ("late", -2.0, False, False), ("late", -3.0, True, True),
        ("sure", -0.5, False, True), ("sure", -4.0, True, True),
        ("near", -0.5, False, False), ("near", -0.6, True, True),
        ("good", -0.5, True, True), ("none", -0.5, False, True),
    ]  # fmt: skip
    frame = pl.DataFrame(
        {
            "candidate_id": [f"{group}-{k}" for k, (group, *_) in enumerate(rows)],
            "scene_id": [row[0] for row in rows],
            "object_id": ["mug_01"] * len(rows),
            "n_obstacles": [1] * len(rows),
            "score": [row[1] for row in rows],
            "success": [row[2] for row in rows],
            "exec_status": [None if not row[3] else "success" if row[2] else "toppled_at_release" for row in rows],
            "plan_status": ["solved" if row[3] else "no_ik" for row in rows],
            "hash_order": list(range(len(rows))),
        }
    )
    made = worst_groups(frame[::-1], RANKER, Task.JOINT)
    assert made["scene_id"].to_list() == ["late", "sure", "near"]
    assert made["rank"].to_list() == [3, 2, 2]
    assert made["regret"].to_list() == pytest.approx([2.0, 3.5, 0.1])
    assert made["tried"].to_list() == [["toppled_at_release", "no_ik"], ["toppled_at_release"], ["no_ik"]]
    assert made["first_id"].to_list() == ["late-0", "sure-3", "near-5"]
    assert made["success_id"].to_list() == ["late-2", "sure-4", "near-6"]
    assert worst_groups(frame, RANKER, Task.JOINT, n=1)["scene_id"].to_list() == ["late"]


def test_first_choices_are_counted_as_by_hand(report: Report, release_tables: dict[str, pa.Table], predictions: pa.Table) -> None:
    test = {row["scene_id"] for row in release_tables["splits"].to_pylist() if row["split"] == "test"}
    counts: Counter[tuple[str, str]] = Counter()
    failing = []
    for seed in (42, 43):
        score = scores_of(predictions, "full", seed)
        groups: dict[tuple[str, int], list[tuple[float, dict]]] = {}
        for row in release_tables["candidates"].to_pylist():
            if row["scene_id"] in test:
                groups.setdefault((row["scene_id"], row["target_id"]), []).append((score[row["candidate_id"]], row))
        for group in groups.values():
            if any(row["y_pipe"] for _, row in group):
                _, first = max(group, key=lambda pair: pair[0])
                counts[first["category"], first["exec_status"] or first["plan_status"]] += 1
                failing.append(not first["y_pipe"])
    rows = [row for row in report.tables["errors-first_choice"] if (row["task"], row["policy"]) == ("fixed", "ranker")]
    assert {(row["category"], row["outcome"]): row["n"] for row in rows} == counts
    assert report.metrics["test.fixed.ranker.first_choice_fails"] == pytest.approx(sum(failing) / len(failing))
    shares = [report.metrics[f"test.fixed.ranker.first_choice.{name}"] for name in {name for _, name in counts}]
    assert sum(shares) == pytest.approx(1.0)


def test_every_worst_group_has_its_command_and_films_are_said_to_be_missing(report: Report) -> None:
    rows = report.tables["errors-worst"]
    assert rows
    for row in rows:
        assert row["rank"] > 1
        assert (
            f"python -m pipelines.regenerate {row['first_id']} --release data/release/pilot --filmstrip {row['first_id']}.png"
            in report.markdown
        )
        assert len(str(row["tried"]).split()) == row["rank"] - 1
    assert "No films: no plans here." in report.markdown
    assert set(report.figures) == {"errors-first_choice-joint", "errors-first_choice-fixed"}


def test_the_worst_groups_are_told_by_object_and_by_how_few_successes_they_hold(report: Report) -> None:
    rows = [row for row in report.tables["errors-worst"] if row["task"] == "fixed"]
    n_hard = sum(row["n_success"] <= 2 for row in rows)
    (line,) = (line for line in report.markdown.splitlines() if "hold one or two successes; by object: " in line)
    assert line.startswith(f"{n_hard} of these {len(rows)} hold")
    told = dict(part.rsplit(" ", 1) for part in line.partition("by object: ")[2].removesuffix(".").split(", "))
    assert {name: int(n) for name, n in told.items()} == Counter(row["object_id"] for row in rows)


def test_errors_that_trainings_and_policies_share_are_those_of_a_count_by_hand(
    release_tables: dict[str, pa.Table], predictions: pa.Table
) -> None:
    """Two trainings of one network as `local`, one of another as `trees`, and the paper's."""
    of = {
        ("full", 42): ("local", 42),
        ("full", 43): ("local", 43),
        ("no_target_hypothesis", 42): ("trees", 42),
        ("direct", 42): ("full", 42),
    }
    rows = [row for row in predictions.to_pylist() if (row["variant"], row["seed"]) in of]
    renamed = [row | dict(zip(("variant", "seed"), of[row["variant"], row["seed"]], strict=True)) for row in rows]
    metrics = errors_report(release_tables, table_from_rows(schemas.PREDICTIONS, renamed), tier="pilot", seed=42).metrics
    test = {row["scene_id"] for row in release_tables["splits"].to_pylist() if row["split"] == "test"}
    wrong: dict[tuple[str, int], set[tuple[str, int]]] = {}
    for source, name in of.items():
        score = scores_of(predictions, *source)
        groups: dict[tuple[str, int], list[tuple[float, bool]]] = {}
        for row in release_tables["candidates"].to_pylist():
            if row["scene_id"] in test:
                groups.setdefault((row["scene_id"], row["target_id"]), []).append((score[row["candidate_id"]], bool(row["y_pipe"])))
        wrong[name] = {key for key, own in groups.items() if any(hit for _, hit in own) and not max(own)[1]}
    always = wrong["local", 42] & wrong["local", 43]
    assert always
    assert [metrics[f"test.fixed.local.n_wrong_{seed}"] for seed in (42, 43)] == [len(wrong["local", seed]) for seed in (42, 43)]
    assert metrics["test.fixed.local.n_wrong_every_training"] == len(always)
    assert metrics["test.fixed.local.n_wrong_every_training_and_trees"] == len(always & wrong["trees", 42])
    assert metrics["test.fixed.local.n_wrong_every_training_and_ranker"] == len(always & wrong["full", 42])
    assert metrics["test.fixed.n_wrong_everyone"] == len(always & wrong["trees", 42] & wrong["full", 42])
