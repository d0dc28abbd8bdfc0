"""From scene points to target-conditioned typed clouds and their neighbourhoods; what a network makes of them is in pointnet2.py.

Everything depends on geometry alone and not on the order of the stored points, so it is computed once when a release is loaded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float32, Int

from model.errors import InputError
from model.inputs import ENVIRONMENT, OBJECT, OBSTACLE, TARGET, ReleaseInputs, SceneCloud
from model.settings import RankerSettings
from tables.poses import inverse


@dataclass(frozen=True, slots=True)
class GroupedClouds:
    """One target-conditioned cloud a fixed-target group, base frame, and who neighbours whom in it.

    The first `n_centres_1` points are the centres of the first neighbourhoods and the first `n_centres_2` those of the second;
    `neighbours_2` counts within the first centres.
    """

    points_m: Float[torch.Tensor, "g n 3"]
    types: Int[torch.Tensor, "g n"]
    neighbours_1: Int[torch.Tensor, "g s1 k1"]
    neighbours_2: Int[torch.Tensor, "g s2 k2"]


def grouped_clouds(inputs: ReleaseInputs, settings: RankerSettings, has_target_copy: bool) -> GroupedClouds:
    """Clouds of all groups of a release, of which there must be at least one.

    In numpy, one cloud after the other: its 256 x 1024 distances fit the cache, and threads only wait for each other here.
    """
    sampled = [sample_cloud(cloud, settings) for cloud in inputs.clouds]
    points, types, first, second = [], [], [], []
    for scene, T_base_target in zip(inputs.group_scene, inputs.T_base_target, strict=True):
        T_to_target = T_base_target @ inverse(inputs.clouds[scene].T_base_object)
        scene_points, scene_types = sampled[scene]
        cloud, numbers = _conditioned(scene_points, scene_types, T_to_target if has_target_copy else None)
        centres_1, centres_2 = cloud[: settings.n_centres_1], cloud[: settings.n_centres_2]
        points.append(cloud)
        types.append(numbers.astype(np.int8))
        first.append(ball_query(cloud, centres_1, settings.radius_1_m, settings.n_neighbours_1).astype(np.int16))
        second.append(ball_query(centres_1, centres_2, settings.radius_2_m, settings.n_neighbours_2).astype(np.int16))
    return GroupedClouds(*(torch.from_numpy(np.stack(parts)) for parts in (points, types, first, second)))


def sample_cloud(cloud: SceneCloud, settings: RankerSettings) -> tuple[Float32[np.ndarray, "n 3"], Int[np.ndarray, "n"]]:
    """The points of a scene in canonical order: a quarter each environment, object, future target and obstacle, farthest-point sampled.

    The types are interleaved, so any leading part of the cloud covers all of them evenly, which is what makes leading points good centres
    and leading neighbours a well-spread sample of a ball. The quarter of the target holds the points of the object, still unmoved.
    Without obstacles their quarter goes to the environment.

    Raises:
        InputError: no environment point lies within the crop.
    """
    quarter = settings.n_points // 4
    points_m, types = cloud.points_m, cloud.point_types
    is_near = np.all(np.abs(points_m - np.array(settings.crop_centre_m)) <= settings.crop_half_m, axis=1)
    environment = points_m[(types == ENVIRONMENT) & is_near]
    if not len(environment):
        raise InputError(
            f"scene_points: {cloud.scene_id} has no environment point within {settings.crop_half_m} m of {settings.crop_centre_m}"
        )
    obstacle = points_m[types == OBSTACLE]
    chosen = {
        ENVIRONMENT: farthest_points(environment, quarter if len(obstacle) else 2 * quarter),
        OBJECT: farthest_points(points_m[types == OBJECT], quarter),
        OBSTACLE: farthest_points(obstacle, quarter if len(obstacle) else 0),
    }
    chosen[TARGET] = chosen[OBJECT]
    parts = sorted(chosen)
    numbers = np.concatenate([np.full(len(chosen[part]), part) for part in parts])
    rank = np.concatenate([(np.arange(len(chosen[part])) + 0.5) / max(len(chosen[part]), 1) for part in parts])
    order = np.lexsort((numbers, rank))
    return np.concatenate([chosen[part] for part in parts])[order], numbers[order]


def farthest_point_order(points_m: Float32[np.ndarray, "n 3"], n_chosen: int) -> Int[np.ndarray, "m"]:
    """Row numbers of farthest-point sampling (Eldar et al. 1997): each next point is the one farthest from all chosen so far.

    Starts at row 0; a tie goes to the lowest row.

    Returns:
        min(n, n_chosen) distinct rows.
    """
    rows = np.zeros(min(len(points_m), n_chosen), dtype=np.int64)
    nearest_m2 = np.full(len(points_m), np.inf, dtype=np.float32)
    x, y, z = np.ascontiguousarray(points_m.T)  # numpy sums several times slower over a last axis of 3
    for k in range(1, len(rows)):
        last = rows[k - 1]
        np.minimum(nearest_m2, np.square(x - x[last]) + np.square(y - y[last]) + np.square(z - z[last]), out=nearest_m2)
        nearest_m2[last] = -1.0  # a chosen point never returns, not even where all points coincide
        rows[k] = nearest_m2.argmax()
    return rows


def ball_query(
    points_m: Float32[np.ndarray, "n 3"], centres_m: Float32[np.ndarray, "s 3"], radius_m: float, n_neighbours: int
) -> Int[np.ndarray, "s k"]:
    """The first `n_neighbours` points, in point order, within `radius_m` of each centre; a short list repeats its first point.

    Every centre must be one of the points, so that no list is empty.
    """
    x, y, z = (np.square(centres_m[:, None, axis] - points_m[None, :, axis]) for axis in range(3))
    row, number = np.divmod(np.flatnonzero(x + y + z <= np.float32(radius_m * radius_m)), len(points_m))  # row by row, numbers ascending
    first_of_row = np.searchsorted(row, np.arange(len(centres_m)))
    rank = np.arange(len(row)) - first_of_row[row]
    k = min(n_neighbours, len(points_m))
    found = np.repeat(number[first_of_row][:, None], k, axis=1)
    found[row[rank < k], rank[rank < k]] = number[rank < k]
    return found


def farthest_points(points_m: Float32[np.ndarray, "n 3"], n_chosen: int) -> Float32[np.ndarray, "n_chosen 3"]:
    """`n_chosen` points in farthest-point order from the lexicographically first; too few points are repeated in the same order."""
    if n_chosen == 0:
        return np.empty((0, 3), dtype=np.float32)
    canonical = points_m[np.lexsort(points_m.T[::-1])]
    rows = farthest_point_order(canonical, n_chosen)
    return canonical[np.resize(rows, n_chosen)]


def _conditioned(
    points_m: Float32[np.ndarray, "n 3"], types: Int[np.ndarray, "n"], T_to_target: Float[np.ndarray, "4 4"] | None
) -> tuple[Float32[np.ndarray, "m 3"], Int[np.ndarray, "m"]]:
    """Move the points of the target copy by T_base_target @ inv(T_base_object), or leave them out."""
    is_target = types == TARGET
    if T_to_target is None:
        return points_m[~is_target], types[~is_target]
    moved = points_m.copy()
    moved[is_target] = points_m[is_target].astype(np.float64) @ T_to_target[:3, :3].T + T_to_target[:3, 3]
    return moved, types
