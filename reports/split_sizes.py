"""How large train, validation and test are under a split scheme: rows and a figure of the profile."""

from __future__ import annotations

from collections.abc import Mapping

import polars as pl

from reports import paper
from reports.figures import counts_figure
from reports.load import Task
from splits.markdown import share
from tables.vocabulary import Split, SplitScheme


def size_rows(frame: pl.DataFrame, scheme: SplitScheme) -> list[list[object]]:
    """Candidates of each split beside the paper's, which has them for its own scheme only.

    Args:
        frame: a candidate frame.
        scheme: whose splits it has.
    """
    rows: list[list[object]] = []
    n_paper = sum(paper.N_CANDIDATES.values())
    for split in Split:
        n = frame.filter(pl.col("split") == split.value).height
        in_paper = share(paper.N_CANDIDATES[split.value], n_paper) if scheme is SplitScheme.SCENE else None
        rows.append([f"candidates of {split.value}", share(n, frame.height), in_paper])
    return rows


def splits_figure(frame: pl.DataFrame, groups: Mapping[Task, pl.DataFrame], of: str) -> bytes:
    """PNG of scenes, fixed-target groups and candidates of each split; `of` is said in the title."""
    counts = {
        split.value: {
            "scenes": groups[Task.JOINT].filter(pl.col("split") == split.value).height,
            "fixed-target groups": groups[Task.FIXED].filter(pl.col("split") == split.value).height,
            "candidates": frame.filter(pl.col("split") == split.value).height,
        }
        for split in Split
    }
    return counts_figure(counts, f"Splits of {of}", "number (log scale)")
