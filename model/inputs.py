"""The five inputs of the ranker, enforced by column name, and their reading from a release; labels are read in labels.py.

Everything here is known before motion planning. A column that only planning, pick-lift or execution can know raises.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from jaxtyping import Float, Float32, Int

from model.errors import ForbiddenColumnError, InputError
from model.release_tables import read_table_columns, row_error
from tables import schemas
from tables.poses import inverse, matrix_of, pose_columns
from tables.vocabulary import PointType, SplitScheme

# Point types as the network counts them; `target`, the virtual copy, is made in clouds.py and never stored.
TYPE_NAMES = (PointType.ENVIRONMENT.value, PointType.OBJECT.value, "target", PointType.OBSTACLE.value)
ENVIRONMENT, OBJECT, TARGET, OBSTACLE = range(4)

# What feeds each input: table -> columns. The virtual target copy in the cloud is the object's points moved by
# T_base_target @ inv(T_base_object). The object-relative pose is inv(T_base_grasp) @ T_base_object of the *initial* object: supplied with
# the candidate, never measured after the lift.
FIVE_INPUTS: Mapping[str, Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        "scene_cloud": {"scene_points": ("x_m", "y_m", "z_m"), "scenes": pose_columns("object"), "targets": pose_columns("target")},
        "point_types": {"scene_points": ("point_type",)},
        "grasp_pose": {"grasps": pose_columns("grasp")},
        "target_pose": {"targets": pose_columns("target")},
        "object_relative_pose": {"grasps": pose_columns("grasp"), "scenes": pose_columns("object")},
    }
)
# Columns that say which row belongs to which; they order and join, and never reach the network. `split` stands for the column of the split
# scheme that a reader is of: it reads no other.
KEY_COLUMNS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "scene_points": ("scene_id", "point"),
        "scenes": ("scene_id",),
        "targets": ("scene_id", "target_id"),
        "grasps": ("scene_id", "grasp_id"),
        "candidates": ("scene_id", "target_id", "grasp_id", "candidate_id"),
        "splits": ("scene_id", "split"),
    }
)
_AFTER = {
    *schemas.LABEL_COLUMNS,
    *schemas.PICK_LIFT.names,
    *schemas.PLANS.names,
    *schemas.ATTEMPTS.names,
    *schemas.TIMINGS.names,
    *schemas.PREDICTIONS.names,
}
FORBIDDEN_COLUMNS = frozenset(_AFTER - {"scene_id", "target_id", "grasp_id", "candidate_id"})

SHORTEST_QUATERNION = 1e-6  # below it a direction is rounding noise

Pose = Float[np.ndarray, "4 4"]


@dataclass(frozen=True, slots=True)
class SceneCloud:
    """Points of the initial scene, base frame; no target copy yet."""

    scene_id: str
    points_m: Float32[np.ndarray, "n 3"]
    point_types: Int[np.ndarray, "n"]
    T_base_object: Float[np.ndarray, "4 4"]


@dataclass(frozen=True, slots=True)
class ReleaseInputs:
    """The inputs of every candidate of some scenes, in (scene_id, target_id, grasp_id) order.

    Scenes, fixed-target groups and candidates are numbered; a group points at its scene and a candidate at its group.
    """

    clouds: tuple[SceneCloud, ...]
    group_scene: Int[np.ndarray, "g"]
    group_target_id: Int[np.ndarray, "g"]
    T_base_target: Float[np.ndarray, "g 4 4"]
    candidate_ids: tuple[str, ...]
    candidate_group: Int[np.ndarray, "c"]
    T_base_grasp: Float[np.ndarray, "c 4 4"]
    T_grasp_object: Float[np.ndarray, "c 4 4"]


class InputReader:
    """The one door through which inputs come in from a release: it lets the contract through and remembers what it selected.

    Args:
        scheme: by what scenes are dealt to the splits.
    """

    def __init__(self, release_dir: Path, scheme: SplitScheme = SplitScheme.SCENE) -> None:
        self.release_dir = release_dir
        self.scheme = scheme
        self._selected: dict[str, set[str]] = {}

    @property
    def selected(self) -> dict[str, list[str]]:
        """The columns that were read so far, by table, both sorted."""
        return {table: sorted(columns) for table, columns in sorted(self._selected.items())}

    def columns(self, table: str, columns: Sequence[str]) -> pa.Table:
        """Named columns of a release table, dictionaries decoded and values checked.

        Raises:
            ForbiddenColumnError: a column outside the five inputs and their keys.
            InputError: the table or a column does not exist, or a value that its schema does not allow.
        """
        check_columns(table, columns, self.scheme)
        rows = read_table_columns(self.release_dir, table, columns)
        self._selected.setdefault(table, set()).update(rows.column_names)
        return rows


def read_inputs(reader: InputReader, scene_ids: Collection[str] | None = None, has_points: bool = True) -> ReleaseInputs:
    """The five inputs of the candidates of `scene_ids`, or of all scenes that have candidates.

    Args:
        has_points: False leaves the clouds empty, as a light release has none.

    Raises:
        InputError: a table is missing or holds an impossible value, a candidate without scene, target or grasp, or an object that no
            camera saw.
    """
    keys = reader.columns("candidates", KEY_COLUMNS["candidates"])
    keys = keys.sort_by([(name, "ascending") for name in ("scene_id", "target_id", "grasp_id")])
    if scene_ids is not None:
        keys = keys.filter(pc.is_in(keys["scene_id"], pa.array(sorted(scene_ids), pa.string())))
    scene_of = np.array(keys["scene_id"].to_pylist(), dtype=object)
    target_of, grasp_of = keys["target_id"].to_numpy(), keys["grasp_id"].to_numpy()
    scenes = sorted(set(scene_of))

    objects = _poses_by_key(reader, "scenes", ("scene_id",), "object")
    targets = _poses_by_key(reader, "targets", ("scene_id", "target_id"), "target")
    grasps = _poses_by_key(reader, "grasps", ("scene_id", "grasp_id"), "grasp")
    groups = sorted(set(zip(scene_of, target_of.tolist(), strict=True)))
    number_of_scene = {scene_id: k for k, scene_id in enumerate(scenes)}
    number_of_group = {group: k for k, group in enumerate(groups)}

    T_base_object = _looked_up("scenes", objects, [(scene_id,) for scene_id in scenes])
    T_base_grasp = _looked_up("grasps", grasps, list(zip(scene_of, grasp_of.tolist(), strict=True)))
    of_candidate = np.array([number_of_scene[scene_id] for scene_id in scene_of], dtype=np.int64)
    return ReleaseInputs(
        clouds=_read_clouds(reader, scenes, T_base_object) if has_points else _empty_clouds(scenes, T_base_object),
        group_scene=np.array([number_of_scene[scene_id] for scene_id, _ in groups], dtype=np.int64),
        group_target_id=np.array([target_id for _, target_id in groups], dtype=np.int64),
        T_base_target=_looked_up("targets", targets, groups),
        candidate_ids=tuple(keys["candidate_id"].to_pylist()),
        candidate_group=np.array([number_of_group[group] for group in zip(scene_of, target_of.tolist(), strict=True)], dtype=np.int64),
        T_base_grasp=T_base_grasp,
        T_grasp_object=inverse(T_base_grasp) @ T_base_object[of_candidate],
    )


def restricted(inputs: ReleaseInputs, groups: Int[np.ndarray, "k"]) -> ReleaseInputs:
    """The inputs of some fixed-target groups alone; `groups` ascending."""
    scenes = np.unique(inputs.group_scene[groups])
    of_groups = np.isin(inputs.candidate_group, groups)
    return ReleaseInputs(
        clouds=tuple(inputs.clouds[scene] for scene in scenes),
        group_scene=np.searchsorted(scenes, inputs.group_scene[groups]),
        group_target_id=inputs.group_target_id[groups],
        T_base_target=inputs.T_base_target[groups],
        candidate_ids=tuple(inputs.candidate_ids[k] for k in np.flatnonzero(of_groups)),
        candidate_group=np.searchsorted(groups, inputs.candidate_group[of_groups]),
        T_base_grasp=inputs.T_base_grasp[of_groups],
        T_grasp_object=inputs.T_grasp_object[of_groups],
    )


def check_columns(table: str, columns: Sequence[str], scheme: SplitScheme = SplitScheme.SCENE) -> None:
    """Raise ForbiddenColumnError for the first column that the contract does not name."""
    for column in columns:
        refusal = _refusal(table, column, scheme)
        if refusal is not None:
            raise ForbiddenColumnError(refusal)


def column_errors(selected: Mapping[str, Collection[str]], scheme: SplitScheme = SplitScheme.SCENE) -> list[str]:
    """Each column, of those that a training read by table, that is forbidden or unknown, and each of the contract that it did not read."""
    refusals = [_refusal(table, column, scheme) for table in sorted(selected) for column in sorted(selected[table])]
    errors = [refusal for refusal in refusals if refusal is not None]
    for table in sorted(KEY_COLUMNS):
        missing = sorted(_allowed(table, scheme) - set(selected.get(table, ())))
        errors += [f"{table}.{column}: not read, must be: the contract names it" for column in missing]
    return errors


def contract_hash() -> str:
    """SHA-256 of the contract: a checkpoint trained under another one is refused."""
    contract = {name: {table: list(columns) for table, columns in sources.items()} for name, sources in FIVE_INPUTS.items()}
    return hashlib.sha256(json.dumps(contract, sort_keys=True).encode()).hexdigest()


def scenes_of_split(reader: InputReader, split: str) -> tuple[str, ...]:
    """Ids of the scenes of a split under the reader's scheme, sorted."""
    column = reader.scheme.column
    splits = reader.columns("splits", ("scene_id", column))
    return tuple(sorted(splits.filter(pc.equal(splits[column], split))["scene_id"].to_pylist()))


def _allowed(table: str, scheme: SplitScheme) -> set[str]:
    keys = [scheme.column if (table, name) == ("splits", "split") else name for name in KEY_COLUMNS.get(table, ())]
    return {*keys, *(name for sources in FIVE_INPUTS.values() for name in sources.get(table, ()))}


def _refusal(table: str, column: str, scheme: SplitScheme) -> str | None:
    """Why a column may not be read as an input, or None where it may."""
    if column in FORBIDDEN_COLUMNS:
        return f"{table}.{column}: known only after pick-lift, planning or execution, must not be a model input"
    if column not in _allowed(table, scheme):
        return f"{table}.{column}: not one of the five inputs; of {table} the ranker reads {sorted(_allowed(table, scheme))}"
    return None


def _poses_by_key(reader: InputReader, table: str, key: tuple[str, ...], prefix: str) -> dict[tuple[Any, ...], Pose]:
    columns = pose_columns(prefix)
    rows = reader.columns(table, (*key, *columns))
    poses = np.column_stack([rows[name].to_numpy() for name in columns])
    with np.errstate(over="ignore"):
        length = np.linalg.norm(poses[:, 3:], axis=1)
    is_bad = ~(np.isfinite(length) & (length >= SHORTEST_QUATERNION))
    if is_bad.any():
        row = int(np.argmax(is_bad))
        bound = f"must be finite and at least {SHORTEST_QUATERNION:g}"
        problem = f"quaternion {columns[3]} ... {columns[6]} has length {length[row]:.3g}, {bound}"
        raise row_error(reader.release_dir / f"{table}.parquet", rows, row, problem)
    return dict(zip(zip(*(rows[name].to_pylist() for name in key), strict=True), matrix_of(poses), strict=True))


def _looked_up(table: str, poses: Mapping[tuple[Any, ...], Pose], keys: Sequence[tuple[Any, ...]]) -> Float[np.ndarray, "n 4 4"]:
    for key in keys:
        if key not in poses:
            raise InputError(f"{table}: no row {key}, which a candidate needs")
    return np.stack([poses[key] for key in keys]) if keys else np.empty((0, 4, 4))


def _empty_clouds(scenes: Sequence[str], T_base_object: Float[np.ndarray, "s 4 4"]) -> tuple[SceneCloud, ...]:
    no_points, no_types = np.empty((0, 3), dtype=np.float32), np.empty(0, dtype=np.int64)
    return tuple(SceneCloud(scene_id, no_points, no_types, T) for scene_id, T in zip(scenes, T_base_object, strict=True))


def _read_clouds(reader: InputReader, scenes: Sequence[str], T_base_object: Float[np.ndarray, "s 4 4"]) -> tuple[SceneCloud, ...]:
    rows = reader.columns("scene_points", (*KEY_COLUMNS["scene_points"], "x_m", "y_m", "z_m", "point_type"))
    points_m = np.column_stack([rows[name].to_numpy() for name in ("x_m", "y_m", "z_m")]).astype(np.float32)
    types = pc.index_in(rows["point_type"], pa.array(TYPE_NAMES)).to_numpy().astype(np.int64)
    scene_of = pc.fill_null(pc.index_in(rows["scene_id"], pa.array(scenes, pa.string())), -1).to_numpy()
    by_scene = np.argsort(scene_of, kind="stable")
    first = np.searchsorted(scene_of[by_scene], np.arange(len(scenes) + 1))
    clouds = []
    for k, (scene_id, T) in enumerate(zip(scenes, T_base_object, strict=True)):
        mine = by_scene[first[k] : first[k + 1]]
        for needed in (ENVIRONMENT, OBJECT):
            if needed not in types[mine]:
                raise InputError(f"scene_points: {scene_id} has no {TYPE_NAMES[needed]} point, must have at least 1")
        clouds.append(SceneCloud(scene_id, points_m[mine], types[mine], T))
    return tuple(clouds)
