"""The book of laws: what must hold of the tables of a stage beyond their schemas, each rule in one place.

A law runs on the tables before they are published, again on what is on disk in the gates of the asset graph, and again over a whole
release, which may leave `plans` and `scene_attempts` out. It returns one sentence for every rule that is broken: how often, and the
first row that breaks it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import polars as pl
import pyarrow as pa

from pipelines.frames import frame_of
from pipelines.stage import Promise
from tables.vocabulary import AdmissionStatus, ExecStatus, LiftStatus, PlanStatus

Tables = Mapping[str, pa.Table]

# A margin recomputed from two stored doubles differs from the stored one by rounding only.
_MARGIN_ROUNDING = 1e-9
_CANDIDATE = ["scene_id", "target_id", "grasp_id"]


def scenes_law(tables: Tables, promise: Promise) -> list[str]:
    """Every promised scene is there and no other, with its object, its obstacle count and its targets."""
    scenes = {row["scene_id"]: row for row in frame_of(tables["scenes"]).iter_rows(named=True)}
    n_obstacles = dict(frame_of(tables["obstacles"]).group_by("scene_id").len().iter_rows())
    n_targets = dict(frame_of(tables["targets"]).group_by("scene_id").len().iter_rows())
    errors = _both_have("scenes", "scene_id", scenes, "promised", [allocation.scene_id for allocation in promise.allocations])
    for name in sorted(tables.keys() & {"obstacles", "targets", "scene_attempts"}):
        stray = sorted(set(frame_of(tables[name])["scene_id"].to_list()) - scenes.keys())
        errors += [f"{name}: rows of {scene_id}, which is no scene ({len(stray)} are none, must be 0)" for scene_id in stray[:1]]
    for allocation in promise.allocations:
        row = scenes.get(allocation.scene_id)
        if row is None:
            continue
        counts = (n_obstacles.get(allocation.scene_id, 0), n_targets.get(allocation.scene_id, 0))
        found = (row["object_id"], row["n_obstacles"], *counts)
        wanted = (allocation.object_id, allocation.n_obstacles, allocation.n_obstacles, promise.n_targets)
        if found != wanted:
            errors.append(f"{allocation.scene_id}: object, obstacles, obstacle rows, targets are {found}, must be {wanted}")
    return errors


def scene_points_law(tables: Tables, promise: Promise) -> list[str]:
    """Every scene has points on its object, on the table, and on obstacles exactly where it has any."""
    seen = set(frame_of(tables["scene_points"], ["scene_id", "point_type"]).unique().iter_rows())
    wanted = {(allocation.scene_id, kind) for allocation in promise.allocations for kind in ("object", "environment")}
    blind = [f"scene_points: {scene_id} has no {kind} point" for scene_id, kind in sorted(wanted - seen)]
    bare = {allocation.scene_id for allocation in promise.allocations if allocation.n_obstacles == 0}
    ghosts = sorted(scene_id for scene_id, kind in seen if kind == "obstacle" and scene_id in bare)
    return blind + [f"scene_points: {scene_id} has obstacle points and 0 obstacles" for scene_id in ghosts]


def grasp_admission_law(tables: Tables, promise: Promise) -> list[str]:
    """Arm configurations are there exactly where a grasp was admitted, and every scene has rows."""
    frame = frame_of(tables["grasp_admission"])
    scene_ids = [allocation.scene_id for allocation in promise.allocations]
    is_admitted = pl.col("admission_status") == AdmissionStatus.ADMITTED.value
    return [
        *_both_have("grasp_admission", "scene_id", frame["scene_id"].to_list(), "promised", scene_ids),
        *_broken(
            "grasp_q and pregrasp_q are there exactly where a grasp was admitted",
            frame.filter(pl.any_horizontal(pl.col("grasp_q_1_rad", "pregrasp_q_1_rad").is_null() == is_admitted)),
            ["scene_id", "grasp_id"],
            ["admission_status", "grasp_q_1_rad", "pregrasp_q_1_rad"],
        ),
    ]


def pick_lift_law(tables: Tables, promise: Promise) -> list[str]:
    """Exactly the admitted grasps were tried, and every lifted one has a measured state."""
    admission = frame_of(tables["grasp_admission"], ["scene_id", "grasp_id", "admission_status"])
    admitted = admission.filter(pl.col("admission_status") == AdmissionStatus.ADMITTED.value)
    frame = frame_of(tables["pick_lift"])
    is_lifted = pl.col("lift_status") == LiftStatus.LIFTED.value
    return [
        *_same_rows(["scene_id", "grasp_id"], "admitted grasps", admitted, "pick_lift", frame),
        *_broken(
            "a lifted grasp has a measured state",
            frame.filter(is_lifted & pl.any_horizontal(pl.col("lifted_q_1_rad", "lifted_x_m", "inhand_x_m").is_null())),
            ["scene_id", "grasp_id"],
            ["lift_status", "lifted_q_1_rad"],
        ),
    ]


def candidate_pairs_law(tables: Tables, promise: Promise) -> list[str]:
    """Candidates are the lifted grasps of each scene times its targets, with ids made of their coordinates."""
    lifted = frame_of(tables["pick_lift"]).filter(pl.col("lift_status") == LiftStatus.LIFTED.value).select("scene_id", "grasp_id")
    wanted = lifted.join(frame_of(tables["targets"], ["scene_id", "target_id"]), on="scene_id").select(_CANDIDATE)
    pairs = frame_of(tables["candidate_pairs"])
    own_id = pl.format("{}-t{}-g{}", "scene_id", "target_id", pl.col("grasp_id").cast(pl.String).str.zfill(2))
    columns = ["object_id", "category", "n_obstacles"]
    kinds = pl.DataFrame(
        [(a.scene_id, a.object_id, a.category, a.n_obstacles) for a in promise.allocations],
        schema={"scene_id": pl.String, "object_id": pl.String, "category": pl.String, "n_obstacles": pl.Int32},
        orient="row",
    )
    return [
        *_same_rows(_CANDIDATE, "lifted grasps x targets", wanted, "candidate_pairs", pairs),
        *_broken("candidate_id is made of its coordinates", pairs.filter(pl.col("candidate_id") != own_id), ["candidate_id"], _CANDIDATE),
        *_broken(
            "candidates have coordinates of their own", pairs.filter(pl.struct(_CANDIDATE).is_duplicated()), ["candidate_id"], _CANDIDATE
        ),
        *_broken(
            "object, category and obstacle count are the scene's",
            pairs.join(kinds, on=["scene_id", *columns], how="anti"),
            ["candidate_id"],
            columns,
        ),
    ]


def policy_features_law(tables: Tables, promise: Promise) -> list[str]:
    """Every candidate has the features of the endpoint baselines, and nothing else has."""
    return _same_rows(
        ["candidate_id"], "candidate_pairs", _ids(tables["candidate_pairs"]), "policy_features", _ids(tables["policy_features"])
    )


def planning_labels_law(tables: Tables, promise: Promise) -> list[str]:
    """Every candidate has a status; y_plan, the status `solved`, what is measured of a plan, and a stored plan go together."""
    labels = frame_of(tables["planning_labels"])
    planned = pl.col("y_plan")
    status, key = pl.col("plan_status"), ["candidate_id"]
    measured = ["min_clearance_m", "plan_duration_s", "path_length_rad", "n_waypoints"]
    return [
        *_same_rows(key, "candidate_pairs", _ids(tables["candidate_pairs"]), "planning_labels", labels),
        *_broken(
            "y_plan says the same as plan_status",
            labels.filter(planned != (status == PlanStatus.SOLVED.value)),
            key,
            ["y_plan", "plan_status"],
        ),
        *(
            error
            for name in measured
            for error in _broken(
                f"{name} is null exactly where y_plan is false", labels.filter(pl.col(name).is_null() == planned), key, ["y_plan", name]
            )
        ),
        *(_same_rows(key, "planned candidates", labels.filter(planned), "plans", _ids(tables["plans"])) if "plans" in tables else []),
    ]


def execution_labels_law(tables: Tables, promise: Promise) -> list[str]:
    """Exactly the planned candidates were executed, and label, status, errors and margin say the same of each."""
    labels = frame_of(tables["execution_labels"])
    planned = frame_of(tables["planning_labels"], ["candidate_id", "y_plan"]).filter("y_plan")
    key = ["candidate_id"]
    broken = [_broken(rule, labels.filter(breaks), key, columns) for rule, breaks, columns in _execution_rules(promise)]
    return [*_same_rows(key, "planned candidates", planned, "execution_labels", labels), *(error for errors in broken for error in errors)]


def _execution_rules(promise: Promise) -> list[tuple[str, pl.Expr, list[str]]]:
    """(what must hold, rows that break it, columns that show it)."""
    tolerances, success, status = promise.tolerances, pl.col("y_pipe").fill_null(False), pl.col("exec_status")
    position, rotation, margin = pl.col("final_position_error_m"), pl.col("final_rotation_error_rad"), pl.col("tolerance_margin")
    expected = 1.0 - pl.max_horizontal(position / tolerances.position_m, rotation / tolerances.rotation_rad)
    slips, is_slipped = ["transport_slip_m", "transport_slip_rad"], status == ExecStatus.SLIPPED.value
    is_slip = (pl.col("transport_slip_m") > tolerances.slip_m) | (pl.col("transport_slip_rad") > tolerances.slip_rad)
    errors = ["final_position_error_m", "final_rotation_error_rad"]
    always = [
        "y_pipe",
        "exec_status",
        *errors,
        "tolerance_margin",
        *slips,
        "n_physics_steps",
        "final_x_m",
    ]
    return [
        *((f"{name} is there for every execution", pl.col(name).is_null(), [name]) for name in always),
        ("y_pipe says the same as exec_status", success != (status == ExecStatus.SUCCESS.value), ["y_pipe", "exec_status"]),
        (
            f"tolerance_margin is 1 minus the larger of position error / {tolerances.position_m:g} m"
            f" and rotation error / {tolerances.rotation_rad:.6g} rad",
            (margin - expected).abs() > _MARGIN_ROUNDING * (1.0 + expected.abs()),
            ["tolerance_margin", *errors],
        ),
        ("a success has tolerance_margin of at least 0", success & (margin < 0.0), ["y_pipe", "tolerance_margin"]),
        (
            f"a success has transport_slip_m of at most {tolerances.slip_m:g} m and transport_slip_rad of at most"
            f" {tolerances.slip_rad:.6g} rad",
            success & is_slip,
            ["y_pipe", *slips],
        ),
        (
            f"{ExecStatus.SLIPPED.value} has tolerance_margin of at least 0",
            is_slipped & (margin < 0.0),
            ["exec_status", "tolerance_margin"],
        ),
        (
            f"{ExecStatus.SLIPPED.value} has transport_slip_m above {tolerances.slip_m:g} m or transport_slip_rad above"
            f" {tolerances.slip_rad:.6g} rad",
            is_slipped & ~is_slip,
            ["exec_status", *slips],
        ),
        (
            f"{ExecStatus.OFF_TARGET.value} has tolerance_margin below 0",
            (status == ExecStatus.OFF_TARGET.value) & (margin >= 0.0),
            ["exec_status", "tolerance_margin"],
        ),
        *(
            (
                f"{name} is there exactly where the hand let go: never after {ExecStatus.DROPPED.value}, always but after a stop",
                (pl.col(name).is_not_null() & (status == ExecStatus.DROPPED.value))
                | (pl.col(name).is_null() & ~status.is_in([ExecStatus.DROPPED.value, ExecStatus.STOPPED.value])),
                ["exec_status", name],
            )
            for name in ("release_position_error_m", "release_rotation_error_rad", "retreat_drag_m")
        ),
    ]


def _ids(table: pa.Table) -> pl.DataFrame:
    return frame_of(table, ["candidate_id"])


def _broken(rule: str, rows: pl.DataFrame, key: list[str], shown: list[str]) -> list[str]:
    """A sentence where rows break a rule, with the first of them."""
    if rows.is_empty():
        return []
    first = rows.sort(key).row(0, named=True)
    values = ", ".join(f"{name} = {first[name]!r}" for name in shown)
    return [f"{rule}; broken by {rows.height} rows, must be 0; first {_named(key, first)} with {values}"]


def _same_rows(key: list[str], name: str, left: pl.DataFrame, other: str, right: pl.DataFrame) -> list[str]:
    """A sentence where one side has keys that the other lacks."""
    errors = []
    for has, lacks, some, more in ((name, other, left, right), (other, name, right, left)):
        rows = some.select(key).join(more.select(key), on=key, how="anti").sort(key)
        if not rows.is_empty():
            errors.append(f"{rows.height} of {has} are missing in {lacks}, must be 0; first {_named(key, rows.row(0, named=True))}")
    return errors


def _both_have(name: str, key: str, found: Iterable[str], other: str, wanted: Iterable[str]) -> list[str]:
    left, right = (pl.DataFrame({key: sorted(set(values))}, schema={key: pl.String}) for values in (found, wanted))
    return _same_rows([key], name, left, other, right)


def _named(key: list[str], row: Mapping[str, object]) -> str:
    return ", ".join(str(row[name]) if name.endswith("candidate_id") else f"{name} {row[name]}" for name in key)
