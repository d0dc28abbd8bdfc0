"""Changes that ought not to matter to a label, and the recipe under each of them."""

from __future__ import annotations

import dataclasses
from enum import StrEnum

from pipelines.engines.physics.hand_params import HandWorldParams
from pipelines.labels.execution import perturbed_setup
from pipelines.recipe import Recipe
from tables.vocabulary import Perturbation

FINER_CELLS_PER_SIDE = 5


class Change(StrEnum):
    """What is different in a run."""

    NONE = "as it is"
    HALF_STEP = "half the step"
    FRICTION_UP = "friction +5 %"
    FRICTION_DOWN = "friction -5 %"
    FINER_PADS = "5 x 5 cells a pad"
    LEVER_UP = "lever +15 %"
    LEVER_DOWN = "lever -15 %"


_PERTURBATIONS = {
    Change.HALF_STEP: Perturbation.FINE_STEP,
    Change.FRICTION_UP: Perturbation.FRICTION_UP,
    Change.FRICTION_DOWN: Perturbation.FRICTION_DOWN,
    Change.LEVER_UP: Perturbation.PAD_LEVER_UP,
    Change.LEVER_DOWN: Perturbation.PAD_LEVER_DOWN,
}
FRICTION = (Change.FRICTION_UP, Change.FRICTION_DOWN)


def changed_physics(recipe: Recipe, change: Change) -> HandWorldParams:
    """The physics of what the hand holds under a change; those of the repeatability report are its own."""
    if change in _PERTURBATIONS:
        return perturbed_setup(recipe.execution_setup, _PERTURBATIONS[change]).physics
    if change is Change.FINER_PADS:
        return dataclasses.replace(recipe.hand_physics, cells_per_side=FINER_CELLS_PER_SIDE)
    return recipe.hand_physics
