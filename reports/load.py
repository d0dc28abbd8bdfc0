"""A release as the reports query it: tables by name, one frame of candidates, one frame of groups; no number is made here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import StrEnum
from pathlib import Path

import polars as pl
import pyarrow as pa

from pipelines.frames import frame_of
from reports.report import ReportError
from splits.manifest import ABOUT_THE_RELEASE, MEASUREMENTS
from splits.own import OBJECT_SPLIT_OF_OWN
from splits.release import REQUIRED_TABLES
from splits.release_reader import Release
from tables.identity import order_key
from tables.schemas import SPLITS
from tables.vocabulary import Split, SplitScheme

_OPTIONAL_TABLES = (*MEASUREMENTS, *ABOUT_THE_RELEASE)

_CANDIDATE_COLUMNS = (
    "candidate_id",
    "scene_id",
    "target_id",
    "grasp_id",
    "object_id",
    "category",
    "n_obstacles",
    "y_plan",
    "plan_status",
    "plan_duration_s",
    "y_pipe",
    "exec_status",
    "tolerance_margin",
)


class Task(StrEnum):
    """What is ranked together."""

    JOINT = "joint"  # all candidates of a scene
    FIXED = "fixed"  # those of one scene and one target

    @property
    def group(self) -> list[str]:
        """Columns that name a group."""
        return ["scene_id"] if self is Task.JOINT else ["scene_id", "target_id"]


def load_release(directory: Path, names: Sequence[str] | None = None) -> dict[str, pa.Table]:
    """Tables of a release folder: those named, or of those that a release has for reports all that the folder holds.

    Raises:
        ReleaseError: a folder that is no release, or without one of the tables.
    """
    release = Release.open(directory)
    if names is None:
        listed = [*REQUIRED_TABLES, *(name for name in _OPTIONAL_TABLES if name in release.manifest.tables)]
        names = [name for name in listed if name not in release.left_out]
    return release.tables(*names)


def candidate_frame(tables: Mapping[str, pa.Table], seed: int, scheme: SplitScheme = SplitScheme.SCENE) -> pl.DataFrame:
    """One row a candidate: labels, split, resting pose of its target, endpoint features, and a random order that follows from its id.

    Columns beyond those of `candidates`: `split`, `resting`, `ik_feasible`, `gripper_free`, `success` (planned and executed validly)
    and `hash_order`, which breaks every tie, so that the order of rows never decides anything.

    Args:
        tables: at least `candidates`, `splits`, `targets`, `policy_features`.
        seed: seed of the hash order.
        scheme: whose column of `splits` becomes `split`.

    Raises:
        ReportError: a candidate without split, target or features.
    """
    frame = (
        frame_of(tables["candidates"], _CANDIDATE_COLUMNS)
        .join(_splits(tables, scheme), on="scene_id", how="left")
        .join(frame_of(tables["targets"], ["scene_id", "target_id", "resting"]), on=["scene_id", "target_id"], how="left")
        .join(frame_of(tables["policy_features"]), on="candidate_id", how="left")
    )
    for column, table in (("split", "splits"), ("resting", "targets"), ("ik_feasible", "policy_features")):
        lost = frame.filter(pl.col(column).is_null())
        if not lost.is_empty():
            raise ReportError(f"{table}: {lost['candidate_id'].sort()[0]} has no row ({lost.height} candidates have none, must be 0)")
    orders = [order_key(seed, "policy_order", candidate_id) for candidate_id in frame["candidate_id"]]
    return frame.with_columns(
        (pl.col("y_plan") & pl.col("y_pipe").fill_null(False)).alias("success"),
        pl.Series("hash_order", orders, dtype=pl.Int64),
    ).sort("candidate_id")


def group_frame(tables: Mapping[str, pa.Table], task: Task, scheme: SplitScheme = SplitScheme.SCENE) -> pl.DataFrame:
    """One row a group, with or without candidates: its columns, `split`, `category`, `n_obstacles`, and `resting` for a fixed target."""
    scenes = frame_of(tables["scenes"], ["scene_id", "object_id", "category", "n_obstacles"]).join(_splits(tables, scheme), on="scene_id")
    if task is Task.JOINT:
        return scenes.sort("scene_id")
    targets = frame_of(tables["targets"], ["scene_id", "target_id", "resting"])
    return scenes.join(targets, on="scene_id").sort("scene_id", "target_id")


def check_parts(tables: Mapping[str, pa.Table], scheme: SplitScheme, needed: Sequence[Split]) -> None:
    """Raise ReportError where a split that a report needs has no scene in this release, as may be in a small tier."""
    found = set(_splits(tables, scheme)["split"].to_list())
    for split in needed:
        if split.value not in found:
            categories = ", ".join(sorted(frame_of(tables["scenes"], ["category"])["category"].unique()))
            raise ReportError(
                f"splits: 0 scenes in {split.value} of scheme {scheme.value}, must be at least 1: take a larger tier, or another split"
                f" where the catalogue has nothing for this one (the scenes here are of {categories})"
            )


def of_scheme(scheme: SplitScheme) -> str:
    """What the title of a report adds: nothing for the paper's split."""
    return "" if scheme is SplitScheme.SCENE else f", split `{scheme.value}`"


def scheme_note(scheme: SplitScheme) -> list[str]:
    """The block that stands below such a title; none for the paper's split."""
    if scheme is SplitScheme.SCENE:
        return []
    # How many objects are held out is said by the card; here it has to be true of a dataset of one's own too.
    meanings = {column.name: column.meaning for column in SPLITS.columns} | {SplitScheme.OBJECT.column: OBJECT_SPLIT_OF_OWN}
    return [
        f"> **Split `{scheme.column}`**: {meanings[scheme.column]}. Figures of the paper are of its split by scene, where"
        " every object, category and obstacle count is trained on: what a split decides has none of them beside it."
    ]


def _splits(tables: Mapping[str, pa.Table], scheme: SplitScheme) -> pl.DataFrame:
    return frame_of(tables["splits"], ["scene_id", scheme.column]).rename({scheme.column: "split"})
