"""Planned candidates executed again under small real uncertainty: what even the best choice cannot know before it is made.

Drawn from identity, evenly and each by itself: friction +-10 %, mass +-5 %, where the object lies in the hand +-1 mm and +-1 degree on
every axis, and the start of each motion -1, 0 or +1 tick. The plan does not know. What the replicates mean is reports/ceiling.py's.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from objects.gripper import MAX_JAW_M
from objects.object_model import ObjectModel
from pipelines.codecs import Row
from pipelines.decoded import Decoded
from pipelines.engines.physics.hand_world import HandWorld
from pipelines.labels.execution import Lateness, execute_held
from pipelines.labels.planning import motion_of
from pipelines.labels.verdict import Monitor
from pipelines.proofs.validity.kept_rows import KeptRows
from pipelines.recipe import Recipe
from pipelines.running.workers import run_units
from pipelines.values import Candidate, LiftedGrasp, Plan
from tables.errors import PlaceBenchError
from tables.identity import parse_candidate_id, rng_for
from tables.schemas import TEST_REPLICATES
from tables.store import table_from_rows
from tables.vocabulary import ExecStatus

# Changes whenever rows may.
CODE_VERSION = "1"
N_REPLICATES = 5

# Half widths of what is drawn, as counts of a grid: values that repeat take a tenth of the room, and no outcome needs finer ones.
_GRID = 1e-4
_FRICTION_STEPS, _MASS_STEPS = 1000, 500  # 10 % and 5 %
_SHIFT_STEPS, _SHIFT_STEP_M = 1000, 1e-6  # 1 mm
_TURN_STEPS, _TURN_STEP_RAD = 1000, math.radians(1.0) / 1000  # 1 degree
_LATE_TICKS = 1

# The hand takes the object from where it lies between open fingers: a finger that starts inside it would throw it out.
_TAKE_GAP_M = 0.002
# 3 mm at 50 mm/s, the ramp of the grip force, and five relaxation times of the pads.
_TAKE_S = 0.15


class ReplicateError(PlaceBenchError, RuntimeError):
    """Replicates that could not be made; names the scene and why."""


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """What is different in one execution.

    Attributes:
        shift_m, turn_rad: of the object in the hand, in the axes of the TCP; the turn is a rotation vector about the object's origin.
    """

    friction_scale: float
    mass_scale: float
    shift_m: tuple[float, float, float]
    turn_rad: tuple[float, float, float]
    late: Lateness

    def moved(self, T_tcp_object: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
        """Where the object lies in the hand instead."""
        T = np.array(T_tcp_object)
        T[:3, :3] = Rotation.from_rotvec(self.turn_rad).as_matrix() @ T[:3, :3]
        T[:3, 3] += self.shift_m
        return T

    def row(self) -> Row:
        """Its columns of `test_replicates`."""
        shift = {f"shift_{axis}_m": value for axis, value in zip("xyz", self.shift_m, strict=True)}
        turn = {f"turn_{axis}_rad": value for axis, value in zip("xyz", self.turn_rad, strict=True)}
        late = {f"late_{name}_ticks": ticks for name, ticks in dataclasses.asdict(self.late).items()}
        return {"friction_scale": self.friction_scale, "mass_scale": self.mass_scale, **shift, **turn, **late}


NOTHING = Uncertainty(1.0, 1.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), Lateness())


@dataclass(frozen=True, slots=True)
class SceneWork:
    """The planned candidates of one scene with all that it takes to execute them; what a worker is given."""

    scene_id: str
    object_model: ObjectModel
    planned: tuple[tuple[Candidate, Plan], ...]
    recipe: Recipe
    n_replicates: int


def uncertainty_of(seed: int, candidate_id: str, replicate: int) -> Uncertainty:
    """What one replicate of a candidate is made under; friction, mass, shift and turn are even on their intervals."""
    rng = rng_for(seed, "test_replicate", candidate_id, replicate)

    def steps(half: int, n: int) -> list[int]:
        return [int(step) for step in rng.integers(-half, half, size=n, endpoint=True)]

    (friction,), (mass,) = steps(_FRICTION_STEPS, 1), steps(_MASS_STEPS, 1)
    x, y, z = (_SHIFT_STEP_M * step for step in steps(_SHIFT_STEPS, 3))
    rx, ry, rz = (_TURN_STEP_RAD * step for step in steps(_TURN_STEPS, 3))
    late = Lateness(*steps(_LATE_TICKS, 3))
    return Uncertainty(1.0 + _GRID * friction, 1.0 + _GRID * mass, (x, y, z), (rx, ry, rz), late)


def execute_uncertain(object_model: ObjectModel, candidate: Candidate, plan: Plan, recipe: Recipe, unknown: Uncertainty) -> Row:
    """The row of `execution_labels` of one candidate; slip counts from where the hand took the object.

    Raises:
        PhysicsError: the engine warned or gave a state that is not finite; names the candidate.
    """
    setup, grasp = recipe.execution_setup, candidate.grasp
    scale = setup.physics.friction_scale * unknown.friction_scale
    setup = dataclasses.replace(setup, physics=dataclasses.replace(setup.physics, friction_scale=scale))
    model = dataclasses.replace(
        object_model,
        mass_kg=unknown.mass_scale * object_model.mass_kg,
        inertia_kg_m2=unknown.mass_scale * object_model.inertia_kg_m2,
    )
    with HandWorld(model, candidate.scene.obstacles, setup.physics) as world:
        T_tcp_object = unknown.moved(grasp.T_tcp_object)
        world.start_taking(candidate.candidate_id, grasp.lifted_q_rad, _open_finger_m(grasp), T_tcp_object, _TAKE_S)
        monitor = Monitor(world, world.inhand_pose(), setup.execution)
        return execute_held(world, candidate, motion_of(candidate, plan, recipe.planning), setup, monitor, unknown.late)


def _open_finger_m(grasp: LiftedGrasp) -> float:
    return min(float(np.max(grasp.fingers_m)) + _TAKE_GAP_M, MAX_JAW_M / 2)


def scene_rows(work: SceneWork) -> list[Row]:
    """Rows of `test_replicates` of one scene."""
    rows: list[Row] = []
    for candidate, plan in work.planned:
        for replicate in range(work.n_replicates):
            unknown = uncertainty_of(work.recipe.seed, candidate.candidate_id, replicate)
            label = execute_uncertain(work.object_model, candidate, plan, work.recipe, unknown)
            rows.append(
                {
                    "candidate_id": candidate.candidate_id,
                    "replicate": replicate,
                    **unknown.row(),
                    "exec_status": label["exec_status"],
                    "is_success": label["exec_status"] == ExecStatus.SUCCESS.value,
                    "tolerance_margin": label["tolerance_margin"],
                }
            )
    return rows


def works_of(values: Decoded, candidate_ids: Sequence[str], recipe: Recipe, n_replicates: int = N_REPLICATES) -> list[SceneWork]:
    """Planned candidates by scene, in the order of their ids.

    Raises:
        ReplicateError: a candidate without a plan.
        IdentityError: an id that is no candidate.
    """
    by_scene: dict[str, list[tuple[Candidate, Plan]]] = {}
    for name in sorted(candidate_ids):
        plan = values.plan(name)
        if plan is None:
            raise ReplicateError(f"{name}: no plan, must have one to be executed")
        by_scene.setdefault(parse_candidate_id(name).scene_id, []).append((values.candidate(name), plan))
    return [
        SceneWork(scene_id, values.object_model_of(planned[0][0]), tuple(planned), recipe, n_replicates)
        for scene_id, planned in sorted(by_scene.items())
    ]


def replicate_table(
    works: Sequence[SceneWork],
    kept: Path,
    made_from: Mapping[str, str],
    n_workers: int,
    on_scene: Callable[[int, int, float], None] = lambda done, total, core_s: None,
) -> pa.Table:
    """Table `test_replicates`, every scene kept as it finishes, so that a killed run goes on where it was.

    Args:
        works: the scenes.
        kept: file of the finished scenes.
        made_from: what decides the rows besides the scenes.
        n_workers: worker processes; 0 stays in this process. Rows do not depend on it.
        on_scene: told the scenes done, all of them, and the core seconds spent in this run.

    Raises:
        ReplicateError: a scene that failed; the others are kept.
    """
    errors: list[str] = []
    core_s = 0.0
    with KeptRows(kept, made_from) as rows:
        missing = [work for work in works if work.scene_id not in rows.rows]
        on_scene(len(works) - len(missing), len(works), core_s)
        with closing(run_units(scene_rows, [(work,) for work in missing], n_workers)) as outcomes:
            for n_done, outcome in enumerate(outcomes, len(works) - len(missing) + 1):
                core_s += outcome.core_ms / 1e3
                scene_id = missing[outcome.index].scene_id
                if outcome.error is None:
                    rows.add(scene_id, {"rows": outcome.value})
                else:
                    errors.append(f"{scene_id}: {outcome.error.strip().splitlines()[0]}")
                on_scene(n_done, len(works), core_s)
        if errors:
            raise ReplicateError(f"{len(errors)} of {len(works)} scenes failed, must be 0: {min(errors)}")
        return table_from_rows(TEST_REPLICATES, [row for work in works for row in rows.rows[work.scene_id]["rows"]])
