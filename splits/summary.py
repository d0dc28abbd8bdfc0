"""The numbers that the texts of a release state about it, counted in its tables; what is said with them is in statements.py."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import polars as pl
import pyarrow as pa

from pipelines.frames import frame_of
from splits.confidence import count_flips
from tables.vocabulary import AdmissionStatus, Category, LiftStatus, Perturbation, Split

_IS_FRESH = pl.col("perturbation") == Perturbation.FRESH.value


@dataclass(frozen=True, slots=True)
class Part:
    """Counts of some of the candidates; `n_valid` counts those with both labels true."""

    n_scenes: int
    n_candidates: int
    n_planned: int
    n_valid: int


@dataclass(frozen=True, slots=True)
class Summary:
    """Counts of a release.

    Attributes:
        n_used_objects: objects that a scene holds, of `n_objects` in the catalogue.
        n_pool_grasps: rows of `grasps`: pool grasps of each scene's object.
        obstacle_counts: numbers of obstacles that a scene has.
        n_repeats: repeats in a fresh process, `n_identical` of which are bit-identical; 0 without `attempts`.
        n_attempts: repeats under a changed simulation of candidates with a plan, `n_flips` of which flip success; 0 without `attempts`.
    """

    n_objects: int
    n_used_objects: int
    n_targets: int
    n_pool_grasps: int
    n_admitted: int
    n_lifted: int
    obstacle_counts: tuple[int, ...]
    whole: Part
    by_split: dict[str, Part]
    by_category: dict[str, Part]
    n_repeats: int
    n_identical: int
    n_attempts: int
    n_flips: int


def summary_of(tables: Mapping[str, pa.Table]) -> Summary:
    """Count in the tables of a release; heavy ones are not looked at."""
    scenes, grasps, candidates = (frame_of(tables[name]) for name in ("scenes", "grasps", "candidates"))
    scenes = scenes.join(frame_of(tables["splits"]).select("scene_id", "split"), on="scene_id")
    joined = candidates.join(scenes.select("scene_id", "split"), on="scene_id")
    attempts = frame_of(tables["attempts"]) if "attempts" in tables else None
    n_flips, n_attempts = (0, 0) if attempts is None else count_flips(candidates, attempts)
    repeats = pl.Series(dtype=pl.Boolean) if attempts is None else attempts.filter(_IS_FRESH)["is_identical"]
    return Summary(
        n_objects=tables["objects"].num_rows,
        n_used_objects=scenes["object_id"].n_unique(),
        n_targets=tables["targets"].num_rows,
        n_pool_grasps=grasps.height,
        n_admitted=int((grasps["admission_status"] == AdmissionStatus.ADMITTED.value).sum()),
        n_lifted=int((grasps["lift_status"] == LiftStatus.LIFTED.value).sum()),
        obstacle_counts=tuple(sorted(scenes["n_obstacles"].unique().to_list())),
        whole=_part(scenes, joined),
        by_split={split.value: _part_where(scenes, joined, "split", split.value) for split in Split},
        by_category={
            category.value: _part_where(scenes, joined, "category", category.value)
            for category in Category
            if (scenes["category"] == category.value).any()
        },
        n_repeats=len(repeats),
        n_identical=int(repeats.sum()),
        n_attempts=n_attempts,
        n_flips=n_flips,
    )


def _part_where(scenes: pl.DataFrame, candidates: pl.DataFrame, column: str, value: str) -> Part:
    return _part(scenes.filter(pl.col(column) == value), candidates.filter(pl.col(column) == value))


def _part(scenes: pl.DataFrame, candidates: pl.DataFrame) -> Part:
    valid = candidates["y_plan"] & candidates["y_pipe"].fill_null(False)
    return Part(scenes.height, candidates.height, int(candidates["y_plan"].sum()), int(valid.sum()))
