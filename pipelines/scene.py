"""The values that stages hand on: a scene, an admitted grasp, a lifted grasp, a plan; read from and written to table rows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from jaxtyping import Float

from tables.columns import joint_columns
from tables.poses import matrix_of, pose_columns, pose_of

Row = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Obstacle:
    """A box on the table; `T_base_obstacle` is its centre."""

    obstacle_id: int
    T_base_obstacle: Float[np.ndarray, "4 4"]
    size_m: Float[np.ndarray, "3"]


@dataclass(frozen=True, slots=True)
class Target:
    """A requested object pose."""

    target_id: int
    stable_pose_id: int
    T_base_target: Float[np.ndarray, "4 4"]


@dataclass(frozen=True, slots=True)
class Scene:
    """One object at its initial pose, its obstacles and its targets."""

    scene_id: str
    object_id: str
    stable_pose_id: int
    T_base_object: Float[np.ndarray, "4 4"]
    obstacles: tuple[Obstacle, ...]
    targets: tuple[Target, ...]


@dataclass(frozen=True, slots=True)
class AdmittedGrasp:
    """A grasp that passed geometric admission: TCP pose and the arm at pregrasp and grasp (same redundancy q7)."""

    grasp_id: int
    T_base_grasp: Float[np.ndarray, "4 4"]
    pregrasp_q_rad: Float[np.ndarray, "7"]
    grasp_q_rad: Float[np.ndarray, "7"]


@dataclass(frozen=True, slots=True)
class LiftedGrasp:
    """The measured state after the pick-lift check: where planning and execution start."""

    grasp_id: int
    lifted_q_rad: Float[np.ndarray, "7"]
    fingers_m: Float[np.ndarray, "2"]
    T_base_lifted: Float[np.ndarray, "4 4"]
    T_tcp_object: Float[np.ndarray, "4 4"]


@dataclass(frozen=True, slots=True)
class Plan:
    """Joint waypoints of a solved candidate: post-lift to pre-place, to place, and back to the retreat pose."""

    transport_q_rad: Float[np.ndarray, "a 7"]
    descend_q_rad: Float[np.ndarray, "b 7"]
    retreat_q_rad: Float[np.ndarray, "c 7"]


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


def only_scene(table: pa.Table, scene_id: str) -> pa.Table:
    """The rows of one scene."""
    return table.filter(pc.equal(table["scene_id"].cast(pa.string()), scene_id))
