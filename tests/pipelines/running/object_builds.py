"""Small catalogues, and object tables made of them, for the tests of what is built and what is kept."""

from __future__ import annotations

from pathlib import Path

from objects.build import ObjectParams
from objects.grasp_pool import GraspPoolParams
from pipelines.recipe import Recipe
from pipelines.running.data_root import DataRoot
from pipelines.running.object_tables import make_object_tables
from pipelines.scenes.sampling import SceneSamplingParams
from tables.store import Sidecar
from tests.objects.test_catalogue import BOX, CAN, write

# Fewer candidates: the mechanics are the same and a build takes a fifth of the time.
N_GRASPS = SceneSamplingParams().min_initial_grasps
RECIPE = Recipe(objects=ObjectParams(grasp_pool=GraspPoolParams(n_candidates=2000, n_grasps=N_GRASPS, min_grasps=N_GRASPS)))
BRICK = {**BOX, "id": '"brick"', "size_m": "[0.04, 0.05, 0.09]"}
TIN = CAN
THREE = (BOX, BRICK, TIN)
CRATE = {**BOX, "id": '"crate"', "size_m": "[0.1, 0.1, 0.1]"}  # too wide for the jaw


def make(root: DataRoot, *entries: dict[str, str], recipe: Recipe = RECIPE, n_workers: int = 0) -> tuple[dict[str, Sidecar], list[str]]:
    """Sidecars of the tables of a catalogue with these entries, and what was logged."""
    lines: list[str] = []
    return make_object_tables(root, recipe, write(root.path.parent, *entries), n_workers, lines.append), lines


def hashes(sidecars: dict[str, Sidecar]) -> dict[str, tuple[str, str]]:
    """Of values and of bytes."""
    return {name: (sidecar.content_hash, sidecar.sha256) for name, sidecar in sidecars.items()}


def from_nothing(folder: Path, *entries: dict[str, str]) -> dict[str, tuple[str, str]]:
    """What building all objects at once gives."""
    folder.mkdir()
    return hashes(make(DataRoot(folder / "data"), *entries)[0])


def rows_of(root: DataRoot, *object_ids: str) -> dict[str, list[dict[str, object]]]:
    return {name: [row for row in table.to_pylist() if row["object_id"] in object_ids] for name, table in root.read_objects().items()}
