"""Pictures of one candidate for people: an execution from lift to rest as strip and film, a rejection as it would have been placed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float, UInt8

from objects.gripper import MAX_JAW_M, gripper_boxes, open_jaw_m
from pipelines.engines.physics.phases import Phase
from pipelines.engines.robot.arm import fk
from pipelines.engines.robot.geometry import moved
from pipelines.pictures.recording import Moment, Recording
from pipelines.pictures.renderer import Renderer, Rgb, View
from pipelines.pictures.sheet import Tile, moving, sheet
from pipelines.pictures.views import GHOST_RGB, OBJECT_RGB, OBSTACLE_RGB, add_table, keeping_in_view, picture_view, shrunk

PLACE_HAND_RGB: Rgb = (0.84, 0.37, 0.0)  # the hand at the place of a candidate that was not planned
_GHOST_OPACITY = 0.4
_FELL_M = -0.05  # below the top of the table
_STRIP_FRAMES = 8
_STRIP_COLUMNS = 4
_STRIP_PX = (320, 240)
_GIF_PX = (400, 300)
_GIF_FRAMES_A_SECOND = 12.0
_GIF_LAST_S = 1.5  # the end is looked at


@dataclass(frozen=True, slots=True)
class Frame:
    """One picture of a film: what the arm was doing, when, and the picture."""

    phase: Phase
    time_s: float
    picture: UInt8[np.ndarray, "h w 3"]


def execution_frames(recording: Recording, n_frames: int = 6, size_px: tuple[int, int] = (320, 240)) -> list[Frame]:
    """Photographs of an execution, of what tells it best, the last is the end; the target is a green ghost."""
    return photographs(recording, [recording.moments[k] for k in telling_moments(recording.moments, n_frames)], size_px)


def telling_moments(moments: Sequence[Moment], n: int) -> list[int]:
    """Numbers of n moments, ascending: the first, the last of each phase, and what lies halfway where arm and object move most between.

    Args:
        n: at least 2; where there are more phases, they are thinned out, and where there are fewer moments, all are taken.
    """
    last = len(moments) - 1
    chosen = [0, *(k for k in range(last) if k and moments[k].phase is not moments[k + 1].phase), last][: last + 1]
    if len(chosen) > n:
        return [chosen[k] for k in np.linspace(0, len(chosen) - 1, n).round().astype(int)]
    while len(chosen) < n:
        gaps = [(_way(moments[a], moments[b]), a, b) for a, b in pairwise(chosen) if b - a > 1]
        if not gaps:
            break
        _, a, b = max(gaps)
        halfway = min(range(a + 1, b), key=lambda k: abs(_way(moments[a], moments[k]) - _way(moments[k], moments[b])))
        chosen = sorted([*chosen, halfway])
    return chosen


def _way(a: Moment, b: Moment) -> float:
    """How different two moments look: the turns of the joints, a turn of one radian counting as much as 10 cm of the object."""
    return float(np.abs(b.q_rad - a.q_rad).sum() + 10.0 * np.linalg.norm(b.T_base_object[:3, 3] - a.T_base_object[:3, 3]))


def photographs(recording: Recording, moments: Sequence[Moment], size_px: tuple[int, int]) -> list[Frame]:
    """Photographs of some moments of a recording; the target is a green ghost."""
    view, frames = _view(recording, size_px), []
    with Renderer() as renderer:
        _add_scene(renderer, recording)
        robot = renderer.add_robot()
        body = renderer.add_mesh(recording.object_model.mesh, recording.candidate.scene.T_base_object, OBJECT_RGB)
        T_base_target = recording.candidate.target.T_base_target
        ghost = renderer.add_mesh(recording.object_model.mesh, T_base_target, GHOST_RGB)
        for moment in moments:
            renderer.pose_robot(robot, moment.q_rad, moment.fingers_m)
            renderer.move(body, moment.T_base_object)
            renderer.move(ghost, _away())
            picture = renderer.photograph(view).rgb.astype(np.float64)
            renderer.move(ghost, T_base_target)
            picture += _GHOST_OPACITY * (renderer.photograph(view).rgb - picture)
            frames.append(Frame(moment.phase, moment.time_s, shrunk(picture)))
    return frames


def filmstrip(recording: Recording) -> bytes:
    """PNG: an execution in eight pictures, or a rejection in two, with phases, times and the verdict in words."""
    if not recording.is_executed:
        return sheet(_rejection_tiles(recording, _STRIP_PX), 2, _title(recording))
    frames = execution_frames(recording, _STRIP_FRAMES, _STRIP_PX)
    return sheet([Tile(frame.picture, _caption(frame)) for frame in frames], _STRIP_COLUMNS, _title(recording))


def strip_tiles(recording: Recording, n_frames: int, size_px: tuple[int, int]) -> list[Tile]:
    """One row of a sheet of many candidates: its id under the first picture, what became of it under the last.

    A rejection has two pictures and is filled up with white ones; so is an execution with fewer moments than frames.
    """
    name = recording.candidate.candidate_id
    if recording.is_executed:
        frames = execution_frames(recording, n_frames, size_px)
        captions = [f"{name}  {_caption(frames[0])}", *map(_caption, frames[1:-1]), f"{frames[-1].time_s:.2f} s: {_status(recording)}"]
        tiles = [Tile(frame.picture, caption) for frame, caption in zip(frames, captions, strict=True)]
    else:
        start, place = _rejection_tiles(recording, size_px)
        tiles = [Tile(start.picture, f"{name}  after the lift"), Tile(place.picture, _status(recording))]
    white = np.full((size_px[1], size_px[0], 3), 255, dtype=np.uint8)
    return [*tiles, *(Tile(white, "") for _ in range(n_frames - len(tiles)))]


def film(recording: Recording) -> bytes:
    """GIF in real time: an execution and its end, or the two pictures of a rejection in turn."""
    if not recording.is_executed:
        return moving(_rejection_tiles(recording, _GIF_PX), [_GIF_LAST_S, 2 * _GIF_LAST_S])
    wanted = np.arange(0.0, recording.moments[-1].time_s, 1.0 / _GIF_FRAMES_A_SECOND)
    times_s = np.array([moment.time_s for moment in recording.moments])
    picked = np.unique([*(int(np.abs(times_s - t).argmin()) for t in wanted), len(times_s) - 1])
    frames = photographs(recording, [recording.moments[k] for k in picked], _GIF_PX)
    tiles = [Tile(frame.picture, f"{recording.candidate.candidate_id}  {_caption(frame)}") for frame in frames]
    tiles[-1] = Tile(frames[-1].picture, recording.verdict)
    return moving(tiles, [*np.diff(times_s[picked]).tolist(), _GIF_LAST_S])


def _title(recording: Recording) -> str:
    labels, parts = recording.labels, [recording.verdict]
    if labels.get("final_position_error_m") is not None:
        degrees = np.rad2deg(labels["final_rotation_error_rad"])
        parts.append(f"{1e3 * labels['final_position_error_m']:.1f} mm and {degrees:.1f}° from the target")
    return f"{'; '.join(parts)} ({recording.object_model.object_id})"


def _status(recording: Recording) -> str:
    labels = recording.labels
    return str(labels["exec_status" if recording.is_executed else "plan_status"]).replace("_", " ")


def _caption(frame: Frame) -> str:
    return f"{frame.phase.value}  {frame.time_s:.2f} s"


def _rejection_tiles(recording: Recording, size_px: tuple[int, int]) -> list[Tile]:
    """The state after the lift, and beside it the hand at the place: boxes, because no arm was found that brings it there."""
    grasp = recording.candidate.grasp
    (start,) = photographs(recording, recording.moments, size_px)
    jaw_m = open_jaw_m(recording.object_model.grasp(grasp.grasp_id).jaw_width_m)
    view = picture_view(size_px, recording.candidate.target.T_base_target[:2, 3])
    with Renderer() as renderer:
        _add_scene(renderer, recording)
        for T_tcp_box, size_m in zip(*gripper_boxes(jaw_m), strict=True):
            renderer.add_box(size_m, recording.T_base_place @ T_tcp_box, PLACE_HAND_RGB)
        renderer.add_mesh(recording.object_model.mesh, recording.candidate.target.T_base_target, GHOST_RGB)
        picture = shrunk(renderer.photograph(view).rgb.astype(np.float64))
    status = recording.labels["plan_status"]
    return [Tile(start.picture, "after the lift, where planning starts"), Tile(picture, f"at the place: {status}")]


def _view(recording: Recording, size_px: tuple[int, int]) -> View:
    """Of the way from object to target, moved back where hand or object leave that on the way."""
    scene, target = recording.candidate.scene, recording.candidate.target
    near = picture_view(size_px, (scene.T_base_object[:2, 3] + target.T_base_target[:2, 3]) / 2)
    return keeping_in_view(near, _ends_of_hand_and_object(recording))


def _ends_of_hand_and_object(recording: Recording) -> Float[np.ndarray, "n 3"]:
    """Corners of the boxes around both at every moment and around the target, but for what fell off the table."""
    in_object = _box_corners(recording.object_model.mesh.vertices_m)
    in_hand = np.concatenate(
        [moved(T, _box_corners(np.array([-size_m / 2, size_m / 2]))) for T, size_m in zip(*gripper_boxes(MAX_JAW_M), strict=True)]
    )
    places = [moved(moment.T_base_object, in_object) for moment in recording.moments]
    hands = [moved(fk(moment.q_rad), in_hand) for moment in recording.moments]
    points_m = np.concatenate([*places, *hands, moved(recording.candidate.target.T_base_target, in_object)])
    return points_m[points_m[:, 2] > _FELL_M]


def _box_corners(points_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "8 3"]:
    ends = np.array([points_m.min(axis=0), points_m.max(axis=0)])
    return np.array([[ends[i, 0], ends[j, 1], ends[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])


def _add_scene(renderer: Renderer, recording: Recording) -> None:
    add_table(renderer)
    for obstacle in recording.candidate.scene.obstacles:
        renderer.add_box(obstacle.size_m, obstacle.T_base_obstacle, OBSTACLE_RGB)


def _away() -> Float[np.ndarray, "4 4"]:
    T = np.eye(4)
    T[2, 3] = -10.0
    return T
