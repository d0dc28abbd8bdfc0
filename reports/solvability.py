"""Whether the ranker knows that a group holds no success at all; how well it orders a group that does is reported by success_at_k.py."""

from __future__ import annotations

from collections.abc import Mapping

import polars as pl

from reports import paper
from reports.entries import flat
from reports.load import Task
from reports.metrics import Recalls, best_threshold, recalls
from reports.policies import Policy
from reports.resampling import SceneBootstrap, auroc_draws
from splits.markdown import table
from tables.vocabulary import SplitScheme


def solvability_section(
    frames: Mapping[Policy, pl.DataFrame], seed: int, scheme: SplitScheme = SplitScheme.SCENE
) -> tuple[list[str], dict[str, float]]:
    """Markdown blocks and metrics: groups scored by their largest p_succ, the threshold chosen on the validation split.

    A group without candidates has no score and is left out: nothing needs to be predicted about it.

    Args:
        frames: candidate frames with `score`, by policy.
        seed: of the resampling.
        scheme: whose splits they are; the paper's rows stand below ours for its own only.
    """
    rows: list[list[object]] = []
    metrics: dict[str, float] = {}
    for task in Task:
        for policy, candidates in frames.items():
            test, validation = _groups(candidates, task, "test"), _groups(candidates, task, "validation")
            scores, labels = test["p_max"].to_numpy(), test["success"].to_numpy()
            threshold = best_threshold(validation["p_max"].to_numpy(), validation["success"].to_numpy())
            bootstrap = SceneBootstrap(test["scene_id"].to_list(), seed)
            area = auroc_draws(scores, labels, bootstrap)
            shown = None if area is None else str(area.estimate()) if bootstrap.is_telling else f"{100 * area.value:.1f}"
            recall = None if threshold is None else recalls(scores, labels, threshold)
            rows.append(_row(f"{task.value}, {policy.label}", len(labels), int(labels.sum()), shown, recall, threshold))
            prefix = f"test.{task.value}.{policy.name}.solvability"
            if area is not None:
                metrics |= flat(f"{prefix}.auroc", area.estimate()) if bootstrap.is_telling else {f"{prefix}.auroc": area.value}
            if recall is not None:
                metrics[f"{prefix}.balanced_accuracy"] = recall.balanced_accuracy
        rows += [_paper_row(task)] if scheme is SplitScheme.SCENE else []
    header = [
        "", "groups", "solvable", "unsolvable", "AUROC [95 %]", "balanced accuracy", "recall solvable", "recall unsolvable",
        "threshold",
    ]  # fmt: skip
    text = (
        "A group's score is the largest predicted success probability in it, of one designated training. The threshold is the one with the"
        " best balanced accuracy on the validation split. A dash means that a split lacks one of the two kinds of group. Paper:"
        f" {paper.SOLVABILITY_SOURCE}."
    )
    return ["## Solvability, test split", text, table(header, rows)], metrics


def _groups(candidates: pl.DataFrame, task: Task, split: str) -> pl.DataFrame:
    return (
        candidates.filter(pl.col("split") == split)
        .group_by(task.group)
        .agg(pl.col("score").max().exp().alias("p_max"), pl.col("success").any())
        .sort(task.group)
    )


def _row(label: str, n: int, n_true: int, area: str | None, recall: Recalls | None, threshold: float | None) -> list[object]:
    percentages = (recall.balanced_accuracy, recall.recall_true, recall.recall_false) if recall else (None, None, None)
    cells = [None if value is None else f"{100 * value:.2f}" for value in percentages]
    return [label, f"{n:,}", f"{n_true:,}", f"{n - n_true:,}", area, *cells, None if threshold is None else f"{threshold:.3f}"]


def _paper_row(task: Task) -> list[object]:
    theirs = paper.SOLVABILITY[task]
    percentages = (theirs.auroc, theirs.balanced_accuracy, theirs.recall_solvable, theirs.recall_unsolvable)
    cells = [None if value is None else f"{value:.2f}" for value in percentages]
    n = theirs.n_solvable + theirs.n_unsolvable
    return [f"{task.value}, paper", f"{n:,}", f"{theirs.n_solvable:,}", f"{theirs.n_unsolvable:,}", *cells, None]
