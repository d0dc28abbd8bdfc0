"""What a placement was judged by: how far it may end from its target, and how far the object may move in the hand on the way."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from tables.errors import PlaceBenchError

_MAX_SHOWN = 80
_LARGEST = {"position_m": 1.0, "rotation_rad": math.pi, "slip_m": 1.0, "slip_rad": math.pi}


class TolerancesError(PlaceBenchError, ValueError):
    """A tolerance that no label can have been judged by; the message names it, its value and its bounds."""


@dataclass(frozen=True, slots=True)
class Tolerances:
    """The numbers that part a success from a failure; what is exactly at one of them is still within.

    Attributes:
        position_m: distance of the final object pose from the target.
        rotation_rad: turn of the final object pose from the target, modulo symmetry.
        slip_m: largest motion of the object in the hand before release.
        slip_rad: largest turn of the object in the hand before release.

    Raises TolerancesError for what is no number, is not above 0, or is above a metre or half a turn.
    """

    position_m: float
    rotation_rad: float
    slip_m: float
    slip_rad: float

    def __post_init__(self) -> None:
        for field in fields(self):
            _check(field.name, getattr(self, field.name), _LARGEST[field.name])


def _check(name: str, value: object, largest: float) -> None:
    """The value, which may come from a file and be anything, is a number in (0, largest]; True and False do not count as numbers."""
    if not isinstance(value, (int, float)) or isinstance(value, bool) or not 0.0 < value <= largest:
        raise TolerancesError(f"{name} {repr(value)[:_MAX_SHOWN]}, must be a number in (0, {largest:.4g}]")
