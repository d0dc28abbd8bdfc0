"""Pictures of one execution, from lift to rest, for people; what happens in them is decided in labels.execution."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, UInt8

from objects.object_model import ObjectModel
from pipelines.codecs import Row
from pipelines.engines.physics.hand_world import HandWorld
from pipelines.engines.physics.phases import Phase
from pipelines.labels.execution import ExecutionSetup, execute_candidate
from pipelines.pictures.renderer import Renderer
from pipelines.pictures.views import GHOST_RGB, OBJECT_RGB, OBSTACLE_RGB, add_table, picture_view, shrunk
from pipelines.values import Candidate, Motion, Scene

_GHOST_OPACITY = 0.4


@dataclass(frozen=True, slots=True)
class Frame:
    """One picture of a film: what the arm was doing, when, and the picture."""

    phase: Phase
    time_s: float
    picture: UInt8[np.ndarray, "h w 3"]


def render_execution_frames(
    object_model: ObjectModel,
    candidate: Candidate,
    motion: Motion,
    setup: ExecutionSetup,
    *,
    n_frames: int = 6,
    size_px: tuple[int, int] = (320, 240),
) -> tuple[Row, list[Frame]]:
    """Run a candidate as its label was made and photograph it.

    Frames are spread evenly over time, the last is the end. The target is a green ghost.

    Returns:
        The row of `execution_labels`, and `n_frames` frames.
    """
    with HandWorld(object_model, candidate.scene.obstacles, setup.physics) as world:
        film = _Film(world)
        row = execute_candidate(world, candidate, motion, setup, film.watch)
    picked = np.unique(np.linspace(0, len(film.states) - 1, n_frames).round().astype(int))
    return row, _pictures(object_model, candidate.scene, candidate.target.T_base_target, [film.states[k] for k in picked], size_px)


@dataclass(frozen=True, slots=True)
class _State:
    phase: Phase
    time_s: float
    q_rad: Float[np.ndarray, "7"]
    fingers_m: Float[np.ndarray, "2"]
    T_base_object: Float[np.ndarray, "4 4"]


@dataclass(slots=True)
class _Film:
    world: HandWorld
    states: list[_State] = field(default_factory=list)

    def watch(self, phase: Phase) -> bool:
        # The arm leaves the world before the object settles; in the pictures it stays where it was.
        arm = self.world.arm_state() if self.world.has_robot else (self.states[-1].q_rad, self.states[-1].fingers_m)
        self.states.append(_State(phase, self.world.n_steps * self.world.params.dt_s, *arm, self.world.object_pose()))
        return False


def _pictures(
    object_model: ObjectModel, scene: Scene, T_base_target: Float[np.ndarray, "4 4"], states: list[_State], size_px: tuple[int, int]
) -> list[Frame]:
    view = picture_view(size_px, (scene.T_base_object[:2, 3] + T_base_target[:2, 3]) / 2)
    frames = []
    with Renderer() as renderer:
        add_table(renderer)
        for obstacle in scene.obstacles:
            renderer.add_box(obstacle.size_m, obstacle.T_base_obstacle, OBSTACLE_RGB)
        robot = renderer.add_robot()
        body = renderer.add_mesh(object_model.mesh, scene.T_base_object, OBJECT_RGB)
        ghost = renderer.add_mesh(object_model.mesh, T_base_target, GHOST_RGB)
        T_away = np.eye(4)
        T_away[2, 3] = -10.0
        for state in states:
            renderer.pose_robot(robot, state.q_rad, state.fingers_m)
            renderer.move(body, state.T_base_object)
            renderer.move(ghost, T_away)
            picture = renderer.photograph(view).rgb.astype(np.float64)
            renderer.move(ghost, T_base_target)
            picture += _GHOST_OPACITY * (renderer.photograph(view).rgb - picture)
            frames.append(Frame(state.phase, state.time_s, shrunk(picture)))
    return frames
