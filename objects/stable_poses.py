"""Resting poses of an object on a horizontal plane, merged by symmetry.

Whether they hold in physics is found out when a scene is drawn, see pipelines/scenes/sampling.py. The quasi-static estimate of Goldberg
et al., "Part pose statistics" (IJRR 1999), as trimesh computes it: dropped at a random orientation, the object tumbles over the edges of
its convex hull until the centre of mass stays above a facet.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import trimesh
from jaxtyping import Float
from scipy.spatial import ConvexHull

from objects.catalogue import ObjectSpec
from objects.errors import ObjectParamsError, StablePoseError
from objects.object_model import StablePose
from tables.vocabulary import Category, Symmetry


@dataclass(frozen=True, slots=True)
class StablePoseParams:
    """What counts as a resting pose of its own."""

    # Keeps the barely stable ones (an aerosol can on its head: 1.3 %); below lie slivers between facets.
    min_probability: float = 0.005
    # A mug balanced on one of the 60 facets of its body tips at up to half a facet, 3 degrees: an artefact of the mesh. The real pose
    # on the side leans on the handle and tips over the first facet at 3.6 degrees or more; tall boxes on end tip at 10 and more.
    min_tip_rad: float = 0.055
    # Two poses of an object without symmetry that are closer than this are one pose on two facets.
    merge_rad: float = 0.14

    def __post_init__(self) -> None:
        for name, low, high in (("min_probability", 0.0, 0.5), ("min_tip_rad", 0.0, 0.5), ("merge_rad", 0.0, 0.5)):
            value = getattr(self, name)
            if not low <= value <= high:
                raise ObjectParamsError(f"StablePoseParams.{name} = {value}, must be in [{low}, {high}]")


def stable_poses(
    spec: ObjectSpec, mesh: trimesh.Trimesh, com_m: Float[np.ndarray, "3"], params: StablePoseParams
) -> tuple[StablePose, ...]:
    """Distinct resting poses, the most probable first; their probabilities sum to 1.

    Args:
        com_m: centre of mass in the object frame.

    Raises:
        StablePoseError: the centre of mass lies outside the convex hull, or no pose passes the bounds.
    """
    hull = mesh.convex_hull
    inside = -float(np.einsum("ij,ij->i", hull.face_normals, com_m - hull.triangles_center).max())
    if inside <= 0.0:
        raise StablePoseError(f"{spec.object_id}: centre of mass {-inside:.4f} m outside the convex hull, must be inside")
    merged = _merged(spec, _rests(hull, com_m), com_m, params)
    kept = [r for r in merged if r.probability >= params.min_probability and (r.tip_rad >= params.min_tip_rad or _rolls(spec, r.down))]
    if not kept:
        best = max((r.tip_rad for r in merged), default=0.0)
        raise StablePoseError(f"{spec.object_id}: no stable pose, the best tips at {best:.3f} rad, must be at least {params.min_tip_rad}")
    total = sum(rest.probability for rest in kept)
    names = _distinct([_name(spec, rest.down, com_m) for rest in kept])
    return tuple(
        StablePose(k, name, rest.probability / total, _resting(mesh, rest.down))
        for k, (name, rest) in enumerate(zip(names, kept, strict=True))
    )


@dataclass(frozen=True, slots=True)
class _Rest:
    """A flat side to rest on: which way is down in the object frame, how likely, at which angle it tips."""

    down: Float[np.ndarray, "3"]
    probability: float
    tip_rad: float


def _rests(hull: trimesh.Trimesh, com_m: Float[np.ndarray, "3"]) -> list[_Rest]:
    transforms, probabilities = trimesh.poses.compute_stable_poses(hull, center_mass=com_m, sigma=0.0, n_samples=1, threshold=0.0)
    rests = []
    for T, probability in zip(transforms, probabilities, strict=True):
        down = -np.asarray(T[2, :3])
        rests.append(_Rest(down, float(probability), _tip_angle(hull, com_m, down)))
    return sorted(rests, key=_order)


def _order(rest: _Rest) -> tuple[float, ...]:
    """Most probable first; ties, up to rounding, by direction."""
    return (-round(rest.probability, 9), *np.round(rest.down, 6).tolist())


def _tip_angle(hull: trimesh.Trimesh, com_m: Float[np.ndarray, "3"], down: Float[np.ndarray, "3"]) -> float:
    """Smallest tilt that moves the centre of mass over the rim of the support polygon; 0 where it already is."""
    depth = hull.vertices @ down
    support = hull.vertices[depth > depth.max() - 1e-5]
    across = np.linalg.svd(down[None])[2][1:]
    outline = ConvexHull(support @ across.T)
    reach = -float((outline.equations[:, :2] @ (across @ com_m) + outline.equations[:, 2]).max())
    height = float(depth.max() - com_m @ down)
    return max(0.0, math.atan2(reach, height))


def _merged(spec: ObjectSpec, rests: list[_Rest], com_m: Float[np.ndarray, "3"], params: StablePoseParams) -> list[_Rest]:
    merged: list[_Rest] = []
    for rest in rests:
        for k, kept in enumerate(merged):
            if _is_same(spec, kept.down, rest.down, com_m, params):
                merged[k] = replace(kept, probability=kept.probability + rest.probability)
                break
        else:
            merged.append(rest)
    return sorted(merged, key=_order)


def _is_same(
    spec: ObjectSpec,
    down_a: Float[np.ndarray, "3"],
    down_b: Float[np.ndarray, "3"],
    com_m: Float[np.ndarray, "3"],
    params: StablePoseParams,
) -> bool:
    """Whether a symmetry of the object, its centre of mass included, or a small turn maps one pose to the other."""
    if spec.symmetry is Symmetry.REVOLUTION_Z:
        tilts = (math.atan2(math.hypot(d[0], d[1]), d[2]) for d in (down_a, down_b))
        return abs(next(tilts) - next(tilts)) < params.merge_rad
    turned = [np.array(turn) * down_b for turn in _turns(spec, com_m)]
    return any(math.acos(min(1.0, max(-1.0, float(down_a @ down)))) < params.merge_rad for down in turned)


def _turns(spec: ObjectSpec, com_m: Float[np.ndarray, "3"]) -> list[tuple[float, float, float]]:
    """Diagonals of the half turns that leave the object and its centre of mass in place."""
    turns = [(1.0, 1.0, 1.0)]
    if spec.symmetry is Symmetry.BOX:
        half_turns = [(1.0, -1.0, -1.0), (-1.0, 1.0, -1.0), (-1.0, -1.0, 1.0)]
        turns += [turn for turn in half_turns if np.allclose(np.array(turn) * com_m, com_m, atol=5e-4)]
    return turns


def _rolls(spec: ObjectSpec, down: Float[np.ndarray, "3"]) -> bool:
    """A round object on its round side: neutral, so its facets need not hold it."""
    return spec.symmetry is Symmetry.REVOLUTION_Z and abs(down[2]) < _ALONG


_ALONG = 0.9  # cosine above which a direction counts as along an axis


def _name(spec: ObjectSpec, down: Float[np.ndarray, "3"], com_m: Float[np.ndarray, "3"]) -> str:
    """Name of a pose by the side that is down."""
    axis = int(np.argmax(np.abs(down)))
    if spec.category in (Category.CAN, Category.MUG) and abs(down[2]) > _ALONG:
        return "upright" if down[2] < 0.0 else "inverted"
    if spec.category is Category.CAN:
        return "lying"
    if spec.category is Category.MUG:
        # On its side a mug rolls until the handle touches the table, left or right of it.
        return f"on_side_{'left' if down[1] > 0.0 else 'right'}"
    if abs(down[axis]) > _ALONG:
        merges = spec.symmetry is Symmetry.BOX and any(turn[axis] < 0.0 for turn in _turns(spec, com_m))
        return f"face_{'' if merges else '-' if down[axis] < 0.0 else '+'}{'xyz'[axis]}"
    return "tilted"


def _distinct(names: list[str]) -> list[str]:
    """Names with _2, _3 ... on repeats."""
    return [name if name not in names[:k] else f"{name}_{names[:k].count(name) + 1}" for k, name in enumerate(names)]


def _resting(mesh: trimesh.Trimesh, down: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 4"]:
    """T_plane_object: the side `down` on z = 0, origin above x = y = 0, by the smallest turn that gets there."""
    T = np.eye(4)
    T[:3, :3] = _turn_down(down)
    T[2, 3] = -float((mesh.vertices @ T[2, :3]).min())
    return T


def _turn_down(down: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """The smallest rotation that maps `down` to -z (Rodrigues); about x where it is a half turn."""
    axis, cosine = np.cross(down, [0.0, 0.0, -1.0]), -float(down[2])
    if np.linalg.norm(axis) < 1e-9:
        return np.eye(3) if cosine > 0.0 else np.diag([1.0, -1.0, -1.0])
    K = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    return np.asarray(np.eye(3) + K + K @ K / (1.0 + cosine))
