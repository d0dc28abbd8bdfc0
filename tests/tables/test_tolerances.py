"""Tolerances that no label can have been judged by are refused; the recipe's are what its parameters say."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from pipelines.labels.execution import ExecutionParams
from tables.errors import PlaceBenchError
from tables.tolerances import Tolerances, TolerancesError

SHIPPED = Tolerances(position_m=0.0075, rotation_rad=math.radians(5.0), slip_m=0.00375, slip_rad=math.radians(5.0))


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("position_m", 0.0, r"position_m 0.0, must be a number in \(0, 1\]"),
        ("position_m", 1.1, r"position_m 1.1, must be a number in \(0, 1\]"),
        ("rotation_rad", float("nan"), r"rotation_rad nan, must be a number in \(0, 3.142\]"),
        ("rotation_rad", 5.0, r"rotation_rad 5.0, must be a number in \(0, 3.142\]"),
        ("slip_m", -0.002, r"slip_m -0.002, must be a number in \(0, 1\]"),
        ("slip_m", float("inf"), r"slip_m inf, must be a number in \(0, 1\]"),
        ("slip_m", True, r"slip_m True, must be a number in \(0, 1\]"),
        ("slip_m", None, r"slip_m None, must be a number in \(0, 1\]"),
        ("slip_rad", "0.03", r"slip_rad '0.03', must be a number in \(0, 3.142\]"),
        ("slip_rad", "x" * 500, r"slip_rad 'x{79}, must be a number in \(0, 3.142\]"),
        ("slip_rad", 10, r"slip_rad 10, must be a number in \(0, 3.142\]"),
    ],
)
def test_what_no_label_was_judged_by_is_refused(name: str, value: object, message: str) -> None:
    with pytest.raises(TolerancesError, match=f"^{message}$") as raised:
        replace(SHIPPED, **{name: value})
    assert isinstance(raised.value, PlaceBenchError)


def test_the_largest_are_a_metre_and_half_a_turn() -> None:
    assert Tolerances(1.0, math.pi, 1, math.pi).slip_m == 1


def test_execution_is_judged_by_what_its_parameters_say() -> None:
    assert ExecutionParams().tolerances == SHIPPED
    other = ExecutionParams(position_tolerance_m=0.006, rotation_tolerance_rad=0.07, slipped_m=0.003, slipped_rad=0.04)
    assert other.tolerances == Tolerances(0.006, 0.07, 0.003, 0.04)
