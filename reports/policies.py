"""The policies that order a group, and what a decision costs them; how good an order is, is measured in metrics.py.

A policy sorts by columns of the candidates; what is still tied is tried in the hash order of the candidates, never in row order.
"""

from __future__ import annotations

from dataclasses import dataclass

import polars as pl
import pyarrow as pa

from reports.load import Task
from reports.predictions import seeds_of_variants, with_score
from reports.report import ReportError


@dataclass(frozen=True, slots=True, eq=False)
class Policy:
    """One policy: sorts by `keys`, smaller first.

    `variant` is that of the rows of `predictions` that score it; without one nothing is learned. `candidate_stages` are the timed stages
    that it must run for every candidate of a group before it can order it, `group_stage` the one that it runs once a group. Without
    either it computes nothing.
    """

    name: str
    label: str
    keys: tuple[pl.Expr, ...]
    candidate_stages: tuple[str, ...] = ()
    group_stage: str = ""
    variant: str = ""

    @property
    def is_learned(self) -> bool:
        """Whether it orders by predictions."""
        return bool(self.variant)

    @property
    def is_free(self) -> bool:
        """Whether it orders without computing anything."""
        return not self.candidate_stages and not self.group_stage


def _passed(*columns: str) -> pl.Expr:
    return pl.all_horizontal(*columns).not_()


RANDOM = Policy("random", "Random (hash order)", ())
IK_ONLY = Policy("ik_only", "IK only", (_passed("ik_feasible"),), ("policy_ik",))
GRIPPER_ONLY = Policy("gripper_only", "Detached gripper collision", (_passed("gripper_free"),), ("policy_gripper",))
IK_AND_GRIPPER = Policy(
    "ik_and_gripper", "IK + gripper collision", (_passed("ik_feasible", "gripper_free"),), ("policy_ik", "policy_gripper")
)
FULL_PLANNER = Policy(
    "full_planner",
    "Full-pool planner",
    (pl.col("y_plan").not_(), pl.col("plan_duration_s").fill_null(float("inf"))),
    ("planning_labels",),
)
RANKER = Policy("ranker", "Paper's ranker", (-pl.col("score"),), group_stage="ranker", variant="full")
LOCAL = Policy("local", "Local ranker", (-pl.col("score"),), group_stage="local", variant="local")
TREES = Policy("trees", "Trees, derived geometry", (-pl.col("score"),), group_stage="trees", variant="trees")
TREES_POSES = Policy("trees_poses", "Trees, raw poses", (-pl.col("score"),), variant="trees_poses")
POSE_ONLY = Policy("pose_only", "Pose-only network", (-pl.col("score"),), group_stage="pose_only", variant="pose_only")

UNLEARNED = (RANDOM, IK_ONLY, GRIPPER_ONLY, IK_AND_GRIPPER, FULL_PLANNER)
LEARNED = (RANKER, LOCAL, TREES, TREES_POSES, POSE_ONLY)
POLICIES = (*UNLEARNED, *LEARNED)

# Not policies that anyone could or should use, but bounds and parts of one.
PLAN_HEAD_ONLY = Policy("plan_head_only", "Paper's ranker, p_plan alone", (-pl.col("log_p_plan"),), group_stage="ranker", variant="full")
ORACLE = Policy("oracle", "Oracle", (pl.col("success").not_(),))


def ranked(frame: pl.DataFrame, policy: Policy, task: Task) -> pl.DataFrame:
    """Candidates with their `rank` in their group, 1 first.

    Args:
        frame: a candidate frame, with `score` and `log_p_plan` where the policy is learned.
        policy: what orders it.
        task: what a group is.

    Raises:
        ReportError: a learned policy and candidates without a prediction.
    """
    if policy.is_learned:
        unscored = frame if "score" not in frame.columns else frame.filter(pl.col("score").is_null())
        if not unscored.is_empty():
            raise ReportError(f"predictions: {unscored['candidate_id'].sort()[0]} has none ({unscored.height} candidates, must be 0)")
    ordered = frame.sort([*map(pl.col, task.group), *policy.keys, pl.col("hash_order"), pl.col("candidate_id")])
    return ordered.with_columns(pl.int_range(1, pl.len() + 1).over(task.group).alias("rank"))


def with_predictions(frame: pl.DataFrame, predictions: pl.DataFrame, variant: str, seed: int) -> pl.DataFrame:
    """Candidates with `score`, `log_p_plan` and `log_p_exec` of one training of a variant; null where it did not score them."""
    own = predictions.filter((pl.col("variant") == variant) & (pl.col("seed") == seed)).drop("variant", "seed")
    if own.is_empty():
        raise ReportError(f"predictions: 0 rows of variant {variant!r}, seed {seed}, must be at least 1")
    return frame.join(with_score(own), on="candidate_id", how="left").sort("candidate_id")


def prediction_seeds(predictions: pa.Table | None, variant: str) -> list[int]:
    """Training seeds of a variant, sorted; none without predictions."""
    return [] if predictions is None else seeds_of_variants(predictions).get(variant, [])


@dataclass(frozen=True, slots=True)
class DecisionCost:
    """Mean time until a group is ordered, and how many groups it was measured on."""

    mean_ms: float
    n_groups: int


def decision_cost(policy: Policy, candidates: pl.DataFrame, timings: pl.DataFrame, task: Task) -> DecisionCost | None:
    """What ordering a group costs; None where a policy computes nothing or was not measured.

    A policy that judges candidates pays for every candidate of a group, so it must have been timed on all of them. Rankers are timed by
    the group (items `<scene_id>` and `<scene_id>-t<target_id>`), on a sample of them if need be.

    Args:
        candidates: the candidates of the groups in question, any order.
        timings: frame of `timings`.
    """
    n_groups = candidates.select(task.group).n_unique()
    if policy.group_stage:
        name = pl.col("scene_id") if task is Task.JOINT else pl.format("{}-t{}", "scene_id", "target_id")
        items = candidates.select(name.alias("item_id")).unique()
        timed = items.join(timings.filter(pl.col("stage") == policy.group_stage), on="item_id")
        return DecisionCost(float(timed["core_ms"].sum()) / timed.height, timed.height) if timed.height else None
    if policy.is_free or not n_groups:
        return None
    total_ms = 0.0
    for stage in policy.candidate_stages:
        own = timings.filter(pl.col("stage") == stage).select(pl.col("item_id").alias("candidate_id"), "core_ms")
        timed = candidates.select("candidate_id").join(own, on="candidate_id")
        if timed.height < candidates.height:
            return None
        total_ms += float(timed["core_ms"].sum())
    return DecisionCost(total_ms / n_groups, n_groups)
