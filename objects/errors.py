"""The one exception family of the objects room, caught where a user meets it."""

from __future__ import annotations


class ObjectError(ValueError):
    """An object that cannot be built; names object, value and bound."""


class CatalogueError(ObjectError):
    """A catalogue file or entry that is not what it should be."""


class MeshError(ObjectError):
    """A solid that is not watertight, has an implausible size, or convex parts that do not match it."""


class StablePoseError(ObjectError):
    """An object that rests nowhere."""


class GraspError(ObjectError):
    """An object that the gripper cannot hold in enough ways."""
