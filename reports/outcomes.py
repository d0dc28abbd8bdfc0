"""Section `Outcomes` of the profile: how many grasps and candidates are left after each stage, and what became of the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import polars as pl

from reports.figures import funnel_figure, status_figure
from splits.markdown import count, percent, share, table
from tables.vocabulary import AdmissionStatus, Category, ExecStatus, LiftStatus, PlanStatus

MIN_LIFTED_SHARE = 0.75  # of an object's admitted grasps; a pool that lifts less asks for a reason


def outcomes_section(frame: pl.DataFrame, grasps: pl.DataFrame, tier: str) -> tuple[list[str], dict[str, bytes]]:
    """Markdown blocks and figures by stem: what each stage leaves, its statuses by category, and every object's shares.

    Args:
        frame: candidate frame.
        grasps: `grasps` with `scene_id`, `object_id`, `category`, `admission_status` and `lift_status`.
        tier: printed in the titles.
    """
    admitted = grasps.filter(pl.col("admission_status") == AdmissionStatus.ADMITTED.value)
    lifted = admitted.filter(pl.col("lift_status") == LiftStatus.LIFTED.value)
    planned = frame.filter("y_plan")
    stages = [
        ("pool grasps in scenes", grasps.height, "grasps"),
        ("admitted", admitted.height, "grasps"),
        ("lifted", lifted.height, "grasps"),
        ("with every target", frame.height, "candidates"),
        ("planned", planned.height, "candidates"),
        ("success", int(frame["success"].sum()), "candidates"),
    ]
    blocks = ["## Outcomes", f"![What is left after each stage of {tier}](profile-funnel.png)"]
    figures = {"profile-funnel": funnel_figure(stages, f"From grasps to successes, {tier}")}
    for column, statuses, good, rows, of in (
        ("admission_status", AdmissionStatus, AdmissionStatus.ADMITTED, grasps, "pool grasps in scenes"),
        ("lift_status", LiftStatus, LiftStatus.LIFTED, admitted, "admitted grasps"),
        ("plan_status", PlanStatus, PlanStatus.SOLVED, frame, "candidates"),
        ("exec_status", ExecStatus, ExecStatus.SUCCESS, planned, "planned candidates"),
    ):
        names = [status.value for status in statuses]
        counts = _status_counts(rows, column)
        blocks.append(f"### `{column}` of {of}")
        blocks.append(_status_table(counts, column, names))
        stem = f"profile-{column}"
        figures[stem] = status_figure(counts, names, good.value, f"{column} of {of}, {tier}")
        blocks.append(f"![{column} by category]({stem}.png)")
    return [*blocks, "### By object", *_hard_to_lift(admitted), _objects_table(frame, grasps)], figures


def _status_counts(rows: pl.DataFrame, column: str) -> dict[str, dict[str, int]]:
    """Number of each status, all together and by category."""
    counts = {"all": dict(rows.group_by(column).len().iter_rows())}
    for category in Category:
        own = rows.filter(pl.col("category") == category.value)
        if not own.is_empty():
            counts[category.value] = dict(own.group_by(column).len().iter_rows())
    return counts


def _status_table(counts: Mapping[str, Mapping[str, int]], column: str, statuses: Sequence[str]) -> str:
    totals = {label: sum(row.values()) for label, row in counts.items()}
    rows = [[f"`{status}`", *(share(row.get(status, 0), totals[label]) for label, row in counts.items())] for status in statuses]
    failed = [sum(n for status, n in row.items() if status != statuses[0]) for row in counts.values()]
    if column == "exec_status":
        rows.append(["*any failure*", *(share(n, total) for n, total in zip(failed, totals.values(), strict=True))])
    return table([column, *(f"{label} ({total:,})" for label, total in totals.items())], rows)


def _objects_table(frame: pl.DataFrame, grasps: pl.DataFrame) -> str:
    rows: list[list[object]] = []
    for object_id in sorted(grasps["object_id"].unique()):
        own = grasps.filter(pl.col("object_id") == object_id)
        admitted = own.filter(pl.col("admission_status") == AdmissionStatus.ADMITTED.value)
        candidates = frame.filter(pl.col("object_id") == object_id)
        planned = candidates.filter("y_plan")
        rows.append(
            [
                f"`{object_id}`",
                own["scene_id"].n_unique(),
                f"{admitted.height / max(1, own['scene_id'].n_unique()):.1f}",
                percent(share_of(admitted, pl.col("lift_status") == LiftStatus.LIFTED.value)),
                _reasons(admitted.filter(pl.col("lift_status") != LiftStatus.LIFTED.value), "lift_status"),
                count(candidates.height),
                percent(share_of(candidates, pl.col("y_plan"))),
                percent(share_of(planned, pl.col("success"))),
            ]
        )
    return table(
        ["object", "scenes", "admitted a scene", "lifted of admitted", "others", "candidates", "planned", "success of planned"], rows
    )


def _hard_to_lift(admitted: pl.DataFrame) -> list[str]:
    """Objects whose grasps do not lift as a roboticist would expect."""
    lifted = (pl.col("lift_status") == LiftStatus.LIFTED.value).mean()
    shares = admitted.group_by("object_id").agg(lifted.alias("lifted")).filter(pl.col("lifted") < MIN_LIFTED_SHARE).sort("object_id")
    names = ", ".join(f"`{name}` ({percent(share_lifted)})" for name, share_lifted in shares.iter_rows())
    text = f"Below {percent(MIN_LIFTED_SHARE)} of admitted grasps lifted: {names}. The card in `objects/catalogue.toml` says why."
    return [text] if names else []


def _reasons(rows: pl.DataFrame, column: str) -> str | None:
    """How often each status occurs, the most frequent first."""
    counts = rows.group_by(column).len().sort(["len", column], descending=[True, False]).rows()
    return ", ".join(f"`{status}` {n}" for status, n in counts) or None


def share_of(frame: pl.DataFrame, what: pl.Expr) -> float | None:
    """Share of the rows of which something is true; None without rows."""
    return frame.filter(what).height / frame.height if frame.height else None
