"""What the pages show of a release beside its reports: the ladder, objects, scenes and a sample of candidates; counted, not judged."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import polars as pl

from pipelines.frames import frame_of
from reports import paper
from reports.load import Task
from reports.policies import FULL_PLANNER, LOCAL, ORACLE, PLAN_HEAD_ONLY, POLICIES, RANKER, Policy
from reports.ranking import KS
from splits.release_reader import Release
from tables.identity import order_key

MAX_CANDIDATES = 5000
_BROWSED = (
    "candidate_id",
    "object_id",
    "category",
    "n_obstacles",
    "resting",
    "split",
    "plan_status",
    "exec_status",
    "final_position_error_m",
)


_EXPLAINED = {
    FULL_PLANNER: "The full-pool planner plans every candidate before it chooses, and knows nothing of what slips",
    RANKER: "The paper's ranker is its network, trained on these data: it orders by the probability of a plan (p_plan)"
    " times that of success if it is",
    PLAN_HEAD_ONLY: "“p_plan alone” is the same network, ordering by the first of the two",
    LOCAL: "The local ranker is ours: it looks at what the hand of a candidate meets",
    ORACLE: "The oracle knows every label: no policy can do better",
}


@dataclass(frozen=True, slots=True)
class Rung:
    """One policy on one task: S_K and its 95 % interval in percent, by K; the S1 that the paper reports of it, if it does."""

    label: str
    s: Mapping[int, tuple[float, float, float]]
    paper_s1: float | None


def ladder(metrics: Mapping[str, float], split: str, task: Task) -> list[Rung]:
    """The policies of report `success_at_k` on a split, from its metrics; those without numbers are left out."""
    rungs = []
    for policy in (*POLICIES, PLAN_HEAD_ONLY, ORACLE):
        prefix = f"{split}.{task.value}.{policy.name}"
        s = {k: tuple(metrics.get(f"{prefix}.s{k}{end}") for end in ("", "_low", "_high")) for k in KS}
        whole = {k: (100 * a, 100 * b, 100 * c) for k, (a, b, c) in s.items() if a is not None and b is not None and c is not None}
        if len(whole) == len(KS):
            rungs.append(Rung(policy.label, whole, _paper_s1(policy, task)))
    return rungs


def policies_explained(labels: Collection[str]) -> str:
    """A line on those of some policies whose names do not say what they do; "" for none."""
    texts = [text for policy, text in _EXPLAINED.items() if policy.label in labels]
    return " ".join(f"{text}." for text in texts)


def _paper_s1(policy: Policy, task: Task) -> float | None:
    if policy is PLAN_HEAD_ONLY:
        return paper.PLAN_HEAD_S1[task]
    theirs = paper.RANKING.get((task, policy.name))
    return None if theirs is None else theirs.s1


def objects(release: Release) -> pl.DataFrame:
    """One row an object: size, mass, parts, resting poses, pool grasps, and how often a candidate of it succeeds, as far as tables say."""
    counts = {
        name: frame_of(release.table(name), ["object_id"]).group_by("object_id").agg(pl.len().alias(name))
        for name in ("object_parts", "stable_poses", "grasp_pool")
        if name in release.manifest.tables
    }
    frame = frame_of(release.table("objects"))
    for name in ("object_parts", "stable_poses", "grasp_pool"):
        known = name in counts
        frame = frame.join(counts[name], on="object_id", how="left") if known else frame.with_columns(pl.lit(None, pl.UInt32).alias(name))
    labels = _labelled(release).group_by("object_id").agg(_COUNTS)
    return frame.join(labels, on="object_id", how="left").sort("object_id")


def scenes(release: Release) -> pl.DataFrame:
    """One row a scene: object, obstacles, split, candidates, plans and successes."""
    frame = frame_of(release.table("scenes"), ["scene_id", "object_id", "category", "n_obstacles"])
    splits = frame_of(release.table("splits"), ["scene_id", "split"])
    labels = _labelled(release).group_by("scene_id").agg(_COUNTS)
    return frame.join(splits, on="scene_id").join(labels, on="scene_id", how="left").sort("scene_id")


def browsed(release: Release, seed: int, always: frozenset[str]) -> pl.DataFrame:
    """At most `MAX_CANDIDATES` candidates, the first by the hash of their ids, and those that are always to be there.

    Args:
        seed: of the hash.
        always: ids of candidates that there are films of.
    """
    targets = frame_of(release.table("targets"), ["scene_id", "target_id", "resting"])
    frame = release.candidates.join(targets, on=["scene_id", "target_id"], how="left").select(_BROWSED)
    if frame.height > MAX_CANDIDATES:
        orders = pl.Series("order", [order_key(seed, "site", name) for name in frame["candidate_id"]], dtype=pl.Int64)
        is_filmed = pl.col("candidate_id").is_in(sorted(always))
        frame = frame.with_columns(orders).sort(~is_filmed, "order").head(MAX_CANDIDATES).drop("order")
    return frame.sort("candidate_id")


def browser_data(frame: pl.DataFrame, films: Mapping[str, Sequence[tuple[str, str]]], command: str) -> dict[str, Any]:
    """Candidates as the script reads them: text columns as numbers into lists of words, errors in tenths of millimetres.

    Args:
        films: what is to be seen of a candidate, names and paths in the site, by its id.
        command: what makes a candidate again, `ID` in place of its id.
    """
    words: dict[str, list[str]] = {}
    columns: dict[str, list[int | None]] = {}
    for name in ("object_id", "resting", "split", "plan_status", "exec_status"):
        words[name] = sorted(frame[name].drop_nulls().unique().to_list())
        columns[name] = [None if value is None else words[name].index(value) for value in frame[name]]
    errors = frame["final_position_error_m"].to_list()
    return {
        "ids": frame["candidate_id"].to_list(),
        "words": words,
        "columns": {**columns, "n_obstacles": frame["n_obstacles"].to_list()},
        "errors": [None if value is None else round(1e4 * value) for value in errors],
        "films": films,
        "command": command,
    }


_COUNTS = (
    pl.len().alias("candidates"),
    pl.col("y_plan").sum().alias("planned"),
    pl.col("success").sum().alias("successes"),
)


def _labelled(release: Release) -> pl.DataFrame:
    frame = frame_of(release.table("candidates"), ["candidate_id", "scene_id", "object_id", "y_plan", "y_pipe"])
    return frame.with_columns((pl.col("y_plan") & pl.col("y_pipe").fill_null(False)).alias("success"))
