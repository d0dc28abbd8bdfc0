"""Whether the ranker knows that a group holds no success at all; how well it orders a group that does is reported by success_at_k.py."""

from __future__ import annotations

import numpy as np
import polars as pl

from reports import paper
from reports.load import Task
from reports.metrics import Recalls, auroc, best_threshold, recalls
from splits.markdown import table
from tables.vocabulary import SplitScheme


def solvability_section(candidates: pl.DataFrame, scheme: SplitScheme = SplitScheme.SCENE) -> tuple[list[str], dict[str, float]]:
    """Markdown blocks and metrics: groups scored by their largest p_succ, the threshold chosen on the validation split.

    A group without candidates has no score and is left out: nothing needs to be predicted about it.

    Args:
        candidates: candidate frame with `score`.
        scheme: whose splits they are; the paper's rows stand below ours for its own only.
    """
    rows, metrics = [], {}
    for task in Task:
        scores, labels = _groups(candidates, task, "test")
        threshold = best_threshold(*_groups(candidates, task, "validation"))
        area = auroc(scores, labels)
        recall = None if threshold is None else recalls(scores, labels, threshold)
        rows.append(_row(f"{task.value}, ours", len(labels), int(labels.sum()), area, recall, threshold))
        rows += [_paper_row(task)] if scheme is SplitScheme.SCENE else []
        prefix = f"test.{task.value}.solvability"
        if area is not None:
            metrics[f"{prefix}.auroc"] = area
        if recall is not None:
            metrics[f"{prefix}.balanced_accuracy"] = recall.balanced_accuracy
    header = ["task", "groups", "solvable", "unsolvable", "AUROC", "balanced accuracy", "recall solvable", "recall unsolvable", "threshold"]
    text = (
        "A group's score is the largest predicted success probability in it. The threshold is the one with the best balanced accuracy on"
        f" the validation split. A dash means that a split lacks one of the two kinds of group. Paper: {paper.SOLVABILITY_SOURCE}."
    )
    return ["## Solvability, test split", text, table(header, rows)], metrics


def _groups(candidates: pl.DataFrame, task: Task, split: str) -> tuple[np.ndarray, np.ndarray]:
    groups = (
        candidates.filter(pl.col("split") == split)
        .group_by(task.group)
        .agg(pl.col("score").max().exp().alias("p_max"), pl.col("success").any())
        .sort(task.group)
    )
    return groups["p_max"].to_numpy(), groups["success"].to_numpy()


def _row(label: str, n: int, n_true: int, area: float | None, recall: Recalls | None, threshold: float | None) -> list[object]:
    percentages = [area, *((recall.balanced_accuracy, recall.recall_true, recall.recall_false) if recall else (None, None, None))]
    cells = [None if value is None else f"{100 * value:.2f}" for value in percentages]
    return [label, f"{n:,}", f"{n_true:,}", f"{n - n_true:,}", *cells, None if threshold is None else f"{threshold:.3f}"]


def _paper_row(task: Task) -> list[object]:
    theirs = paper.SOLVABILITY[task]
    percentages = (theirs.auroc, theirs.balanced_accuracy, theirs.recall_solvable, theirs.recall_unsolvable)
    cells = [None if value is None else f"{value:.2f}" for value in percentages]
    n = theirs.n_solvable + theirs.n_unsolvable
    return [f"{task.value}, paper", f"{n:,}", f"{theirs.n_solvable:,}", f"{theirs.n_unsolvable:,}", *cells, None]
