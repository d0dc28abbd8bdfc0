"""Grips against Coulomb: pull-out force, torsion and creep; and that the measurements see a pad that is not what it should be."""

from __future__ import annotations

import pytest

from pipelines.engines.physics.hand_params import HandWorldParams
from pipelines.proofs.validity.hold_creep import hold_creep, summary
from pipelines.proofs.validity.pull_out import DIRECTIONS, pull_out_ratio, stated_lever_m, torsion_lever_m
from tests.pipelines.engines.physics.object_models import can_model, cuboid_model

PARAMS = HandWorldParams()


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_pull_out_force_is_coulombs(direction: tuple[float, float, float]) -> None:
    assert 0.98 < pull_out_ratio(cuboid_model(), direction, PARAMS) < 1.04


@pytest.mark.parametrize(
    "changes", [{}, {"cells_per_side": 5}, {"pad_lever_scale": 1.15}, {"pad_lever_scale": 0.85}, {"friction_scale": 0.5}]
)
def test_torsion_lever_follows_from_the_pads_face(changes: dict[str, float]) -> None:
    params = HandWorldParams(**changes)  # type: ignore[arg-type]
    assert torsion_lever_m(cuboid_model(), params) == pytest.approx(stated_lever_m(params), rel=0.06)


def test_a_pad_of_another_lever_is_told_apart() -> None:
    assert torsion_lever_m(cuboid_model(), HandWorldParams(pad_lever_scale=1.15)) > 1.08 * stated_lever_m(PARAMS)


def test_holds_creep_by_micrometres() -> None:
    for object_model in (can_model(), cuboid_model()):
        rows, _ = hold_creep(object_model, 2, PARAMS, seed=1)
        assert len(rows) == 2
        assert summary(rows)[1] < 1e-4


def test_creep_is_seen() -> None:
    """Friction a hundred times softer creeps tens of times as far."""
    stiff, _ = hold_creep(cuboid_model(), 1, PARAMS, seed=1)
    soft, _ = hold_creep(cuboid_model(), 1, HandWorldParams(friction_stiffness_ratio=PARAMS.friction_stiffness_ratio / 100), seed=1)
    assert soft[0].creep_m > 10 * stiff[0].creep_m
