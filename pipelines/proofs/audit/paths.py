"""The executed path of a plan against everything it must not collide with, in the collision engine of pybullet.

Every pair of bodies is tested, except those listed here with the reason why they may overlap. See rejections.py for rejected candidates.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np
from jaxtyping import Float

from objects.gripper import open_jaw_m
from pipelines.engines.planning.trajectory import MotionParams, time_path
from pipelines.engines.robot.arm import QD_MAX_RAD_S
from pipelines.proofs.audit.bullet_scene import FAR_M, FINGERS, LINKS, ROBOT, BulletScene, Nearest, Pair
from pipelines.values import LiftedGrasp, Motion

# Bodies of the robot that may overlap: neighbours overlap at their common joint in every configuration, the hand sits on link7, the
# fingers slide in the hand and close on each other. link5 and link7 are kept apart by the joint limits: their hulls meet in 6 % of random
# configurations, up to 49 mm deep, but link5's visual mesh and link7 in none of 4,000.
ALLOWED_COLLISION_MATRIX = frozenset({
    *(frozenset(neighbours) for neighbours in pairwise(LINKS)),
    frozenset(("link7", "hand")),
    *(frozenset(("hand", finger)) for finger in FINGERS),
    *(frozenset((a, b)) for a in FINGERS for b in FINGERS),
    frozenset(("link5", "link7")),
})  # fmt: skip
STANDS_ON_TABLE = ("link0", "link1")


@dataclass(frozen=True, slots=True)
class PathVerdict:
    """What was found on a path; see the columns of `audits`."""

    depth_m: float
    deepest_pair: str | None
    clearance_m: float
    n_configurations: int


def recheck_path(
    world: BulletScene, grasp: LiftedGrasp, T_base_place: Float[np.ndarray, "4 4"], motion: Motion, timing: MotionParams, step_rad: float
) -> PathVerdict:
    """Distances along transport, descend and retreat, on the curve that execution commands.

    That curve comes from `time_path`: straight joint-space pieces with stops in transport, a spline through the waypoints on the lines.
    It is sampled by way, not by time: no joint moves more than `step_rad` between two configurations. Carried, the object moves with
    the TCP from the first configuration to the last; while the hand retreats, it stands where the plan let go of it.

    Args:
        T_base_place: object pose at which the plan lets go.
    """
    jaw_m = open_jaw_m(world.object_model.grasp(grasp.grasp_id).jaw_width_m)
    depth_m, deepest, clearance_m, n = -FAR_M, None, FAR_M, 0
    for phase in ("transport", "descend", "retreat"):
        q = executed_path(getattr(motion, f"{phase}_q_rad"), timing, stop_at_waypoints=phase == "transport", step_rad=step_rad)
        if phase == "retreat":
            placed = {**world.arm(q, np.array([jaw_m / 2, jaw_m / 2])), "object": T_base_place[None]}
            may_meet, keep_clear = standing_pairs(), arm_pairs(world)
        else:
            placed = world.arm(q, grasp.fingers_m)
            placed["object"] = placed["tcp"] @ grasp.T_tcp_object
            may_meet, keep_clear = carried_pairs(), [*arm_pairs(world), *object_pairs(world)]
        own = world.nearest(placed, [*self_pairs(), *may_meet])
        other = world.nearest(placed, keep_clear)
        clearance_m = min(clearance_m, other.room_m)
        for found in (own, other):
            if found.pair is not None and -found.room_m > depth_m:
                depth_m, deepest = -found.room_m, _named(phase, found)
        n += len(q)
    return PathVerdict(depth_m, deepest, clearance_m, n)


def executed_path(
    waypoints: Float[np.ndarray, "k 7"], motion: MotionParams, *, stop_at_waypoints: bool, step_rad: float
) -> Float[np.ndarray, "n 7"]:
    """Configurations on the curve of the timed motion, ends included, with no joint further apart than `step_rad` in two."""
    # No joint moves more than a quarter of the step between two samples of the timed motion.
    dt_s = step_rad / 4 / float(motion.velocity_scale * QD_MAX_RAD_S.max())
    q = time_path(waypoints, motion, dt_s, stop_at_waypoints=stop_at_waypoints).q_rad
    kept, last = [0], 0
    for k in range(1, len(q)):
        if np.abs(q[k] - q[last]).max() > step_rad:
            # The sample before is the last that is near enough.
            last = max(k - 1, last + 1)
            kept.append(last)
    if kept[-1] != len(q) - 1:
        kept.append(len(q) - 1)
    return q[kept]


def self_pairs() -> list[Pair]:
    """The robot against itself."""
    return [Pair(a, b) for a, b in combinations(ROBOT, 2) if frozenset((a, b)) not in ALLOWED_COLLISION_MATRIX]


def arm_pairs(world: BulletScene, required_m: float = 0.0) -> list[Pair]:
    """The robot against table and obstacles; the first two links stand on the table."""
    table = [Pair(body, "table", required_m) for body in ROBOT if body not in STANDS_ON_TABLE]
    return [*table, *(Pair(body, name, required_m) for body in ROBOT if body != "link0" for name in world.obstacles)]


def object_pairs(world: BulletScene, required_m: float = 0.0) -> list[Pair]:
    """The object against table and obstacles."""
    return [Pair("object", name, required_m) for name in world.surroundings]


def carried_pairs() -> list[Pair]:
    """The carried object against the robot; the fingers hold it."""
    return [Pair(body, "object") for body in ROBOT if body not in FINGERS]


def standing_pairs(allowed_m: float = 0.0) -> list[Pair]:
    """The object that was put down against the whole robot."""
    return [Pair(body, "object", -allowed_m) for body in ROBOT]


def _named(phase: str, found: Nearest) -> str:
    assert found.pair is not None
    return f"{phase}: {found.pair.a} / {found.pair.b}"
