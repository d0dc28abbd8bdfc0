"""The one exception family of the objects room, caught where a user meets it; nothing in objects/ raises another class of its own."""

from __future__ import annotations

from tables.errors import PlaceBenchError


class ObjectError(PlaceBenchError, ValueError):
    """The base of the family: an object that cannot be built or used; names object, value and bound."""


class ObjectParamsError(ObjectError):
    """A parameter of the build that is out of bounds."""


class CatalogueError(ObjectError):
    """A catalogue file or entry that is not what it should be."""


class MeshError(ObjectError):
    """A solid that is not watertight, has an implausible size, or convex parts that do not match it."""


class StablePoseError(ObjectError):
    """An object that rests nowhere."""


class GraspError(ObjectError):
    """An object that the gripper cannot hold in enough ways."""


class UnknownGraspError(ObjectError, LookupError):
    """A grasp id that the pool of an object does not have."""


class GripperError(ObjectError):
    """An opening that the jaw does not have."""
