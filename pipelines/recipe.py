"""The recipe: every stage's parameters, composed from one TOML file; what a parameter means stands beside its default."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import tomllib
import types
import typing
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from objects.build import ObjectParams
from pipelines.engines.physics.hand_params import HandWorldParams
from pipelines.engines.physics.world import PhysicsParams
from pipelines.engines.planning.trajectory import MotionParams
from pipelines.grasps.admission import AdmissionParams
from pipelines.grasps.pick_lift import PickLiftParams
from pipelines.labels.execution import ExecutionParams, ExecutionSetup
from pipelines.labels.planning import PlanningParams, PlanningSetup
from pipelines.scenes.points import CameraParams
from pipelines.scenes.sampling import SceneSamplingParams
from pipelines.stage import Promise
from pipelines.values import SceneAllocation
from tables.identity import FAMILIES

DEFAULT_RECIPE = Path(__file__).with_name("recipe.toml")

_P = TypeVar("_P")


class RecipeError(ValueError):
    """A recipe with an unknown key, a value of the wrong type or out of bounds."""


@dataclass(frozen=True, slots=True)
class Recipe:
    """Parameters of one family of scenes; `seed` is the root of every random draw."""

    seed: int = 42
    objects: ObjectParams = field(default_factory=ObjectParams)
    scene_sampling: SceneSamplingParams = field(default_factory=SceneSamplingParams)
    camera: CameraParams = field(default_factory=CameraParams)
    grasp_admission: AdmissionParams = field(default_factory=AdmissionParams)
    pick_lift: PickLiftParams = field(default_factory=PickLiftParams)
    planning: PlanningParams = field(default_factory=PlanningParams)
    execution: ExecutionParams = field(default_factory=ExecutionParams)
    motion: MotionParams = field(default_factory=MotionParams)
    physics: PhysicsParams = field(default_factory=PhysicsParams)  # of resting objects
    hand_physics: HandWorldParams = field(default_factory=HandWorldParams)  # of held ones

    @property
    def planning_setup(self) -> PlanningSetup:
        """What planning a candidate needs."""
        return PlanningSetup(self.planning, self.motion, self.seed)

    @property
    def execution_setup(self) -> ExecutionSetup:
        """What executing a plan needs."""
        return ExecutionSetup(self.execution, self.motion, self.hand_physics)

    def promise(self, allocations: Iterable[SceneAllocation]) -> Promise:
        """What tables of scenes with these allocations must hold."""
        execution = self.execution
        return Promise(tuple(allocations), self.scene_sampling.n_targets, execution.position_tolerance_m, execution.rotation_tolerance_rad)

    def sections(self, *kinds: type) -> tuple[Any, ...]:
        """The sections of some types, in their order; raises RecipeError for a type that is no section."""
        return tuple(getattr(self, name) for name in self._names(*kinds))

    def _names(self, *kinds: type) -> list[str]:
        by_type = {type(getattr(self, item.name)): item.name for item in dataclasses.fields(self) if item.name != "seed"}
        for kind in kinds:
            if kind not in by_type:
                raise RecipeError(f"{kind.__name__}: no section of the recipe, must be one of {sorted(t.__name__ for t in by_type)}")
        return [by_type[kind] for kind in kinds]

    def hash_of_sections(self, *kinds: type) -> str:
        """SHA-256 over the seed and the sections of some types."""
        return self.hash_of(*(self._names(*kinds) or ["seed"]))

    def hash_of(self, *sections: str) -> str:
        """SHA-256 over the seed and some sections, or over all of them."""
        values = dataclasses.asdict(self)
        chosen = {name: values[name] for name in ("seed", *(sections or sorted(set(values) - {"seed"})))}
        return hashlib.sha256(json.dumps(chosen, sort_keys=True, default=str).encode()).hexdigest()


def load_recipe(family: str, path: Path = DEFAULT_RECIPE) -> Recipe:
    """The recipe of a family: the file's top sections, then what `[<family>.<section>]` overrides.

    Raises:
        RecipeError: names the key, its value and what is allowed.
    """
    if family not in FAMILIES:
        raise RecipeError(f"family {family!r}, must be one of {list(FAMILIES)}")
    content = tomllib.loads(path.read_text(encoding="utf-8"))
    overrides = {name: content.pop(name, {}) for name in FAMILIES}
    for name, override in overrides.items():
        if isinstance(override, Mapping) and "objects" in override:
            raise RecipeError(f"recipe.{name}.objects: {override['objects']!r}, must not be there: objects are shared by all families")
    return _build(Recipe, _merged(content, overrides[family]), "recipe")


def _build(cls: type[_P], values: Mapping[str, Any], where: str) -> _P:
    hints = typing.get_type_hints(cls)
    known = {f.name for f in dataclasses.fields(cls)}  # type: ignore[arg-type]
    unknown = sorted(set(values) - known)
    if unknown:
        raise RecipeError(f"{where}.{unknown[0]}: unknown key, must be one of {sorted(known)}")
    arguments: dict[str, Any] = {}
    for name, value in values.items():
        hint, here = hints[name], f"{where}.{name}"
        if dataclasses.is_dataclass(hint):
            if not isinstance(value, Mapping):
                raise RecipeError(f"{here}: {value!r}, must be a table")
            arguments[name] = _build(typing.cast(type, hint), value, here)
        else:
            arguments[name] = _converted(hint, value, here)
    try:
        return cls(**arguments)
    except (TypeError, ValueError) as error:
        raise RecipeError(f"{where}: {error}") from error


def _converted(hint: Any, value: Any, here: str) -> Any:
    origin = typing.get_origin(hint)
    if origin is tuple:
        inner = typing.get_args(hint)
        if not isinstance(value, list) or (Ellipsis not in inner and len(value) != len(inner)):
            raise RecipeError(f"{here}: {value!r}, must be a list of {len(inner)}")
        kinds = [inner[0]] * len(value) if Ellipsis in inner else inner
        return tuple(_converted(kind, item, here) for kind, item in zip(kinds, value, strict=True))
    if origin in (dict, typing.get_origin(Mapping[str, float])):
        kind = typing.get_args(hint)[1]
        return {key: _converted(kind, item, f"{here}.{key}") for key, item in dict(value).items()}
    if origin in (typing.Union, types.UnionType):
        hint = next(kind for kind in typing.get_args(hint) if kind is not type(None))
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if isinstance(hint, type) and (not isinstance(value, hint) or (hint is int and isinstance(value, bool))):
        raise RecipeError(f"{here}: {value!r} is {type(value).__name__}, must be {hint.__name__}")
    return value


def _merged(base: Mapping[str, Any], override: Mapping[str, Any]) -> dict[str, Any]:
    out = dict(base)
    for name, value in override.items():
        out[name] = _merged(out[name], value) if isinstance(value, Mapping) and isinstance(out.get(name), Mapping) else value
    return out
