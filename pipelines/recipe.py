"""The recipe: the parameters of every stage, composed from one TOML file and checked against each other.

`recipe.toml` holds the knobs of the task distribution and the reason for each. A parameter class gives unit, meaning and bounds, and the
reason only where the file does not name the parameter. Defaults of the classes are what the file ships: `MotionParams()` anywhere, in
a test too, is the shipped motion, and `Recipe()` is the recipe of `full` (tested).
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import operator
import tomllib
import typing
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from objects.build import ObjectParams
from objects.gripper import MAX_JAW_M, OPEN_CLEARANCE_M
from pipelines.engines.bounds import BoundsError
from pipelines.engines.physics.hand_params import HandWorldParams
from pipelines.engines.physics.params import PhysicsParams
from pipelines.engines.planning.trajectory import MotionParams
from pipelines.grasps.admission import AdmissionParams
from pipelines.grasps.pick_lift import PickLiftParams
from pipelines.labels.execution import ExecutionParams, ExecutionSetup
from pipelines.labels.planning import PlanningParams, PlanningSetup
from pipelines.scenes.points import CameraParams
from pipelines.scenes.sampling import SceneSamplingParams
from pipelines.stage import Promise
from pipelines.values import GRAVITY_M_S2, SceneAllocation
from tables.errors import PlaceBenchError
from tables.identity import FAMILIES

DEFAULT_RECIPE = Path(__file__).with_name("recipe.toml")

_P = TypeVar("_P")


class RecipeError(PlaceBenchError, ValueError):
    """A recipe that cannot be read or used; one line that names the key, its value and what it must be."""


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

    def __post_init__(self) -> None:
        for left, relation, right in _AGREEMENTS:
            holds, words = _RELATIONS[relation]
            if not holds(_at(self, left), _at(self, right)):
                raise RecipeError(f"{left} = {_at(self, left)}, must {words} {right} = {_at(self, right)}")
        for key, cause, least in _waits(self):
            if _at(self, key) < least:
                raise RecipeError(f"{key} = {_at(self, key)}, must be at least {least:.3g}: {cause}")

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
        return Promise(tuple(allocations), self.scene_sampling.n_targets, self.execution.tolerances)

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


# What must hold between sections (what must hold within one, its class checks): key, relation, key.
_AGREEMENTS = (
    # The lift that is executed is the one that was admitted, and what is held clears the obstacles.
    ("pick_lift.lift_m", "==", "grasp_admission.lift_m"),
    ("pick_lift.lift_m", ">=", "scene_sampling.obstacle_size_m[2]"),
    # A pool has no grasp that admission refuses whatever the scene, and even the smallest as many as a scene asks for.
    ("objects.grasp_pool.palm_clearance_m", ">=", "grasp_admission.palm_clearance_m"),
    ("objects.grasp_pool.table_clearance_m", ">=", "grasp_admission.table_clearance_m"),
    ("objects.grasp_pool.approach_m", ">=", "grasp_admission.pregrasp_m"),
    ("objects.grasp_pool.min_grasps", ">=", "scene_sampling.min_initial_grasps"),
    ("objects.grasp_pool.n_grasps", ">=", "scene_sampling.min_target_grasps"),
    # A placement within tolerance overlaps no obstacle, and an object left alone at its target ends within tolerance.
    ("scene_sampling.target_gap_m", ">=", "execution.position_tolerance_m"),
    ("scene_sampling.max_drift_m", "<=", "execution.position_tolerance_m"),
    ("scene_sampling.max_drift_rad", "<=", "execution.rotation_tolerance_rad"),
    # What stands in the workspace stands on the table, and the cameras see it.
    *(
        (f"scene_sampling.{radius}[1]", "<=", bound)
        for radius in ("radius_m", "obstacle_radius_m")
        for bound in ("camera.max_radius_m", *(f"{engine}.table_{axis}_m[1]" for engine in ("physics", "hand_physics") for axis in "xy"))
    ),
)
_RELATIONS: dict[str, tuple[Callable[[float, float], bool], str]] = {
    "==": (operator.eq, "be equal to"),
    "<=": (operator.le, "be at most"),
    ">=": (operator.ge, "be at least"),
}


def _waits(recipe: Recipe) -> tuple[tuple[str, str, float], ...]:
    """Seconds and steps that must be enough for what happens in them: key, what sets the least, the least."""
    hand = recipe.hand_physics
    finger = f"at hand_physics.finger_speed_m_s = {hand.finger_speed_m_s}"
    fall_s = math.sqrt(2 * recipe.planning.release_height_m / GRAVITY_M_S2)
    return (
        ("pick_lift.max_close_s", f"{MAX_JAW_M / 2:g} m {finger}", MAX_JAW_M / 2 / hand.finger_speed_m_s),
        ("execution.max_open_s", f"{OPEN_CLEARANCE_M:g} m {finger}", OPEN_CLEARANCE_M / hand.finger_speed_m_s),
        ("execution.release_wait_s", f"a fall from planning.release_height_m = {recipe.planning.release_height_m}", fall_s),
        (
            "execution.max_settle_steps",
            f"hand_physics.settled_checks = {hand.settled_checks} times hand_physics.check_every_steps = {hand.check_every_steps}",
            hand.settled_checks * hand.check_every_steps,
        ),
    )


def _at(recipe: Recipe, key: str) -> float:
    """The number at a key such as `scene_sampling.radius_m[1]`."""
    path, _, index = key.removesuffix("]").partition("[")
    value = operator.attrgetter(path)(recipe)
    return typing.cast(float, value[int(index)] if index else value)


def load_recipe(family: str, path: Path = DEFAULT_RECIPE) -> Recipe:
    """The recipe of a family: the top sections of the file, then what `[<family>.<section>]` overrides.

    The whole file is checked whichever family is loaded; the top sections are a recipe by themselves.

    Raises:
        RecipeError: names the key, its value and what is allowed.
    """
    if family not in FAMILIES:
        raise RecipeError(f"family {family!r}, must be one of {list(FAMILIES)}")
    content = _read(path)
    overrides = {name: content.pop(name, {}) for name in FAMILIES}
    _build(Recipe, content, "recipe")
    recipes = {}
    for name, override in overrides.items():
        if not isinstance(override, Mapping):
            raise RecipeError(f"recipe.{name}: {override!r}, must be a table")
        for shared in ("objects", "seed"):
            if shared in override:
                raise RecipeError(f"recipe.{name}.{shared}: {override[shared]!r}, must not be there: objects are shared by all families")
        recipes[name] = _build(Recipe, _merged(content, override), f"recipe.{name}")
    return recipes[family]


def _read(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise RecipeError(f"recipe {path}: {error.strerror or error}, must be a readable file") from error
    except UnicodeDecodeError as error:
        raise RecipeError(f"recipe {path}: byte {error.object[error.start]:#04x} at {error.start}, must be UTF-8") from error
    except tomllib.TOMLDecodeError as error:
        raise RecipeError(f"recipe {path}: {error}, must be TOML") from error


def _build(cls: type[_P], values: Mapping[str, Any], where: str) -> _P:
    hints = typing.get_type_hints(cls)
    known = {f.name for f in dataclasses.fields(cls)}  # type: ignore[arg-type]
    unknown = sorted(set(values) - known)
    if unknown:
        raise RecipeError(f"{where}.{unknown[0]}: unknown key, must be one of {sorted(known)}")
    arguments = {name: _converted(hints[name], value, f"{where}.{name}") for name, value in values.items()}
    try:
        return cls(**arguments)
    except BoundsError as error:
        raise RecipeError(f"{where}.{error}") from error
    except ValueError as error:
        raise RecipeError(f"{where}: {error}") from error


def _converted(hint: Any, value: Any, here: str) -> Any:
    """A value of the file as the type that a field wants."""
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if dataclasses.is_dataclass(hint):
        return _build(typing.cast(type, hint), _table(value, here), here)
    if origin is Mapping:
        return {key: _converted(inner[1], item, f"{here}.{key}") for key, item in _table(value, here).items()}
    if origin is tuple:
        n = None if Ellipsis in inner else len(inner)
        if not isinstance(value, list) or (n is not None and len(value) != n):
            raise RecipeError(f"{here}: {value!r}, must be a list" + ("" if n is None else f" of {n}"))
        kinds = [inner[0]] * len(value) if n is None else inner
        return tuple(_converted(kind, item, f"{here}[{k}]") for k, (kind, item) in enumerate(zip(kinds, value, strict=True)))
    if hint is float and type(value) is int and abs(value) < 2**53:
        return float(value)
    if type(value) is not hint:
        raise RecipeError(f"{here}: {value!r} is {type(value).__name__}, must be {hint.__name__}")
    if hint is float and not math.isfinite(value):
        raise RecipeError(f"{here}: {value!r}, must be finite")
    return value


def _table(value: Any, here: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise RecipeError(f"{here}: {value!r}, must be a table")
    return value


def _merged(base: Mapping[str, Any], override: Mapping[str, Any]) -> dict[str, Any]:
    out = dict(base)
    for name, value in override.items():
        out[name] = _merged(out[name], value) if isinstance(value, Mapping) and isinstance(out.get(name), Mapping) else value
    return out
