"""The closed enums of every status and kind that a table may hold; a value outside them is a bug, not data."""

from __future__ import annotations

from enum import StrEnum


class Category(StrEnum):
    """What an object is; `mesh` marks a user's own mesh file."""

    CAN = "can"
    MUG = "mug"
    CUBOID = "cuboid"
    MESH = "mesh"


class Allocation(StrEnum):
    """How the objects of a catalogue take the scenes of a dataset; see pipelines/scenes/allocation.py."""

    INTERLEAVED = "interleaved"  # the benchmark's: a fixed number of scenes, which objects take in turns, category by category
    APPENDED = "appended"  # every object has a block of scenes of its own, behind those of the objects before it


class Symmetry(StrEnum):
    """Rotations that leave the object unchanged, as validation and stable poses see it."""

    NONE = "none"
    REVOLUTION_Z = "revolution_z"  # any rotation about the object's z axis
    BOX = "box"  # half turns about the three axes


class PointType(StrEnum):
    """What a scene point lies on; the target copy is made from `object` points, never stored."""

    ENVIRONMENT = "environment"
    OBJECT = "object"
    OBSTACLE = "obstacle"


class AdmissionStatus(StrEnum):
    """Outcome of geometric grasp admission, in the order the tests run."""

    ADMITTED = "admitted"
    PALM_CONTACT = "palm_contact"
    SCENE_COLLISION = "scene_collision"  # hand or fingers against table or obstacles along the approach
    OBJECT_COLLISION = "object_collision"  # open hand against the object along the approach
    FINGERS_MISS = "fingers_miss"  # pads closed to the grasp's width do not reach the object
    NO_IK = "no_ik"
    ARM_COLLISION = "arm_collision"
    APPROACH_BLOCKED = "approach_blocked"  # straight approach not continuous or in collision
    LIFT_BLOCKED = "lift_blocked"  # vertical lift not reachable, not continuous or in collision
    NOT_NEEDED = "not_needed"  # would pass, but the scene already has its quota


class LiftStatus(StrEnum):
    """Outcome of the physics pick-lift check of an admitted grasp."""

    LIFTED = "lifted"
    NOT_LIFTED = "not_lifted"
    LOST_FINGER = "lost_finger"  # held by one finger only
    SLIPPED = "slipped"
    DISTURBED = "disturbed"  # object pushed away before the fingers closed
    STOPPED = "protective_stop"  # the hand met more force than it bears and stopped


class PlanStatus(StrEnum):
    """Outcome of planning a placement motion, in the order the tests run."""

    SOLVED = "solved"
    PLACE_COLLISION = "place_pose_in_collision"
    NO_IK = "no_ik"
    IK_COLLISION = "ik_in_collision"
    DESCEND_BLOCKED = "descend_blocked"
    RETREAT_BLOCKED = "retreat_blocked"
    START_COLLISION = "start_in_collision"
    BUDGET_SPENT = "budget_spent"


class ExecStatus(StrEnum):
    """Outcome of executing a planned placement in physics.

    From `dropped_in_transport` to `off_target`: why the end is not valid, whether the object slipped in the hand or not; the first that
    applies, in this order. `slipped_in_hand` is valid but for the slip, so a valid end is `success` or `slipped_in_hand`.
    """

    SUCCESS = "success"
    DROPPED = "dropped_in_transport"
    STOPPED = "protective_stop"  # the hand met more force than it bears and stopped
    COLLIDED = "collided"
    OFF_TABLE = "left_the_table"
    DRAGGED = "dragged_on_retreat"
    TOPPLED = "toppled_at_release"
    NOT_SETTLED = "not_settled"
    OFF_TARGET = "off_target"
    SLIPPED = "slipped_in_hand"


class Split(StrEnum):
    """Who may see a scene group."""

    TRAIN = "train"
    VALIDATION = "validation"
    TEST = "test"


class SplitScheme(StrEnum):
    """By what scene groups are dealt to the splits; each scheme has a column of table `splits`."""

    SCENE = "scene"  # the paper's: by scene, objects known
    OBJECT = "object"
    CATEGORY_CAN = "category_can"  # tests on cans, trains on the other categories; likewise the next two
    CATEGORY_MUG = "category_mug"
    CATEGORY_CUBOID = "category_cuboid"
    LAYOUT = "layout"

    @property
    def column(self) -> str:
        """Name of its column: `split` for the paper's, `split_<scheme>` for the others."""
        return "split" if self is SplitScheme.SCENE else f"split_{self.value}"


class Perturbation(StrEnum):
    """How a repeat execution differs from the stored one."""

    FRESH = "fresh_process"
    HOLD = "hold_0.10s"
    FINE_STEP = "half_step"
    FRICTION_UP = "friction_+5%"
    FRICTION_DOWN = "friction_-5%"
    PAD_LEVER_UP = "pad_lever_+15%"
    PAD_LEVER_DOWN = "pad_lever_-15%"


class Audit(StrEnum):
    """How a stored planning label is checked by something other than what made it."""

    PATH_GEOMETRY = "path_geometry"  # the executed path of a solved candidate, rechecked by another collision engine
    SEARCH_BUDGET = "search_budget"  # a candidate whose search ended by its budget, searched ten times as long
    REJECTION = "rejection"  # a candidate rejected for another reason, judged again by a slower and finer judge
