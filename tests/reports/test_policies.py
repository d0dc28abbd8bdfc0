from __future__ import annotations

import math

import numpy as np
import polars as pl
import pyarrow as pa
import pytest

from pipelines.frames import frame_of
from reports.load import Task, candidate_frame
from reports.metrics import expected_random_success, group_ranks, success_at_k
from reports.policies import (
    FULL_PLANNER,
    GRIPPER_ONLY,
    IK_AND_GRIPPER,
    IK_ONLY,
    LEARNED,
    ORACLE,
    POLICIES,
    RANDOM,
    RANKER,
    decision_cost,
    prediction_seeds,
    ranked,
    with_predictions,
)
from reports.predictions import with_score
from reports.report import ReportError


@pytest.fixture(scope="module")
def frame(release_tables: dict[str, pa.Table], predictions: pa.Table) -> pl.DataFrame:
    return with_predictions(candidate_frame(release_tables, 42), frame_of(predictions), "full", 42)


@pytest.mark.parametrize("task", list(Task))
@pytest.mark.parametrize("policy", [*POLICIES, ORACLE], ids=lambda policy: policy.name)
def test_ranks_number_every_group_whatever_the_order_of_rows(frame: pl.DataFrame, policy: object, task: Task) -> None:
    out = ranked(frame, policy, task)  # type: ignore[arg-type]
    for _, group in out.group_by(task.group):
        assert sorted(group["rank"]) == list(range(1, group.height + 1))
    backwards = ranked(frame[::-1].sample(fraction=1.0, shuffle=True, seed=5), policy, task)  # type: ignore[arg-type]
    assert dict(out.select("candidate_id", "rank").iter_rows()) == dict(backwards.select("candidate_id", "rank").iter_rows())


@pytest.mark.parametrize("task", list(Task))
def test_the_oracle_always_succeeds_first(frame: pl.DataFrame, task: Task) -> None:
    estimate = success_at_k(group_ranks(ranked(frame, ORACLE, task), task), 1)
    assert estimate is not None
    assert estimate.value == 1.0


def reference_order(group: pl.DataFrame, policy: str) -> list[str]:
    """Each policy as its sentence says it, in plain Python."""
    rows = group.sort("hash_order").to_dicts()
    key = {
        "random": lambda row: 0,
        "ik_only": lambda row: not row["ik_feasible"],
        "gripper_only": lambda row: not row["gripper_free"],
        "ik_and_gripper": lambda row: not (row["ik_feasible"] and row["gripper_free"]),
        "full_planner": lambda row: row["plan_duration_s"] if row["y_plan"] else math.inf,
        **{learned.name: lambda row: -row["score"] for learned in LEARNED},
    }[policy]
    return [row["candidate_id"] for row in sorted(rows, key=key)]


@pytest.mark.parametrize("policy", POLICIES, ids=lambda policy: policy.name)
def test_a_policy_orders_as_its_sentence_says(frame: pl.DataFrame, policy: object) -> None:
    out = ranked(frame, policy, Task.JOINT)  # type: ignore[arg-type]
    for (scene_id,), group in out.group_by(["scene_id"]):
        expected = reference_order(frame.filter(pl.col("scene_id") == scene_id), policy.name)  # type: ignore[attr-defined]
        assert group.sort("rank")["candidate_id"].to_list() == expected


def test_a_score_is_the_sum_of_32_bit_numbers_and_ties_as_they_do() -> None:
    """In 64 bits the second would be ahead of the first by a part in a billion, whichever way the columns are held."""
    plan, execution = np.array([-1.0, -1.0, -0.25]), np.array([-2.0, -2.0 + 2.0**-30, -0.5])
    assert plan[0] + execution[0] < plan[1] + execution[1]
    for dtype in (np.float32, np.float64):
        frame = with_score(pl.DataFrame({"log_p_plan": plan.astype(dtype), "log_p_exec": execution.astype(dtype)}))
        assert frame["score"].to_list() == [-3.0, -3.0, -0.75]
        assert frame.schema["score"] == pl.Float64


def test_random_succeeds_as_often_as_chance(release_tables: dict[str, pa.Table]) -> None:
    """Mean S1 over 40 hash seeds against the closed form; the fixed-target groups are about 350 and 40 seeds make 14,000 draws."""
    values = []
    for seed in range(40):
        ranks = group_ranks(ranked(candidate_frame(release_tables, seed), RANDOM, Task.FIXED), Task.FIXED)
        estimate = success_at_k(ranks, 1)
        assert estimate is not None
        values.append(estimate.value)
    estimate = expected_random_success(ranks, 1)
    assert estimate is not None
    expected = estimate.value
    n_covered = int(ranks["first_success"].is_not_null().sum())
    assert n_covered > 300
    # Four standard errors of a binomial of that many draws.
    assert abs(sum(values) / 40 - expected) < 4 * math.sqrt(expected * (1 - expected) / (40 * n_covered))


def test_a_learned_policy_needs_every_score(frame: pl.DataFrame, predictions: pa.Table) -> None:
    with pytest.raises(ReportError, match=r"full-0000-t0-g.. has none"):
        ranked(frame.drop("score"), RANKER, Task.JOINT)
    first = str(frame["candidate_id"].min())
    unscored = frame.with_columns(pl.when(pl.col("candidate_id") == first).then(None).otherwise(pl.col("score")).alias("score"))
    with pytest.raises(ReportError, match=rf"{first} has none \(1 candidates"):
        ranked(unscored, RANKER, Task.FIXED)
    with pytest.raises(ReportError, match="variant 'full', seed 7"):
        with_predictions(frame, frame_of(predictions), "full", 7)
    assert prediction_seeds(predictions, "full") == [42, 43]
    assert prediction_seeds(None, "full") == []


@pytest.mark.parametrize("task", list(Task))
def test_a_decision_costs_what_its_candidates_cost(frame: pl.DataFrame, task: Task) -> None:
    ids = frame["candidate_id"]
    timings = pl.concat(
        pl.DataFrame({"stage": [stage] * len(ids), "item_id": ids, "core_ms": [ms] * len(ids)})
        for stage, ms in (("policy_ik", 1.0), ("policy_gripper", 10.0), ("planning_labels", 100.0))
    )
    per_group = frame.height / frame.select(task.group).n_unique()
    for policy, ms in ((IK_ONLY, 1.0), (GRIPPER_ONLY, 10.0), (IK_AND_GRIPPER, 11.0), (FULL_PLANNER, 100.0)):
        cost = decision_cost(policy, frame, timings, task)
        assert cost is not None
        assert cost.mean_ms == pytest.approx(ms * per_group)
    assert decision_cost(RANDOM, frame, timings, task) is None
    assert decision_cost(RANKER, frame, timings, task) is None
    # One candidate that was not timed, and the sum would be of something else.
    assert decision_cost(IK_ONLY, frame, timings.filter(pl.col("item_id") != ids[0]), task) is None


def test_the_ranker_is_timed_by_the_group(frame: pl.DataFrame) -> None:
    scenes = frame["scene_id"].unique().sort()[:2]
    timings = pl.DataFrame({"stage": ["ranker"] * 3, "item_id": [scenes[0], scenes[1], f"{scenes[0]}-t3"], "core_ms": [10.0, 30.0, 4.0]})
    joint, fixed = (decision_cost(RANKER, frame, timings, task) for task in (Task.JOINT, Task.FIXED))
    assert joint is not None
    assert fixed is not None
    assert (joint.mean_ms, joint.n_groups) == (20.0, 2)
    assert (fixed.mean_ms, fixed.n_groups) == (4.0, 1)
