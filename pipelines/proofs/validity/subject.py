"""What studies are made of: a tier's release and recipe, and which of its rows they look at, chosen by hashes of their identities."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import pyarrow as pa

from objects.gripper import MAX_JAW_M
from objects.object_model import ObjectModel
from pipelines.codecs import Row
from pipelines.decoded import Decoded
from pipelines.labels.planning import motion_of
from pipelines.recipe import Recipe
from pipelines.values import Candidate, Motion, Plan
from tables.identity import order_key
from tables.vocabulary import Category

# Room of each finger beside an object that a hand takes out of the air.
TAKE_GAP_M = 0.002


@dataclass(frozen=True, slots=True)
class Sizes:
    """How much is measured; nothing of it grows with the tier by itself, since every study looks at so many and no more."""

    n_grasps: int = 5  # of every object, hand down
    n_grasps_elsewhere: int = 2  # of every object in each other direction of the hand
    n_flat: int = 3
    n_loads: int = 6000  # executed cans and cuboids; all of pilot
    n_executions: int = 300
    n_friction: int = 600  # executions under other friction: of 300, eight flip, which cannot tell 0.9 of them from 0.8
    n_lifts: int = 150
    n_second_engine: int = 150

    def __post_init__(self) -> None:
        for name in self.__slots__:
            if getattr(self, name) < 1:
                raise ValueError(f"{name} = {getattr(self, name)}, must be at least 1")

    @classmethod
    def of_tier(cls, tier: str) -> Sizes:
        """What a tier is measured by: `full` asks the second engine twice as often as the others do."""
        return cls(n_second_engine=300) if tier == "full" else cls()


@dataclass(frozen=True, slots=True)
class Subject:
    """A tier as studies see it.

    Attributes:
        values: candidates, scenes, objects, grasps and plans, decoded.
        candidates: table `candidates`, the stored labels.
        recipe: what the labels were made with.
    """

    values: Decoded
    candidates: pa.Table
    recipe: Recipe
    sizes: Sizes

    def object_models(self) -> list[ObjectModel]:
        """Every object of the catalogue, by id."""
        return [self.values.object_models[name] for name in sorted(self.values.object_models)]

    def flat_objects(self) -> list[ObjectModel]:
        """The first cuboids, by id, whose thinnest side fits into the open jaw."""
        boxes = [model for model in self.object_models() if model.category == Category.CUBOID]
        return [model for model in boxes if min(_edges_m(model)) + 2 * TAKE_GAP_M <= MAX_JAW_M][: self.sizes.n_flat]

    def executed(self, categories: Iterable[str] | None = None) -> list[Row]:
        """Label columns of the executed candidates of some categories, or of all."""
        columns = ["candidate_id", "category", "exec_status", "y_pipe", "transport_slip_m", "transport_slip_rad"]
        wanted = None if categories is None else set(categories)
        rows = self.candidates.select(columns).to_pylist()
        return [row for row in rows if row["exec_status"] is not None and (wanted is None or row["category"] in wanted)]

    def case(self, candidate_id: str) -> Case:
        """A planned candidate with its object; raises IdentityError where there is no such candidate."""
        candidate, plan = self.values.candidate(candidate_id), self.values.plan(candidate_id)
        if plan is None:
            raise ValueError(f"{candidate_id}: executed, but without a plan")
        return Case(self.values.object_model_of(candidate), candidate, plan, self.recipe)


@dataclass(frozen=True, slots=True)
class Case:
    """A planned candidate with all that it takes to execute it; what a worker is given."""

    object_model: ObjectModel
    candidate: Candidate
    plan: Plan
    recipe: Recipe

    def motion(self) -> Motion:
        """The motion that was planned."""
        return motion_of(self.candidate, self.plan, self.recipe.planning)


def choose_mixed(strata: Mapping[tuple[str, str], Sequence[str]], seed: int, purpose: str, n: int) -> list[str]:
    """The same number of ids of each category, and within it of every status as many as is its share, those that hash lowest.

    Args:
        strata: ids by category and status.
        n: in all; a category that has fewer than its part gives all it has.
    """
    categories = sorted({category for category, _ in strata})
    chosen: list[str] = []
    for k, category in enumerate(categories):
        own = {status: ids for (name, status), ids in sorted(strata.items()) if name == category}
        part = n // len(categories) + (k < n % len(categories))
        for status, m in _proportional({status: len(ids) for status, ids in own.items()}, part).items():
            chosen += sorted(own[status], key=lambda name: order_key(seed, purpose, name))[:m]
    return sorted(chosen)


def _proportional(sizes: Mapping[str, int], n: int) -> dict[str, int]:
    """Places of each of some groups, by the largest remainders; all of a group where there are enough places for all."""
    total = sum(sizes.values())
    if total <= n:
        return dict(sizes)
    places = {name: n * size // total for name, size in sizes.items()}
    by_remainder = sorted(sizes, key=lambda name: (-(n * sizes[name] % total), name))
    for name in by_remainder[: n - sum(places.values())]:
        places[name] += 1
    return places


def _edges_m(object_model: ObjectModel) -> list[float]:
    vertices_m = object_model.mesh.vertices_m
    return [float(edge) for edge in vertices_m.max(axis=0) - vertices_m.min(axis=0)]
