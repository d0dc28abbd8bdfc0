"""Table rows and the values they hold, read and written; the values themselves are in values.py."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Float

from pipelines.values import AdmittedGrasp, Candidate, Known, LiftedGrasp, Obstacle, Plan, Scene, Target
from tables.columns import joint_columns
from tables.identity import parse_candidate_id
from tables.poses import matrix_of, pose_columns, pose_of

Row = dict[str, Any]


def scenes_from_tables(scenes: pa.Table, obstacles: pa.Table, targets: pa.Table) -> dict[str, Scene]:
    """Scenes by id."""
    obstacle_rows, target_rows = rows_by(obstacles, "scene_id"), rows_by(targets, "scene_id")
    return {
        row["scene_id"]: scene_in(row, obstacle_rows.get(row["scene_id"], []), target_rows.get(row["scene_id"], []))
        for row in scenes.to_pylist()
    }


def scene_in(row: Row, obstacle_rows: Iterable[Row], target_rows: Iterable[Row]) -> Scene:
    """The scene in a row of `scenes` and its rows of `obstacles` and `targets`."""
    obstacles = sorted(obstacle_rows, key=lambda o: o["obstacle_id"])
    targets = sorted(target_rows, key=lambda t: t["target_id"])
    return Scene(
        scene_id=row["scene_id"],
        object_id=row["object_id"],
        stable_pose_id=row["stable_pose_id"],
        T_base_object=pose_in(row, "object"),
        obstacles=tuple(
            Obstacle(o["obstacle_id"], pose_in(o, "obstacle"), np.array([o["size_x_m"], o["size_y_m"], o["size_z_m"]])) for o in obstacles
        ),
        targets=tuple(Target(t["target_id"], t["stable_pose_id"], pose_in(t, "target")) for t in targets),
    )


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


def candidates_in(pair_rows: Iterable[Row], scene: Scene, lifted: Iterable[LiftedGrasp]) -> tuple[Candidate, ...]:
    """The candidates in rows of `candidate_pairs` of one scene, in row order; KeyError for a grasp that was not lifted."""
    grasps = {grasp.grasp_id: grasp for grasp in lifted}
    return tuple(Candidate(scene, grasps[row["grasp_id"]], scene.target(row["target_id"])) for row in pair_rows)


def plan_in(row: Mapping[str, Any]) -> Plan:
    """The plan in a row of `plans`."""
    return Plan(joints_in(row, "place_q"), np.array(row["via_q_rad"], dtype=np.float64).reshape(-1, 7))


def plan_columns(plan: Plan) -> Row:
    """Columns of `plans` but the candidate id."""
    return {**joints_row("place_q", plan.place_q_rad), "via_q_rad": plan.via_q_rad.ravel().tolist()}


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


def rows_by_scene(tables: Mapping[str, pa.Table], scene_ids: Sequence[str]) -> dict[str, dict[str, list[Row]]]:
    """Rows of some scenes in each table; a table keyed by candidate is matched by the scene in the candidate's id."""
    out: dict[str, dict[str, list[Row]]] = {scene_id: {name: [] for name in tables} for scene_id in scene_ids}
    for name, table in tables.items():
        for row in table.to_pylist():
            scene_id = row["scene_id"] if "scene_id" in row else parse_candidate_id(row["candidate_id"]).scene_id
            if scene_id in out:
                out[scene_id][name].append(row)
    return out


def known_in(rows: Mapping[str, list[Row]]) -> Known:
    """What the rows of one scene say, decoded once; tables that are not there give nothing.

    Args:
        rows: by table, in key order.
    """
    if not rows.get("scenes"):
        return Known()
    (scene_row,) = rows["scenes"]
    scene = scene_in(scene_row, rows["obstacles"], rows["targets"])
    lifted = lifted_grasps(rows.get("pick_lift", []))
    return Known(
        scene,
        admitted_grasps(rows.get("grasp_admission", [])),
        lifted,
        candidates_in(rows.get("candidate_pairs", []), scene, lifted),
        {row["candidate_id"]: plan_in(row) for row in rows.get("plans", [])},
    )
