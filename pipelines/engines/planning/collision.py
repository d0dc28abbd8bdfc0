"""Whether the arm is in collision in one scene: arm, hand, fingers and object against table, obstacles and themselves.

See planner.py for paths and bodies.py for tests without an arm.

pinocchio moves the shapes and coal tests the pairs whose bounding boxes meet (five times faster than testing every pair, and faster
than a sorted broad phase for so few shapes). The model is built once a scene; a grasp only moves the attached object.
"""

from __future__ import annotations

from itertools import combinations, pairwise

import coal
import numpy as np
import pinocchio as pin
from jaxtyping import Float

from objects.gripper import MAX_JAW_M
from objects.object_model import ObjectModel
from pipelines.engines.planning.bodies import CLEARANCE_M, Body, Box, Surroundings, object_body
from pipelines.engines.robot.geometry import LAST_LINK, N_LINKS, Panda, convex_box, panda
from pipelines.values import Scene

LINKS = tuple(f"link{k}" for k in range(N_LINKS))
FINGERS = ("left_finger_pad", "left_finger_body", "right_finger_pad", "right_finger_body")
ROBOT = (*LINKS, "hand", *FINGERS)
# Bodies of the robot that may overlap, or that never do; every other pair is tested.
ALLOWED_COLLISION_MATRIX = frozenset({
    # Neighbours overlap at their common joint in every configuration, the hand sits on link7, the fingers slide in the hand and close
    # on each other.
    *(frozenset(neighbours) for neighbours in pairwise(LINKS)),
    frozenset(("link7", "hand")),
    *(frozenset(("hand", finger)) for finger in FINGERS),
    *(frozenset(pair) for pair in combinations(FINGERS, 2)),
    # The hulls of link5 and link7 overlap in 6 % of all configurations although the links do not.
    frozenset(("link5", "link7")),
    # These met in none of 20,000 random configurations: the base and the shoulder, the two links of the elbow and anything else, and the
    # wrist and what it carries.
    frozenset(("link0", "link2")),
    *(frozenset((elbow, body)) for elbow in ("link3", "link4") for body in ROBOT if body != elbow),
    *(frozenset((wrist, body)) for wrist in ("link6", "link7") for body in ("hand", *FINGERS)),
})  # fmt: skip
# Links before hand and fingers.
SELF_COLLISION_PAIRS = tuple(
    (a, b)
    for group in (LINKS, ("hand", *FINGERS))
    for a, b in combinations(ROBOT, 2)
    if b in group and frozenset((a, b)) not in ALLOWED_COLLISION_MATRIX
)
LINKS_ON_TABLE = ("link0", "link1")  # stand on it
LINKS_BY_OBJECT = LINKS[:6]  # the others hold it
# Open fingers and palm may overlap the object they stand around by this much: slip in the hand leaves them in contact.
HELD_TOLERANCE_M = 0.001
_TABLE_SIZE_M = np.array([4.0, 4.0, 1.0])


class CollisionModel:
    """Collision tests of one scene; a verdict depends on the configuration and the last `attach` or `place_object` alone."""

    def __init__(self, scene: Scene, object_model: ObjectModel) -> None:
        self.robot = panda()
        self.object = object_body(object_model)
        self.surroundings = Surroundings(scene)
        self._carrying = _ArmWorld(self.robot, self.object, self.surroundings.obstacles, is_carried=True)
        self._standing = _ArmWorld(self.robot, self.object, self.surroundings.obstacles, is_carried=False)
        self.place_object(scene.T_base_object, MAX_JAW_M)
        self.attach(np.eye(4), np.zeros(2))

    def attach(self, T_tcp_object: Float[np.ndarray, "4 4"], fingers_m: Float[np.ndarray, "2"]) -> None:
        """Put the object into the hand, held by fingers at these joint positions."""
        self.T_link7_object = self.robot.T_link7_tcp @ T_tcp_object
        self.held_fingers_m = np.array(fingers_m, dtype=np.float64)
        self._carrying.place_object(self.T_link7_object, self.held_fingers_m)

    def place_object(self, T_base_object: Float[np.ndarray, "4 4"], jaw_m: float) -> None:
        """Put the object on the table, with the fingers this far apart."""
        self._standing.place_object(T_base_object, np.array([jaw_m / 2, jaw_m / 2]))

    def in_collision_holding(self, q: Float[np.ndarray, "7"]) -> bool:
        """Whether arm, hand, closed fingers or the attached object come too near to table or obstacles, or collide with the arm.

        Hand and fingers against the object they hold are not tested: admission tested them open, physics closed them.
        """
        return self._carrying.in_collision(q)

    def in_collision_open(self, q: Float[np.ndarray, "7"]) -> bool:
        """Whether arm, hand or open fingers come too near to table or obstacles, collide with the arm, or are too deep in the object."""
        return self._standing.in_collision(q)


class _ArmWorld:
    """Robot, table, obstacles and the object, either carried (fixed to link7) or standing (fixed to the base)."""

    def __init__(self, robot: Panda, body: Body, obstacles: tuple[Box, ...], *, is_carried: bool) -> None:
        self._model = robot.model
        self._data = robot.model.createData()
        self._q = np.zeros(robot.model.nq)
        self._geometry = pin.GeometryModel()
        ids = {shape.name: self._add(shape.name, shape.joint, shape.T_joint_shape, shape.geometry) for shape in robot.shapes}
        T_base_table = np.eye(4)
        T_base_table[2, 3] = -_TABLE_SIZE_M[2] / 2
        table = self._add("table", 0, T_base_table, convex_box(_TABLE_SIZE_M))
        boxes = [self._add(f"obstacle_{k}", 0, box.T_base_box, box.geometry) for k, box in enumerate(obstacles)]
        joint = LAST_LINK if is_carried else 0
        self._part_ids = [self._add(f"part_{k}", joint, np.eye(4), part) for k, part in enumerate(body.parts)]

        # (shape, shape, distance below which they are in collision)
        pairs = [(ids[a], ids[b], 0.0) for a, b in SELF_COLLISION_PAIRS]
        pairs += [(shape, table, CLEARANCE_M) for name, shape in ids.items() if name not in LINKS_ON_TABLE]
        pairs += [(shape, box, CLEARANCE_M) for name, shape in ids.items() if name != "link0" for box in boxes]
        for part in self._part_ids:
            if is_carried:
                pairs += [(shape, part, CLEARANCE_M) for shape in (table, *boxes)]
                pairs += [(ids[name], part, 0.0) for name in LINKS_BY_OBJECT]
            else:
                pairs += [(shape, part, -HELD_TOLERANCE_M) for name, shape in ids.items() if name not in LINKS_ON_TABLE]
        for a, b, _ in pairs:
            self._geometry.addCollisionPair(pin.CollisionPair(a, b))
        self._results = self._geometry.createData()
        for request, (_, _, margin_m) in zip(self._results.collisionRequests, pairs, strict=True):
            # Without contacts coal stops early and takes some deep overlaps for a gap of 0.6 um (1 in 6,000 collisions).
            request.enable_contact = True
            request.security_margin = margin_m
        self._broad_phase = pin.BroadPhaseManager_NaiveCollisionManager(self._model, self._geometry, self._results)

    def _add(self, name: str, joint: int, T_joint_shape: Float[np.ndarray, "4 4"], geometry: coal.CollisionGeometry) -> int:
        return int(self._geometry.addGeometryObject(pin.GeometryObject(name, joint, pin.SE3(T_joint_shape), geometry)))

    def place_object(self, T_joint_object: Float[np.ndarray, "4 4"], fingers_m: Float[np.ndarray, "2"]) -> None:
        placement = pin.SE3(T_joint_object)
        for part in self._part_ids:
            self._geometry.geometryObjects[part].placement = placement
        self._q[7:] = fingers_m

    def in_collision(self, q: Float[np.ndarray, "7"]) -> bool:
        self._q[:7] = q
        return bool(pin.computeCollisions(self._model, self._data, self._broad_phase, self._q, True))
