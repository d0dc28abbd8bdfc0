"""The grasp pool: diverse antipodal grasps on one object, in its own frame; see pipelines/grasps/admission.py for a scene and the arm.

Contact pairs come from ray casting (contacts), each is approached from several directions about the jaw line, the clearance
of the gripper is tested (clearance), and the pool is chosen by farthest points in pose space, evenly over resting poses and kinds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int

from objects.catalogue import ObjectSpec
from objects.clearance import GripperClearance, clears_table, reach_chance
from objects.contacts import ContactPairs, antipodal_pairs, perpendicular, sharp_edge_distance, surface_points
from objects.errors import GraspError, ObjectParamsError
from objects.grasp_kinds import NO_KIND, grasp_kinds
from objects.gripper import MAX_JAW_M, OPEN_CLEARANCE_M
from objects.object_model import PoolGrasp, StablePose, TriangleMesh
from tables.identity import rng_for
from tables.vocabulary import Category

GRAVITY_M_S2 = 9.81
# Friction of the objects that torque limits are stated for; the torque that pads hold grows with friction.
TRIED_FRICTION = 0.8
_N_PROBES = 300  # on a cracker box one every 18 mm: a quick test only, the exact one follows


@dataclass(frozen=True, slots=True)
class GraspPoolParams:
    """How grasps are sampled, which are refused, and how the pool is chosen."""

    n_grasps: int = 64
    # Half a pool. Below this an object that a user adds is refused: no scene could be found for it, or hardly any. A recipe checks that
    # it is at least what a scene asks for.
    min_grasps: int = 32
    n_surface_samples: int = 1500
    # Most hit the table or the object with the hand; the side of a mug needs this many to find the few that do not.
    n_candidates: int = 24_000
    # Friction cone of a pad, tan(angle): contacts within it. See pipelines/recipe.toml.
    friction: float = 0.32
    # Pads are flat: a contact off the normal is none of the middle of the pad. 0.05 rad is 1.6 mm on a 66 mm can.
    jitter_rad: float = 0.05
    # Contacts to the next sharp edge: nearer than 4 mm, less than two thirds of a pad of 17.5 x 18.5 mm hold. See pipelines/recipe.toml.
    edge_margin_m: float = 0.002
    # Palm contact poisons later labels: the object shifts in the hand, the retreat is blocked.
    palm_clearance_m: float = 0.004
    # The play of the jaw on each side of the widest grasp.
    finger_clearance_m: float = 0.0025
    # A finger may touch the object this far before its contact: a flat pad in a round cavity does by 1 to 2 mm, the convex parts
    # of the cavity add 1.4, and 4 mm over half a pad is a skew of 23 degrees.
    skew_m: float = 0.004
    approach_m: float = 0.10
    # Hand to table: what admission demands, and a millimetre.
    table_clearance_m: float = 0.003
    # How far along the approach the contacts lie from the middle of the pads (tips are 9.5 mm beyond it). See pipelines/recipe.toml.
    depths_m: tuple[float, ...] = (-0.0035, -0.00175, 0.0, 0.00175, 0.0035)
    n_approach_turns: int = 24
    # Torque of the weight about the jaw line when the object is lifted off the table, for objects of TRIED_FRICTION: pads that press 50 N
    # evenly turn at 2 x 0.8 x 0.8 x 50 N x 6.9 mm = 0.44 N m, and where they touch a can along a line at 0.7 of it (4.8 mm of lever).
    # See pipelines/recipe.toml.
    max_torque_n_m: float = 0.22
    line_contact_share: float = 0.70
    # Pose distance: 20 mm count as much as 30 degrees; a gripper turned half round about its approach is the same grasp here.
    length_scale_m: float = 0.02
    angle_scale_rad: float = math.pi / 6
    # Nearer than this in pose distance, two grasps are duplicates (4 mm or 6 degrees).
    min_distance: float = 0.2
    # Shares of the pool, divided among the kinds that an object has.
    shares: Mapping[str, float] = field(
        default_factory=lambda: {
            "side": 0.55, "top": 0.20, "bottom": 0.10, "caps": 0.25,
            "rim": 0.40, "handle": 0.30, "body": 0.40,
            "face_x": 0.34, "face_y": 0.33, "face_z": 0.33, "grip": 1.0,
        }
    )  # fmt: skip

    def __post_init__(self) -> None:
        for name, low, high in (
            ("n_grasps", 1, 100),
            ("min_grasps", 1, self.n_grasps),
            ("n_surface_samples", 100, 100_000),
            ("n_candidates", self.n_grasps, 100_000),
            ("friction", 0.05, 2.0),
            ("jitter_rad", 0.0, 0.6),
            ("edge_margin_m", 0.0, 0.02),
            ("palm_clearance_m", 0.0, 0.02),
            ("finger_clearance_m", 0.0, OPEN_CLEARANCE_M),
            ("skew_m", 0.0005, OPEN_CLEARANCE_M),
            ("approach_m", 0.0, 0.3),
            ("table_clearance_m", 0.0, 0.02),
            ("n_approach_turns", 4, 360),
            ("max_torque_n_m", 0.01, 10.0),
            ("line_contact_share", 0.1, 1.0),
            ("length_scale_m", 0.001, 1.0),
            ("angle_scale_rad", 0.01, math.pi),
            ("min_distance", 0.0, 1.0),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise ObjectParamsError(f"GraspPoolParams.{name} = {value}, must be in [{low}, {high}]")
        if not self.depths_m or max(map(abs, self.depths_m)) > 0.007:
            raise ObjectParamsError(f"GraspPoolParams.depths_m = {self.depths_m}, must lie in [-0.007, 0.007] m, on the pads")
        if min(self.shares.values(), default=0.0) <= 0.0:
            raise ObjectParamsError(f"GraspPoolParams.shares = {dict(self.shares)}, must be positive")

    @property
    def max_width_m(self) -> float:
        return MAX_JAW_M - 2 * self.finger_clearance_m


@dataclass(frozen=True, slots=True)
class RatedGrasp:
    """A pool grasp, its friction-cone margin and the distance of the centre of mass from its jaw line."""

    grasp: PoolGrasp
    cone_margin_rad: float
    com_distance_m: float


def grasp_pool(
    spec: ObjectSpec,
    mesh: trimesh.Trimesh,
    parts: tuple[TriangleMesh, ...],
    com_m: Float[np.ndarray, "3"],
    rests: tuple[StablePose, ...],
    params: GraspPoolParams,
    seed: int,
) -> tuple[RatedGrasp, ...]:
    """The pool, in an order of which every prefix is spread over resting poses, kinds and directions.

    Raises:
        GraspError: the object is too wide for the jaw, or too few grasps pass.
    """
    rng = rng_for(seed, "grasp_pool", spec.object_id)
    cone_rad = math.atan(params.friction)
    pairs, narrowest = antipodal_pairs(mesh, params.n_surface_samples, cone_rad, params.jitter_rad, params.max_width_m, rng)
    if not len(pairs.a_m):
        raise GraspError(f"{spec.object_id}: smallest graspable width {narrowest:.4f} m, must be at most {params.max_width_m:.4f}")
    edge_m = np.minimum(sharp_edge_distance(mesh, pairs.a_m), sharp_edge_distance(mesh, pairs.b_m))
    pairs = pairs.where(edge_m >= params.edge_margin_m)
    if not len(pairs.a_m):
        raise GraspError(
            f"{spec.object_id}: contacts lie {edge_m.max():.4f} m or less from an edge, must be at least {params.edge_margin_m}"
        )
    candidates = _candidates(spec, pairs, com_m, rests, params, rng)
    candidates = candidates.where(np.any(candidates.serves > 0.0, axis=1))
    probes, _ = surface_points(mesh, _N_PROBES, rng)
    clearance = GripperClearance(parts, probes, params.palm_clearance_m, params.skew_m, params.approach_m)
    candidates = candidates.where(clearance.may_be_free(candidates.T))
    chosen = _choice(candidates, clearance, params)
    if len(chosen) < params.min_grasps:
        raise GraspError(f"{spec.object_id}: {len(chosen)} distinct grasps free of the object, must be at least {params.min_grasps}")
    margin = cone_rad - candidates.pairs.contact_angle_rad()
    distance, width = _com_distance(candidates.pairs, com_m), candidates.pairs.width_m
    return tuple(
        RatedGrasp(PoolGrasp(k, candidates.kind[i], candidates.T[i], float(width[i])), float(margin[i]), float(distance[i]))
        for k, i in enumerate(chosen)
    )


@dataclass(frozen=True, slots=True)
class _Candidates:
    """Grasps under consideration: contacts, kind, how likely each serves in each resting pose, and a rating in [0, 1]."""

    T: Float[np.ndarray, "n 4 4"]
    pairs: ContactPairs
    kind: list[str]
    serves: Float[np.ndarray, "n k"]
    rating: Float[np.ndarray, "n"]

    def where(self, keep: Bool[np.ndarray, "n"]) -> _Candidates:
        index = np.flatnonzero(keep)
        return _Candidates(self.T[index], self.pairs.where(index), [self.kind[i] for i in index], self.serves[index], self.rating[index])


def _candidates(
    spec: ObjectSpec,
    pairs: ContactPairs,
    com_m: Float[np.ndarray, "3"],
    rests: tuple[StablePose, ...],
    params: GraspPoolParams,
    rng: np.random.Generator,
) -> _Candidates:
    """Approaches about the jaw lines of contact pairs: a pair, a turn, a depth and which finger is left, all at random."""
    n = params.n_candidates
    pairs = pairs.where(_evenly(grasp_kinds(spec, np.tile(np.eye(4), (len(pairs.a_m), 1, 1)), pairs), n, rng))
    turn = rng.integers(params.n_approach_turns, size=n) * (2 * np.pi / params.n_approach_turns)
    depth = np.array(params.depths_m)[rng.integers(len(params.depths_m), size=n)]
    flip = np.where(rng.random(n) < 0.5, 1.0, -1.0)
    side_1, side_2 = perpendicular(pairs.axis)
    approach = np.cos(turn)[:, None] * side_1 + np.sin(turn)[:, None] * side_2
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, :3, 1] = flip[:, None] * pairs.axis
    T[:, :3, 2] = approach
    T[:, :3, 0] = np.cross(T[:, :3, 1], approach)
    T[:, :3, 3] = (pairs.a_m + pairs.b_m) / 2 + depth[:, None] * approach
    serves = np.stack([_serves(spec, rest, T, pairs, com_m, params) for rest in rests], axis=1)
    # A grasp that serves several resting poses can turn the object from one to another; one that serves a single pose surely is as good.
    rating = (serves.mean(axis=1) + serves.max(axis=1)) / 2
    # People approach along the axes of an object.
    rating *= np.where(np.abs(approach).max(axis=1) > np.cos(np.radians(1.0)), 1.0, 0.75)
    return _Candidates(T, pairs, grasp_kinds(spec, T, pairs), serves, rating)


def _serves(
    spec: ObjectSpec,
    rest: StablePose,
    T: Float[np.ndarray, "n 4 4"],
    pairs: ContactPairs,
    com_m: Float[np.ndarray, "3"],
    params: GraspPoolParams,
) -> Float[np.ndarray, "n"]:
    """How likely each grasp lifts the object off a resting pose: 0 where the table is in the way or the object turns in the hand."""
    T_plane_grasp = rest.T_plane_object @ T
    clear = clears_table(T_plane_grasp, pairs.width_m, params.table_clearance_m, params.approach_m)
    weight_n = spec.mass_kg * GRAVITY_M_S2 * rest.T_plane_object[2, :3]
    torque_n_m = np.abs(np.einsum("nj,nj->n", np.cross(com_m - pairs.a_m, weight_n), pairs.axis))
    most_n_m = params.max_torque_n_m * spec.friction / TRIED_FRICTION
    load = torque_n_m / (most_n_m * (params.line_contact_share if spec.category is Category.CAN else 1.0))
    return np.where(clear & (load <= 1.0), reach_chance(T_plane_grasp) * (1.0 - 0.3 * load), 0.0)


def _evenly(kinds: list[str], n: int, rng: np.random.Generator) -> Int[np.ndarray, "n"]:
    """n draws in which every kind is as likely as the others, so that a small handle is not lost beside a large wall.

    A kind with less than one pair in a hundred is a corner of the geometry, not a way to hold the object: it is not drawn.
    """
    names, which = np.unique(kinds, return_inverse=True)
    count = np.bincount(which)
    weight = np.where((count >= len(kinds) / 100) & (names != NO_KIND), 1.0 / count, 0.0)[which]
    return rng.choice(len(kinds), size=n, p=weight / weight.sum())


def _com_distance(pairs: ContactPairs, com_m: Float[np.ndarray, "3"]) -> Float[np.ndarray, "n"]:
    offset = com_m - pairs.a_m
    return np.asarray(np.linalg.norm(offset - np.einsum("ij,ij->i", offset, pairs.axis)[:, None] * pairs.axis, axis=1))


def _choice(candidates: _Candidates, clearance: GripperClearance, params: GraspPoolParams) -> list[int]:
    """Numbers of the chosen candidates, in an order of which every prefix serves all resting poses and kinds.

    Twice in three, the resting pose that the chosen grasps serve least and for it the kind that lags most behind its share; else the
    kind that lags most, for whatever pose. Among those, the grasp farthest from all chosen, its distance weighed by its rating, is
    taken if it is free of the object.
    """
    kinds = sorted(set(candidates.kind), key=list(params.shares).index)
    share = np.array([params.shares[kind] for kind in kinds])
    kind = np.array([kinds.index(k) for k in candidates.kind], dtype=np.int64)
    served, filled = np.zeros((len(kinds), candidates.serves.shape[1])), np.zeros(len(kinds))
    nearest = np.full(len(kind), 1e6)
    chosen: list[int] = []
    while len(chosen) < params.n_grasps and np.any(nearest >= params.min_distance):
        is_open = nearest >= params.min_distance
        usable = is_open[:, None] & (candidates.serves > 0.0)
        left = np.stack([np.any(usable[kind == k], axis=0) for k in range(len(kinds))])
        if len(chosen) % 3 == 2:
            k = _least((filled + 1.0) / share, np.any(left, axis=1))
            suits = is_open & (kind == k)
        else:
            pose = _least(served.sum(axis=0), np.any(left, axis=0))
            k = _least((served[:, pose] + 1.0) / share, left[:, pose])
            suits = usable[:, pose] & (kind == k)
        best = int(np.argmax(np.where(suits, candidates.rating * nearest, -1.0)))
        if not clearance.is_free(candidates.T[best], float(candidates.pairs.width_m[best])):
            nearest[best] = -1.0
            continue
        chosen.append(best)
        served[k] += candidates.serves[best]
        filled[k] += 1
        nearest = np.minimum(nearest, pose_distance(candidates.T, candidates.T[best], params))
    return chosen


def _least(values: Float[np.ndarray, "n"], allowed: Bool[np.ndarray, "n"]) -> int:
    """Number of the smallest allowed value, the first of equals."""
    return int(np.argmin(np.where(allowed, values, np.inf)))


def pose_distance(T: Float[np.ndarray, "n 4 4"], T_other: Float[np.ndarray, "4 4"], params: GraspPoolParams) -> Float[np.ndarray, "n"]:
    """Distance of grasps: position and rotation over their scales; a half turn about the approach counts as no rotation."""
    shift = np.linalg.norm(T[:, :3, 3] - T_other[:3, 3], axis=1) / params.length_scale_m
    # trace(R_other^T R), and the same with x and y of the one gripper reversed.
    products = np.einsum("nij,ij->nj", T[:, :3, :3], T_other[:3, :3])
    same, flipped = products.sum(axis=1), products[:, 2] - products[:, 0] - products[:, 1]
    angle = np.arccos(np.clip((np.maximum(same, flipped) - 1.0) / 2.0, -1.0, 1.0))
    return np.asarray(np.hypot(shift, angle / params.angle_scale_rad))
