"""Which object and how many obstacles a scene has: a pure function of its id, known before anything is sampled.

`interleaved`, the benchmark's: a fixed number of scenes. Objects take turns by category (can, mug, cuboid, can, ...), so that any 19
neighbours hold all categories. The obstacle count of an object moves on by one each time the object returns, so that it is balanced over
objects, categories and shards. Another object in the catalogue is another allocation.

`appended`, for a catalogue that grows: object k of the file has the k-th block of scenes of each family (`tables.layout` says how many),
whole shards that it shares with no other object, with 0, 1, 2, 0, ... obstacles. An object appended to the file has new scenes behind
all others, and no earlier scene changes: neither its object nor its obstacles, nor any row, since rows follow from id, object and recipe.
"""

from __future__ import annotations

from collections.abc import Sequence

from objects.catalogue import CatalogueOrder
from pipelines.values import SceneAllocation
from tables.vocabulary import Allocation

N_OBSTACLE_COUNTS = 3


def scene_allocation(scene_id: str, catalogue: CatalogueOrder) -> SceneAllocation:
    """Allocation of a scene.

    Raises:
        IdentityError: no scene of a dataset of this catalogue.
    """
    family, index = catalogue.layout.parse_scene(scene_id)
    if catalogue.allocation is Allocation.APPENDED:
        n_scenes = catalogue.layout.n_scenes_of(family) // len(catalogue.objects)
        object_id, category = catalogue.objects[index // n_scenes]
        return SceneAllocation(scene_id, object_id, category, index % n_scenes % N_OBSTACLE_COUNTS)
    order, n_categories = _interleaved(catalogue.objects)
    if family == "mini":
        # Spread the four objects of a category over the catalogue instead of taking the first four.
        spread = max(1, (len(order) // n_categories - 1) // 3)
        turn = index // n_categories
        position = (turn * n_categories * spread + index % n_categories) % len(order)
        n_obstacles = (turn + index % n_categories) % N_OBSTACLE_COUNTS
    else:
        position = index % len(order)
        n_obstacles = (position // n_categories + index // len(order)) % N_OBSTACLE_COUNTS
    object_id, category = order[position]
    return SceneAllocation(scene_id, object_id, category, n_obstacles)


def family_allocation(family: str, catalogue: CatalogueOrder) -> tuple[SceneAllocation, ...]:
    """Allocations of all scenes of a family, built or not."""
    return tuple(scene_allocation(scene_id, catalogue) for scene_id in catalogue.layout.scenes_of_family(family))


def _interleaved(objects: Sequence[tuple[str, str]]) -> tuple[list[tuple[str, str]], int]:
    categories = list(dict.fromkeys(category for _, category in objects))
    queues = [[item for item in objects if item[1] == category] for category in categories]
    order = [queue[turn] for turn in range(max(map(len, queues))) for queue in queues if turn < len(queue)]
    return order, len(categories)
