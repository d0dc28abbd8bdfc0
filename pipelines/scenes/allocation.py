"""Which object and how many obstacles a scene has: a pure function of its id, known before anything is sampled."""

from __future__ import annotations

from collections.abc import Sequence

from pipelines.values import SceneAllocation
from tables.identity import n_scenes_of, parse_scene_id, scene_id_of

N_OBSTACLE_COUNTS = 3


def scene_allocation(scene_id: str, objects: Sequence[tuple[str, str]]) -> SceneAllocation:
    """Allocation of a scene.

    Objects take turns by category (can, mug, cuboid, can, ...), so that any 19 neighbours hold all categories. The obstacle count
    of an object moves on by one each time the object returns, so that it is balanced over objects, categories and shards.

    Args:
        scene_id: a `mini` or `full` scene id.
        objects: (object id, category) in catalogue order.
    """
    family, index = parse_scene_id(scene_id)
    order, n_categories = _interleaved(objects)
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


def family_allocation(family: str, objects: Sequence[tuple[str, str]]) -> tuple[SceneAllocation, ...]:
    """Allocations of all scenes of a family, built or not."""
    return tuple(scene_allocation(scene_id_of(family, k), objects) for k in range(n_scenes_of(family)))


def _interleaved(objects: Sequence[tuple[str, str]]) -> tuple[list[tuple[str, str]], int]:
    if not objects:
        raise ValueError("the catalogue has 0 objects, must have at least 1")
    categories = list(dict.fromkeys(category for _, category in objects))
    queues = [[item for item in objects if item[1] == category] for category in categories]
    order = [queue[turn] for turn in range(max(map(len, queues))) for queue in queues if turn < len(queue)]
    return order, len(categories)
