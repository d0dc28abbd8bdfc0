"""Whether anything of one split can be known from another: shared groups, shared candidates, scenes that are all but the same.

scene_groups.py and schemes.py assign scenes to splits; this module does not trust them and looks at the tables. What each scheme promises
is asked of the scheme's own column: objects of one split alone, a category or an obstacle count of test alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from itertools import combinations

import numpy as np
import polars as pl
import pyarrow as pa
from jaxtyping import Bool, Float
from scipy.optimize import linear_sum_assignment

from pipelines.frames import frame_of
from tables.identity import IdentityError, parse_candidate_id
from tables.poses import matrix_of, pose_columns, rotation_angle_rad
from tables.vocabulary import Split, SplitScheme, Symmetry

# Closer than this two scenes look the same to a depth camera and to a planner, and nearly the same placement:
# within the tolerances of the recipe (7.5 mm, 5 degrees) with room to spare.
POSITION_TOLERANCE_M = 0.005
ROTATION_TOLERANCE_RAD = math.radians(3.0)


# What the test split of a scheme has all of and nothing else: the fact of a scene and its value.
_HELD_OUT = {
    SplitScheme.CATEGORY_CAN: ("category", "can"),
    SplitScheme.CATEGORY_MUG: ("category", "mug"),
    SplitScheme.CATEGORY_CUBOID: ("category", "cuboid"),
    SplitScheme.LAYOUT: ("obstacles", 2),
}


class LeakKind(StrEnum):
    """What leaked."""

    SCENE_IN_TWO_SPLITS = "scene_in_two_splits"
    SCENE_WITHOUT_SPLIT = "scene_without_split"
    CANDIDATE_IN_TWO_GROUPS = "candidate_in_two_groups"
    CANDIDATE_OF_ANOTHER_SCENE = "candidate_of_another_scene"
    NEAR_IDENTICAL_SCENES = "near_identical_scenes"
    OBJECT_IN_TWO_SPLITS = "object_in_two_splits"
    NOT_HELD_OUT = "not_held_out"


@dataclass(frozen=True, slots=True)
class Leak:
    """One leak: its kind, the ids concerned, and what was found."""

    kind: LeakKind
    ids: tuple[str, ...]
    found: str

    def __str__(self) -> str:
        return f"{self.kind.value}: {', '.join(self.ids)}: {self.found}"


@dataclass(frozen=True, slots=True)
class _Geometry:
    """What a scene looks like; obstacles and targets are sets, their order says nothing."""

    scene_id: str
    T_base_object: Float[np.ndarray, "4 4"]
    T_base_obstacles: Float[np.ndarray, "o 4 4"]
    obstacle_sizes_m: Float[np.ndarray, "o 3"]
    T_base_targets: Float[np.ndarray, "t 4 4"]


def find_leaks(
    tables: Mapping[str, pa.Table],
    *,
    position_tolerance_m: float = POSITION_TOLERANCE_M,
    rotation_tolerance_rad: float = ROTATION_TOLERANCE_RAD,
) -> list[Leak]:
    """Every leak in a release; empty for a sound one.

    Two scenes are near-identical when they hold the same object, and the pose of the object, all obstacles and all targets agree
    within the tolerances, each modulo symmetry and in any order. Only pairs across two splits of a scheme are leaks.

    Args:
        tables: at least `objects`, `scenes`, `obstacles`, `targets`, `candidates` and `splits`.
        position_tolerance_m: largest distance, and difference of two edges of obstacles, that counts as the same.
        rotation_tolerance_rad: largest turn that counts as the same.
    """
    frames = {name: frame_of(tables[name]) for name in ("objects", "scenes", "obstacles", "targets", "splits")}
    candidates = frame_of(tables["candidates"], ["candidate_id", "scene_id", "target_id"])
    return [
        *_scenes_in_two_splits(frames["splits"]),
        *_scenes_without_split(frames["scenes"], candidates, frames["splits"]),
        *_candidates_in_two_groups(candidates),
        *_candidates_of_another_scene(candidates),
        *_near_identical_scenes(frames, position_tolerance_m, rotation_tolerance_rad),
        *_objects_in_two_splits(frames),
        *_not_held_out(frames),
    ]


def _scenes_in_two_splits(splits: pl.DataFrame) -> Iterator[Leak]:
    for scheme in SplitScheme:
        for scene_id, names in _in_several(splits, "scene_id", scheme):
            yield Leak(LeakKind.SCENE_IN_TWO_SPLITS, (scene_id,), f"in {len(names)} splits{_of(scheme)} ({', '.join(names)}), must be in 1")


def _scenes_without_split(scenes: pl.DataFrame, candidates: pl.DataFrame, splits: pl.DataFrame) -> Iterator[Leak]:
    known = pl.concat([scenes.select("scene_id"), candidates.select("scene_id")]).unique()
    for (scene_id,) in known.join(splits, on="scene_id", how="anti").sort("scene_id").iter_rows():
        yield Leak(LeakKind.SCENE_WITHOUT_SPLIT, (scene_id,), "in 0 splits, must be in 1")


def _candidates_in_two_groups(candidates: pl.DataFrame) -> Iterator[Leak]:
    groups = candidates.group_by("candidate_id").agg(pl.format("{}-t{}", "scene_id", "target_id").unique().sort().alias("groups"))
    for candidate_id, names in groups.filter(pl.col("groups").list.len() > 1).sort("candidate_id").iter_rows():
        yield Leak(LeakKind.CANDIDATE_IN_TWO_GROUPS, (candidate_id,), f"in {len(names)} groups ({', '.join(names)}), must be in 1")


def _candidates_of_another_scene(candidates: pl.DataFrame) -> Iterator[Leak]:
    for candidate_id, scene_id, target_id in candidates.sort("candidate_id").iter_rows():
        try:
            own = parse_candidate_id(candidate_id)
        except IdentityError as error:
            yield Leak(LeakKind.CANDIDATE_OF_ANOTHER_SCENE, (candidate_id,), str(error))
            continue
        if (own.scene_id, own.target_id) != (scene_id, target_id):
            yield Leak(LeakKind.CANDIDATE_OF_ANOTHER_SCENE, (candidate_id,), f"listed under scene {scene_id}, target {target_id}")


def _near_identical_scenes(
    frames: Mapping[str, pl.DataFrame], position_tolerance_m: float, rotation_tolerance_rad: float
) -> Iterator[Leak]:
    columns = [scheme.column for scheme in SplitScheme]
    splits_of = {scene_id: splits for scene_id, *splits in frames["splits"].select("scene_id", *columns).iter_rows()}
    without = [None] * len(columns)
    symmetry_of = {object_id: Symmetry(value) for object_id, value in frames["objects"].select("object_id", "symmetry").iter_rows()}
    for object_id, geometries in _geometries(frames).items():
        positions_m = np.stack([geometry.T_base_object[:3, 3] for geometry in geometries])
        for i, j in combinations(range(len(geometries)), 2):
            a, b = geometries[i], geometries[j]
            pairs = list(zip(SplitScheme, splits_of.get(a.scene_id, without), splits_of.get(b.scene_id, without), strict=True))
            across = [f"{of_a} and {of_b}{_of(scheme)}" for scheme, of_a, of_b in pairs if of_a != of_b]
            if not across:
                continue
            # Most pairs end here; the rest of the comparison costs a hundred times more.
            if np.linalg.norm(positions_m[i] - positions_m[j]) > position_tolerance_m:
                continue
            if _is_same(a, b, symmetry_of[object_id], position_tolerance_m, rotation_tolerance_rad):
                yield Leak(
                    LeakKind.NEAR_IDENTICAL_SCENES,
                    (a.scene_id, b.scene_id),
                    f"{object_id}, obstacles and targets within {position_tolerance_m * 1e3:g} mm and"
                    f" {math.degrees(rotation_tolerance_rad):g} deg, in {', '.join(across)}",
                )


def _objects_in_two_splits(frames: Mapping[str, pl.DataFrame]) -> Iterator[Leak]:
    scenes = frames["scenes"].select("scene_id", "object_id").join(frames["splits"], on="scene_id")
    for object_id, names in _in_several(scenes, "object_id", SplitScheme.OBJECT):
        found = f"in {len(names)} splits{_of(SplitScheme.OBJECT)} ({', '.join(names)}), must be in 1"
        yield Leak(LeakKind.OBJECT_IN_TWO_SPLITS, (object_id,), found)


def _not_held_out(frames: Mapping[str, pl.DataFrame]) -> Iterator[Leak]:
    """Scenes on the wrong side of a scheme; category and obstacle count are those of the object and of the obstacles that there are."""
    facts = (
        frames["scenes"]
        .select("scene_id", "object_id")
        .join(frames["objects"].select("object_id", "category"), on="object_id", how="left")
        .join(frames["obstacles"].group_by("scene_id").len("obstacles"), on="scene_id", how="left")
        .with_columns(pl.col("obstacles").fill_null(0))
        .join(frames["splits"], on="scene_id")
        .sort("scene_id")
    )
    for scheme, (fact, value) in _HELD_OUT.items():
        is_test = pl.col(scheme.column) == Split.TEST.value
        wrong = facts.filter(pl.col(fact).eq_missing(pl.lit(value)) != is_test)
        for scene_id, found, split in wrong.select("scene_id", fact, scheme.column).iter_rows():
            bound = f"test must have all scenes with {fact} {value} and no other"
            yield Leak(LeakKind.NOT_HELD_OUT, (scene_id,), f"{fact} {found} in {split}{_of(scheme)}, whose {bound}")


def _in_several(frame: pl.DataFrame, key: str, scheme: SplitScheme) -> Iterator[tuple[str, list[str]]]:
    """Values of a key whose rows are in more than one split of a scheme, and these splits."""
    found = frame.group_by(key).agg(pl.col(scheme.column).drop_nulls().unique().sort().alias("names"))
    yield from found.filter(pl.col("names").list.len() > 1).sort(key).iter_rows()


def _of(scheme: SplitScheme) -> str:
    return "" if scheme is SplitScheme.SCENE else f" of scheme {scheme.value}"


def _geometries(frames: Mapping[str, pl.DataFrame]) -> dict[str, list[_Geometry]]:
    """Scenes by object, in scene order."""
    obstacles = frames["obstacles"].partition_by("scene_id", as_dict=True)
    targets = frames["targets"].partition_by("scene_id", as_dict=True)
    by_object: dict[str, list[_Geometry]] = {}
    for row in frames["scenes"].sort("scene_id").iter_rows(named=True):
        key = (row["scene_id"],)
        boxes = obstacles.get(key, frames["obstacles"].clear())
        geometry = _Geometry(
            row["scene_id"],
            matrix_of(np.array([row[name] for name in pose_columns("object")])),
            matrix_of(boxes.select(pose_columns("obstacle")).to_numpy()),
            boxes.select("size_x_m", "size_y_m", "size_z_m").to_numpy(),
            matrix_of(targets.get(key, frames["targets"].clear()).select(pose_columns("target")).to_numpy()),
        )
        by_object.setdefault(row["object_id"], []).append(geometry)
    return by_object


def _is_same(a: _Geometry, b: _Geometry, symmetry: Symmetry, position_tolerance_m: float, rotation_tolerance_rad: float) -> bool:
    same_object = _close(a.T_base_object[None], b.T_base_object[None], symmetry, position_tolerance_m, rotation_tolerance_rad)
    same_box = _close(a.T_base_obstacles, b.T_base_obstacles, Symmetry.BOX, position_tolerance_m, rotation_tolerance_rad)
    same_size = np.abs(a.obstacle_sizes_m[:, None] - b.obstacle_sizes_m[None]).max(axis=-1, initial=0.0) <= position_tolerance_m
    same_target = _close(a.T_base_targets, b.T_base_targets, symmetry, position_tolerance_m, rotation_tolerance_rad)
    return _is_matching(same_object) and _is_matching(same_box & same_size) and _is_matching(same_target)


def _close(
    T_a: Float[np.ndarray, "m 4 4"],
    T_b: Float[np.ndarray, "n 4 4"],
    symmetry: Symmetry,
    position_tolerance_m: float,
    rotation_tolerance_rad: float,
) -> Bool[np.ndarray, "m n"]:
    distance_m = np.linalg.norm(T_a[:, None, :3, 3] - T_b[None, :, :3, 3], axis=-1)
    turn_rad = _turn_rad(T_a[:, None, :3, :3], T_b[None, :, :3, :3], symmetry)
    return np.asarray((distance_m <= position_tolerance_m) & (turn_rad <= rotation_tolerance_rad))


def _turn_rad(R_a: Float[np.ndarray, "*n 3 3"], R_b: Float[np.ndarray, "*n 3 3"], symmetry: Symmetry) -> Float[np.ndarray, "*n"]:
    """Smallest turn between orientations modulo symmetry, in [0, pi]; the batch form of what `ObjectModel` computes for one pair."""
    if symmetry is Symmetry.REVOLUTION_Z:
        z_a, z_b = R_a[..., :, 2], R_b[..., :, 2]
        return np.asarray(np.arctan2(np.linalg.norm(np.cross(z_a, z_b), axis=-1), np.sum(z_a * z_b, axis=-1)))
    half_turns = [(1.0, 1.0, 1.0), (1.0, -1.0, -1.0), (-1.0, 1.0, -1.0), (-1.0, -1.0, 1.0)]
    kept = half_turns if symmetry is Symmetry.BOX else half_turns[:1]
    return np.asarray(np.min([rotation_angle_rad(R_a * np.array(signs), R_b) for signs in kept], axis=0))


def _is_matching(is_close: Bool[np.ndarray, "m n"]) -> bool:
    """Whether every row pairs with a column of its own and none is left over."""
    if is_close.shape[0] != is_close.shape[1]:
        return False
    rows, columns = linear_sum_assignment(~is_close)
    return bool(is_close[rows, columns].all())
