"""The one family of errors that physics raises; outcomes of a run are data and never raised."""

from __future__ import annotations

from tables.errors import PlaceBenchError


class PhysicsError(PlaceBenchError, RuntimeError):
    """The engine refused its input or produced what no label can be made of; names the object, scene, grasp or candidate."""
