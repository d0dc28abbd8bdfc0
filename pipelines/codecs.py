"""Table rows and the values they hold, read and written; the values themselves are in values.py."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Float

from pipelines.values import AdmittedGrasp, LiftedGrasp, Obstacle, Plan, Scene, Target
from tables.columns import joint_columns
from tables.poses import matrix_of, pose_columns, pose_of

Row = dict[str, Any]


def scenes_from_tables(scenes: pa.Table, obstacles: pa.Table, targets: pa.Table) -> dict[str, Scene]:
    """Scenes by id."""
    obstacle_rows, target_rows = rows_by(obstacles, "scene_id"), rows_by(targets, "scene_id")
    return {
        row["scene_id"]: Scene(
            scene_id=row["scene_id"],
            object_id=row["object_id"],
            stable_pose_id=row["stable_pose_id"],
            T_base_object=pose_in(row, "object"),
            obstacles=tuple(
                Obstacle(o["obstacle_id"], pose_in(o, "obstacle"), np.array([o["size_x_m"], o["size_y_m"], o["size_z_m"]]))
                for o in obstacle_rows.get(row["scene_id"], [])
            ),
            targets=tuple(Target(t["target_id"], t["stable_pose_id"], pose_in(t, "target")) for t in target_rows[row["scene_id"]]),
        )
        for row in scenes.to_pylist()
    }


def admitted_grasps(admission_rows: Iterable[Row]) -> tuple[AdmittedGrasp, ...]:
    """The admitted ones among rows of `grasp_admission`, in grasp order."""
    return tuple(
        AdmittedGrasp(row["grasp_id"], pose_in(row, "grasp"), joints_in(row, "pregrasp_q"), joints_in(row, "grasp_q"))
        for row in sorted(admission_rows, key=lambda row: row["grasp_id"])
        if row["admission_status"] == "admitted"
    )


def lifted_grasps(lift_rows: Iterable[Row]) -> tuple[LiftedGrasp, ...]:
    """The lifted ones among rows of `pick_lift`, in grasp order."""
    return tuple(
        LiftedGrasp(
            row["grasp_id"],
            joints_in(row, "lifted_q"),
            np.array([row["lifted_finger_left_m"], row["lifted_finger_right_m"]]),
            pose_in(row, "lifted"),
            pose_in(row, "inhand"),
        )
        for row in sorted(lift_rows, key=lambda row: row["grasp_id"])
        if row["lift_status"] == "lifted"
    )


def plan_in(row: Mapping[str, Any]) -> Plan:
    """The plan in a row of `plans`."""
    return Plan(*(np.array(row[f"{part}_q_rad"]).reshape(-1, 7) for part in ("transport", "descend", "retreat")))


def plan_columns(plan: Plan) -> Row:
    """Columns of `plans` but the candidate id."""
    return {f"{part}_q_rad": getattr(plan, f"{part}_q_rad").ravel().tolist() for part in ("transport", "descend", "retreat")}


def pose_in(row: Mapping[str, Any], prefix: str) -> Float[np.ndarray, "4 4"]:
    """The 4x4 pose in a row's seven `prefix` columns."""
    return matrix_of(np.array([row[name] for name in pose_columns(prefix)], dtype=np.float64))


def pose_row(prefix: str, T: Float[np.ndarray, "4 4"] | None) -> Row:
    """Seven columns of a pose; all null for None."""
    values = [None] * 7 if T is None else pose_of(T).tolist()
    return dict(zip(pose_columns(prefix), values, strict=True))


def joints_in(row: Mapping[str, Any], prefix: str) -> Float[np.ndarray, "7"]:
    """The arm configuration in a row's seven `prefix` columns."""
    return np.array([row[name] for name in joint_columns(prefix)], dtype=np.float64)


def joints_row(prefix: str, q: Float[np.ndarray, "7"] | None) -> Row:
    """Seven columns of an arm configuration; all null for None."""
    values = [None] * 7 if q is None else [float(v) for v in q]
    return dict(zip(joint_columns(prefix), values, strict=True))


def rows_by(table: pa.Table, column: str) -> dict[str, list[Row]]:
    """Rows of a table grouped by a string column."""
    groups: dict[str, list[Row]] = {}
    for row in table.to_pylist():
        groups.setdefault(row[column], []).append(row)
    return groups
