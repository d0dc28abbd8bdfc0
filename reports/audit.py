"""Report of the audits of the planning labels: how many hold under an independent or finer look, and which do not.

The audits are made in pipelines/proofs/; how labels hold under changes of the physics is reported by repeatability.py.
"""

from __future__ import annotations

import polars as pl
import pyarrow as pa

from pipelines.frames import frame_of
from reports.metrics import clopper_pearson
from reports.report import Report, ReportError
from splits.markdown import count, table
from tables.vocabulary import Audit, PlanStatus

N_LISTED = 20  # disagreeing candidates that are named

_TITLES = {
    Audit.PATH_GEOMETRY: "Executed paths, rechecked by another collision engine",
    Audit.SEARCH_BUDGET: "Spent budgets, searched ten times as long",
    Audit.REJECTION: "Rejections, judged again by a slower judge",
}
_TEXTS = {
    Audit.PATH_GEOMETRY: (
        "Every configuration of the executed motion (transport with its stops, descend, retreat; no joint moves more than 0.005 rad in"
        " between) is tested by pybullet's own engine, on pybullet's kinematics and the hulls it makes of the arm's meshes: arm, hand,"
        " fingers and the carried or placed object, in its convex parts, against table, obstacles and each other. Depth is the overlap of"
        " two bodies; the planner allows the open hand 1 mm in the object it lets go of, and asks for 1 mm to table and obstacles at the"
        " configurations it looks at. Deeper than 1 mm is a disagreement."
    ),
    Audit.SEARCH_BUDGET: (
        "Searches that ended with their budget of checks spent, made again with ten times as many. A disagreement is a plan that was found."
    ),
    Audit.REJECTION: (
        "Each candidate is judged anew with 256 values of joint 7, lines in 1 mm steps and edges in 0.005 rad steps. Independent of the"
        " planner are all verdicts on collision (pybullet's engine; mugs and link6 as exact triangle meshes) and the inverse kinematics"
        " from random starts that joins the closed form; the closed form, the lines and the search are the planner's, only finer. A"
        " disagreement (a flip) is a whole motion that was found; another reason for the same rejection is not."
    ),
}


def audit_report(audits: pa.Table, candidates: pa.Table, *, tier: str) -> Report:
    """Report `audit`.

    Args:
        audits: table `audits`.
        candidates: table `candidates`, the stored labels.
        tier: printed in the title.

    Raises:
        ReportError: an audit of an unknown candidate, or of another status than the stored one.
    """
    stored = frame_of(candidates, ["candidate_id", "plan_status", "category", "used_search", "n_checks"])
    frame = _joined(frame_of(audits), stored)
    metrics: dict[str, float] = {}
    blocks = [
        f"# Audit of the planning labels on tier {tier}",
        "How many stored labels hold under a look that is independent of the planner, or finer. Candidates are those of each status that"
        " hash lowest. Intervals are exact binomial (Clopper and Pearson), 95 %. How labels hold under changes of the physics is reported"
        " as label repeatability.",
        _summary(frame, stored),
    ]
    sections = {Audit.PATH_GEOMETRY: _paths, Audit.SEARCH_BUDGET: _budgets, Audit.REJECTION: _rejections}
    for audit, section in sections.items():
        own = frame.filter(pl.col("audit") == audit.value)
        metrics |= {f"{audit.value}.n": float(own.height), f"{audit.value}.disagreements": float(own.filter(~pl.col("agrees")).height)}
        blocks += [f"## {_TITLES[audit]}", _TEXTS[audit]]
        more, values = section(own, stored)
        blocks += [*more, *_listed(own)]
        metrics |= values
    return Report("audit", "\n\n".join(blocks) + "\n", {}, metrics)


def _joined(audits: pl.DataFrame, stored: pl.DataFrame) -> pl.DataFrame:
    frame = audits.join(stored, on="candidate_id", how="left").sort("candidate_id", "audit")
    strange = frame.filter(pl.col("plan_status").is_null())
    if not strange.is_empty():
        raise ReportError(f"audits: {strange['candidate_id'][0]} is no candidate ({strange.height} audits, must be 0)")
    stale = frame.filter(pl.col("plan_status") != pl.col("stored_status"))
    if not stale.is_empty():
        first = stale.row(0, named=True)
        raise ReportError(
            f"audits: {first['candidate_id']} was audited as {first['stored_status']}, but is stored as {first['plan_status']}"
            f" ({stale.height} audits, must be 0)"
        )
    return frame


def _summary(frame: pl.DataFrame, stored: pl.DataFrame) -> str:
    rows = []
    for audit, title in _TITLES.items():
        own = frame.filter(pl.col("audit") == audit.value)
        statuses = sorted({PlanStatus(status) for status in own["stored_status"]}, key=list(PlanStatus).index)
        population = stored.filter(pl.col("plan_status").is_in([status.value for status in statuses])).height
        rows.append([title, count(population), *_counted(own)])
    return table(["audit", "candidates", "audited", "disagreements", "rate [95 %]"], rows)


def _counted(own: pl.DataFrame) -> list[str | None]:
    """Number, disagreements, and their share with its interval."""
    n_bad = own.filter(~pl.col("agrees")).height
    estimate = clopper_pearson(n_bad, own.height)
    return [count(own.height), count(n_bad), None if estimate is None else f"{estimate} %"]


def _paths(own: pl.DataFrame, stored: pl.DataFrame) -> tuple[list[str], dict[str, float]]:
    if own.is_empty():
        return ["None were made."], {}
    rows = []
    for name, group in [*((str(c), own.filter(pl.col("category") == c)) for c in sorted(own["category"].unique())), ("all", own)]:
        overlapping = group.filter(pl.col("depth_m") > 0.0)
        row = [name, *_counted(group), count(overlapping.height), count(int(group["n_configurations"].sum()))]
        deepest = _millimetres(overlapping["depth_m"].max()) if overlapping.height else None
        rows.append([*row, deepest, _millimetres(group["clearance_m"].min())])
    header = [
        "category", "paths", "disagreements", "rate [95 %]", "paths with any overlap", "configurations",
        "deepest overlap [mm]", "least clearance of table and obstacles [mm]",
    ]  # fmt: skip
    blocks = [table(header, rows)]
    worst = own.filter(pl.col("depth_m") > 0.0).sort("depth_m", "candidate_id", descending=[True, False]).head(5)
    if not worst.is_empty():
        listed = [[r["candidate_id"], r["deepest_pair"], _millimetres(r["depth_m"])] for r in worst.iter_rows(named=True)]
        blocks += ["The deepest overlaps:", table(["candidate", "where", "depth [mm]"], listed, align="llr")]
    metrics = {
        "path_geometry.configurations": float(own["n_configurations"].sum()),
        "path_geometry.deepest_mm": 1e3 * float(own["depth_m"].max()),  # type: ignore[arg-type]
        "path_geometry.least_clearance_mm": 1e3 * float(own["clearance_m"].min()),  # type: ignore[arg-type]
    }
    return blocks, metrics


def _budgets(own: pl.DataFrame, stored: pl.DataFrame) -> tuple[list[str], dict[str, float]]:
    searched = stored.filter(pl.col("used_search"))
    found = searched.filter(pl.col("plan_status") == PlanStatus.SOLVED.value)
    most = f"; the longest took {count(int(found['n_checks'].max()))} checks" if found.height else ""  # type: ignore[arg-type]
    text = f"Of {count(searched.height)} stored candidates that needed a search, {count(found.height)} found a plan{most}."
    if own.is_empty():
        return [f"{text} No stored candidate spent its budget."], {}
    return [text, table(["spent budgets", "found by ten times as much", "rate [95 %]"], [_counted(own)], align="rrr")], {}


def _rejections(own: pl.DataFrame, stored: pl.DataFrame) -> tuple[list[str], dict[str, float]]:
    if own.is_empty():
        return ["None were made."], {}
    rows = []
    metrics: dict[str, float] = {}
    n_rejected, flips = 0, 0.0
    for status in PlanStatus:
        group = own.filter(pl.col("stored_status") == status.value)
        if group.is_empty():
            continue
        population = stored.filter(pl.col("plan_status") == status.value).height
        n_bad = group.filter(~pl.col("agrees")).height
        other = group.filter(pl.col("agrees") & (pl.col("audited_status") != status.value)).height
        rows.append([f"`{status.value}`", count(population), *_counted(group), count(other)])
        metrics[f"rejection.{status.value}.flips"] = float(n_bad)
        n_rejected += population
        flips += population * n_bad / group.height
    total = stored.height
    metrics["rejection.weighted_flip_rate"] = flips / n_rejected
    header = ["stored reason", "candidates", "audited", "flips", "rate [95 %]", "rejected for another reason"]
    text = (
        "Reasons differ in size: weighted by how often each is given,"
        f" {100 * flips / n_rejected:.2f} % of the rejections would flip, {100 * flips / total:.2f} % of all candidates."
    )
    return [table(header, rows), text], metrics


def _listed(own: pl.DataFrame) -> list[str]:
    bad = own.filter(~pl.col("agrees"))
    if bad.is_empty():
        return []
    rows = [
        [r["candidate_id"], f"`{r['stored_status']}`", f"`{r['audited_status']}`" if r["audited_status"] else r["deepest_pair"]]
        for r in bad.head(N_LISTED).iter_rows(named=True)
    ]
    left = f" The first {N_LISTED}:" if bad.height > N_LISTED else ""
    return [f"{count(bad.height)} disagree.{left}", table(["candidate", "stored", "audit"], rows, align="lll")]


def _millimetres(value_m: object) -> str:
    assert isinstance(value_m, float)
    return f"{1e3 * value_m:.2f}"
