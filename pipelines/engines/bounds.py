"""Bounds of parameters, declared beside their defaults and checked when the parameters are made; which sections exist: see recipe.py."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from itertools import pairwise
from typing import Any, TypeVar

from tables.errors import PlaceBenchError

_T = TypeVar("_T")
_BOUNDS = "bounds"


class BoundsError(PlaceBenchError, ValueError):
    """A parameter out of its bounds; the message begins with the parameter's name and its value."""


@dataclass(frozen=True, slots=True)
class Bounds:
    """What the numbers of one parameter must be: finite, in [low, high], and each above the one before where `is_increasing`."""

    low: float
    high: float
    is_increasing: bool = False

    def broken_by(self, value: Any) -> str | None:
        """What the value must be, where it is not."""
        numbers = list(_numbers(value))
        # `not <=` and not `>`: a NaN is in no bounds.
        if not numbers or not all(self.low <= number <= self.high for number in numbers):
            return f"must be in [{self.low:g}, {self.high:g}]"
        if self.is_increasing and not all(a < b for a, b in pairwise(numbers)):
            return "must be increasing"
        return None


def bounded(default: _T, low: float, high: float, *, is_increasing: bool = False) -> _T:
    """A dataclass field with a default and bounds, both ends included; of a tuple the bounds hold for every number in it.

    A class with such fields calls `check_bounds` in its `__post_init__`.
    """
    return field(default=default, metadata={_BOUNDS: Bounds(low, high, is_increasing)})


def check_bounds(params: Any) -> None:
    """Raises BoundsError for the first field of a dataclass that is out of its bounds; names field, value and bounds."""
    for name, bounds in bounds_of(type(params)).items():
        value = getattr(params, name)
        rule = bounds.broken_by(value)
        if rule is not None:
            raise BoundsError(f"{name} = {value!r}, {rule}")


def bounds_of(kind: type) -> dict[str, Bounds]:
    """The fields of a dataclass that declare bounds."""
    return {item.name: item.metadata[_BOUNDS] for item in fields(kind) if _BOUNDS in item.metadata}


def _numbers(value: Any) -> Iterator[float]:
    if isinstance(value, tuple):
        for item in value:
            yield from _numbers(item)
    else:
        yield value
