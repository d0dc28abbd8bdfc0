"""Report that sets the shards of a tier side by side: yields of every shard, and which of them stand out.

Scenes are dealt to shards by number, so that every shard is a sample of the same recipe: one that stands out hints at a fault in how it
was made (another engine version, a damaged file, a worker that ran out of memory) before it hints at anything about robots.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import polars as pl
import pyarrow as pa
from jaxtyping import Float

from pipelines.frames import frame_of
from reports.report import Report, ReportError
from splits.markdown import percent, table
from tables.layout import Layout
from tables.vocabulary import LiftStatus

# The tables of a shard that the report reads.
SHARD_TABLES = ("scenes", "targets", "pick_lift", "candidate_pairs", "planning_labels", "execution_labels")

# What is compared, with the heading of its column.
MEASURES = {
    "lifted": "lifted of admitted grasps",
    "planned": "planned of candidates",
    "succeeded": "success of planned",
    "candidates_per_scene": "candidates a scene",
    "coverage": "fixed-target groups with a success",
}

# Iglewicz and Hoaglin, How to Detect and Handle Outliers (1993): modified z-scores, 0.6745 being the upper quartile of a standard normal
# deviate and 1.2533 its standard deviation over its mean absolute deviation.
Z_LIMIT = 3.5
_QUARTILE, _DEVIATION_OVER_MEAN_ABSOLUTE = 0.6745, 1.2533
# Among fewer, median and deviation are too uncertain to call any shard an outlier.
MIN_SHARDS = 8

RULE = (
    f"The robust z-score of a shard is {_QUARTILE} (x - median) / MAD, median and MAD (median absolute deviation from the median) over the"
    f" shards of the tier; where MAD is 0, it is (x - median) over {_DEVIATION_OVER_MEAN_ABSOLUTE} mean absolute deviations. A shard is"
    f" flagged (**bold**) where |z| > {Z_LIMIT} (Iglewicz and Hoaglin, 1993). Below {MIN_SHARDS} shards nothing is flagged."
)


def shard_diagnostics_report(tables: Mapping[str, pa.Table], *, tier: str, layout: Layout) -> Report:
    """Report `shard_diagnostics`.

    Args:
        tables: `SHARD_TABLES` by name, each over all shards of the tier.
        tier: printed in the title.
        layout: says which shard a scene is of.

    Raises:
        ReportError: a table is missing or there are no scenes.
    """
    frame = shard_frame(tables, layout)
    scores = {name: robust_z(frame[name].to_list()) for name in MEASURES}
    flagged = [(shard, name, z) for name in MEASURES for shard, z in zip(frame["shard"], scores[name], strict=True) if abs(z) > Z_LIMIT]
    metrics = {"n_shards": float(frame.height), "n_flagged": float(len({shard for shard, _, _ in flagged}))}
    for name in MEASURES:
        known = frame[name].drop_nulls().to_numpy()
        if len(known):
            summary = {"median": np.median(known), "min": known.min(), "max": known.max()}
            metrics |= {f"{name}.{what}": float(value) for what, value in summary.items()}
    blocks = [f"# Shards of tier {tier}", RULE, "## Shards that stand out", _flagged(flagged, frame.height)]
    return Report("shard_diagnostics", "\n\n".join([*blocks, "## Every shard", _table(frame, scores)]) + "\n", {}, metrics)


def shard_frame(tables: Mapping[str, pa.Table], layout: Layout) -> pl.DataFrame:
    """One row a shard, sorted: `shard`, `n_scenes` and `MEASURES`; a share of nothing is null."""
    missing = sorted(set(SHARD_TABLES) - set(tables))
    if missing:
        raise ReportError(f"{missing[0]}: missing, the report reads {list(SHARD_TABLES)}")
    scenes = frame_of(tables["scenes"], ["scene_id"])
    if scenes.is_empty():
        raise ReportError("scenes: 0 rows, must be at least 1")
    candidates = (
        frame_of(tables["candidate_pairs"], ["candidate_id", "scene_id", "target_id"])
        .join(frame_of(tables["planning_labels"], ["candidate_id", "y_plan"]), on="candidate_id", how="left")
        .join(frame_of(tables["execution_labels"], ["candidate_id", "y_pipe"]), on="candidate_id", how="left")
    )
    lifts = frame_of(tables["pick_lift"], ["scene_id", "lift_status"]).with_columns(lifted=pl.col("lift_status") == LiftStatus.LIFTED.value)
    covered = candidates.group_by("scene_id", "target_id").agg(covered=pl.col("y_pipe").any())
    groups = frame_of(tables["targets"], ["scene_id", "target_id"]).join(covered, on=["scene_id", "target_id"], how="left")
    per_scene = scenes.join(candidates.group_by("scene_id").agg(n=pl.len()), on="scene_id", how="left")
    parts = (
        _by_shard(per_scene, layout).agg(n_scenes=pl.len(), candidates_per_scene=pl.col("n").fill_null(0).mean()),
        _by_shard(lifts, layout).agg(pl.col("lifted").mean()),
        _by_shard(candidates, layout).agg(planned=pl.col("y_plan").mean(), succeeded=pl.col("y_pipe").mean()),
        _by_shard(groups, layout).agg(coverage=pl.col("covered").fill_null(False).mean()),
    )
    frame = parts[0]
    for part in parts[1:]:
        frame = frame.join(part, on="shard", how="left")
    return frame.select("shard", "n_scenes", *MEASURES).sort("shard")


def robust_z(values: Sequence[float | None]) -> Float[np.ndarray, "n"]:
    """Robust z-scores by `RULE`; 0 for None, where all values are equal, and where there are too few."""
    x = np.array([np.nan if value is None else value for value in values], dtype=np.float64)
    known = x[np.isfinite(x)]
    if len(known) < MIN_SHARDS:
        return np.zeros(len(x))
    from_median = np.abs(known - np.median(known))
    scale = np.median(from_median) / _QUARTILE or _DEVIATION_OVER_MEAN_ABSOLUTE * from_median.mean()
    return np.nan_to_num((x - np.median(known)) / scale) if scale else np.zeros(len(x))


def _by_shard(frame: pl.DataFrame, layout: Layout) -> pl.dataframe.group_by.GroupBy:
    shard_of = {scene_id: layout.shard_of_scene(scene_id) for scene_id in frame["scene_id"].unique()}
    return frame.with_columns(shard=pl.col("scene_id").cast(pl.String).replace_strict(shard_of, return_dtype=pl.String)).group_by("shard")


def _flagged(flagged: Sequence[tuple[str, str, float]], n_shards: int) -> str:
    if n_shards < MIN_SHARDS:
        return f"Too few to say: {n_shards}, at least {MIN_SHARDS} are needed."
    rows = [[f"`{shard}`", MEASURES[name], f"{z:+.1f}"] for shard, name, z in sorted(flagged)]
    return table(["shard", "measure", "z"], rows) if rows else f"None of {n_shards}."


def _table(frame: pl.DataFrame, scores: Mapping[str, Float[np.ndarray, "n"]]) -> str:
    rows = []
    for k, row in enumerate(frame.iter_rows(named=True)):
        cells = [f"{_shown(name, row[name])} ({scores[name][k]:+.1f})" for name in MEASURES]
        marked = [f"**{cell}**" if abs(scores[name][k]) > Z_LIMIT else cell for name, cell in zip(MEASURES, cells, strict=True)]
        rows.append([f"`{row['shard']}`", row["n_scenes"], *marked])
    return table(["shard", "scenes", *(f"{heading} (z)" for heading in MEASURES.values())], rows)


def _shown(name: str, value: float | None) -> str:
    return percent(value) if name != "candidates_per_scene" or value is None else f"{value:.1f}"
