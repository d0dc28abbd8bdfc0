"""Every parameter of the pipeline has bounds, its default is within them, and nothing beyond them is accepted."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from typing import Any

import pytest

from pipelines.engines.bounds import Bounds, BoundsError, bounded, bounds_of, check_bounds
from pipelines.proofs.audit.params import AuditParams
from pipelines.recipe import Recipe

RECIPE = Recipe()
SECTIONS = [
    *(getattr(RECIPE, item.name) for item in dataclasses.fields(RECIPE) if item.name not in ("seed", "objects")),
    RECIPE.planning.search,
    AuditParams(),
]


def _parameters() -> Iterator[Any]:
    for section in SECTIONS:
        for name, bounds in bounds_of(type(section)).items():
            yield pytest.param(section, name, bounds, id=f"{type(section).__name__}.{name}")


def _with(value: Any, number: float) -> Any:
    """A value with its last number replaced."""
    return (*value[:-1], _with(value[-1], number)) if isinstance(value, tuple) else number


@pytest.mark.parametrize("section", SECTIONS, ids=lambda section: type(section).__name__)
def test_every_parameter_has_bounds(section: Any) -> None:
    bare = {item.name for item in dataclasses.fields(section)} - bounds_of(type(section)).keys()
    assert {name for name in bare if not dataclasses.is_dataclass(getattr(section, name))} == set()


@pytest.mark.parametrize(("section", "name", "bounds"), _parameters())
def test_what_is_beyond_its_bounds_is_refused_by_name_value_and_bound(section: Any, name: str, bounds: Bounds) -> None:
    assert math.isfinite(bounds.low)
    assert math.isfinite(bounds.high)
    value = getattr(section, name)
    below, above = bounds.low - 1e-3 - abs(bounds.low), bounds.high + 1e-3 + abs(bounds.high)
    for number in (below, above, math.nan, math.inf, -math.inf):
        wrong = _with(value, number)
        with pytest.raises(BoundsError) as caught:
            dataclasses.replace(section, **{name: wrong})
        assert str(caught.value) == f"{name} = {wrong!r}, must be in [{bounds.low:g}, {bounds.high:g}]"


@dataclasses.dataclass(frozen=True, slots=True)
class _Knobs:
    share: float = bounded(0.5, 0.0, 1.0)
    span: tuple[float, float] = bounded((0.1, 0.2), 0.0, 1.0, is_increasing=True)
    eyes: tuple[tuple[float, ...], ...] = bounded(((0.0, 1.0),), 0.0, 1.0)

    def __post_init__(self) -> None:
        check_bounds(self)


def test_both_ends_are_included_and_defaults_are_plain_values() -> None:
    knobs = _Knobs(share=0.0, span=(0.0, 1.0))
    assert (knobs.share, knobs.span, knobs.eyes, _Knobs(share=1.0).share) == (0.0, (0.0, 1.0), ((0.0, 1.0),), 1.0)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"span": (0.2, 0.2)}, r"span = \(0\.2, 0\.2\), must be increasing"),
        ({"eyes": ()}, r"eyes = \(\), must be in \[0, 1\]"),
        ({"eyes": ((0.0, 0.5), (0.5, 1.5))}, r"eyes = .*1\.5.*, must be in \[0, 1\]"),
    ],
)
def test_tuples_are_checked_number_by_number(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(BoundsError, match=message):
        _Knobs(**wrong)
