"""Contact sheets for people: scenes with target ghosts, grasps at their objects, filmstrips of each outcome; nothing is judged here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
import polars as pl
import pyarrow as pa
import trimesh
from jaxtyping import UInt8

from objects.gripper import gripper_boxes, open_jaw_m
from objects.object_model import ObjectModel, TriangleMesh
from pipelines.codecs import Row, pose_in
from pipelines.decoded import Decoded
from pipelines.engines.robot.geometry import moved
from pipelines.frames import frame_of
from pipelines.pictures.filmstrip import execution_frames
from pipelines.pictures.renderer import Renderer, View
from pipelines.pictures.sheet import Tile, sheet
from pipelines.pictures.views import GHOST_RGB, OBJECT_RGB, OBSTACLE_RGB, add_table, render_scene, shrunk
from pipelines.recipe import Recipe
from pipelines.values import Scene
from reports.recordings import recording_of
from reports.report import Report
from tables.identity import order_key
from tables.vocabulary import ExecStatus

_TILE_PX = (400, 300)
_OBJECT_PX = (300, 225)
FRAME_PX = (240, 180)
_TITLE_PX = (960, 480)
_GHOST_OPACITY = 0.5
FRAMES_OF_FILM = 6
_N_SCENES = 12
_N_GRASPS_DRAWN = 8
_GRASP_RGBS = ((0.0, 0.45, 0.70), (0.90, 0.62, 0.0), (0.0, 0.62, 0.45), (0.80, 0.47, 0.65), (0.34, 0.71, 0.91), (0.84, 0.37, 0.0))


def gallery_report(tables: Mapping[str, pa.Table], recipe: Recipe | None, *, tier: str, n_films: int, why_no_films: str = "") -> Report:
    """Report `gallery`: what a release looks like.

    Args:
        tables: a release with `objects`, `object_meshes`, `object_parts`, `stable_poses`, `grasp_pool`, `scenes`, `obstacles`, `targets`,
            `grasps`, `candidates`, and `plans` for films.
        recipe: what the labels were made with; films run each execution again. None for no films.
        n_films: filmstrips of each execution status, chosen by the hash of the candidate id.
        why_no_films: said where there is no recipe.
    """
    release = Decoded(tables)
    object_models, scenes, grasps = release.object_models, release.scenes, release.grasp_rows
    shown = [object_models[name] for name in sorted({scene.object_id for scene in scenes.values()})]
    figures = {
        "gallery-objects": sheet([tile for object_model in shown for tile in _object_tiles(object_model)], 6),
        "gallery-title": sheet([_title_tile(scenes, object_models, grasps)], 1),
        "gallery-scenes": sheet([_scene_tile(scenes[name], object_models) for name in sorted(scenes)[:_N_SCENES]], 4),
        "gallery-grasps": sheet([_grasp_tile(scene, object_models, grasps[scene.scene_id]) for scene in _one_an_object(scenes)], 5),
    }
    blocks = [
        f"# Gallery of tier {tier}",
        "Everything is rendered from the release's tables; films run the stored plan again, as the label was made.",
        "![A scene, its targets and some of its grasps](gallery-title.png)",
        "## Objects\n\nThe convex parts that planner and physics are given, and the whole grasp pool, a colour for each kind of grasp.",
        "![Objects](gallery-objects.png)",
        "## Scenes\n\nObject blue, obstacles brown, the eight targets as green ghosts.",
        "![Scenes](gallery-scenes.png)",
        f"## Lifted grasps\n\nUp to {_N_GRASPS_DRAWN} of the grasps that passed the pick-lift check, at the object's initial pose.",
        "![Grasps](gallery-grasps.png)",
    ]
    if recipe is None:
        blocks.append(f"## Executions\n\nNo films: {why_no_films}.")
    for status, strips in _films(tables, release, recipe, n_films).items() if recipe is not None else ():
        figures[f"gallery-{status}"] = sheet(strips, FRAMES_OF_FILM)
        blocks += [f"## Executions that ended as {status.replace('_', ' ')}", f"![{status}](gallery-{status}.png)"]
    return Report("gallery", "\n\n".join(blocks) + "\n", figures)


def _object_tiles(object_model: ObjectModel) -> list[Tile]:
    """An object in its own frame: its convex parts, and its pool."""
    size_m = float(np.ptp(object_model.mesh.vertices_m, axis=0).max())
    grippers: dict[str, list[TriangleMesh]] = {}
    for grasp in object_model.grasps:
        glyph = _gripper_glyph(open_jaw_m(grasp.jaw_width_m), 0.08)
        placed = TriangleMesh(moved(grasp.T_object_grasp, glyph.vertices_m), glyph.faces)
        grippers.setdefault(grasp.grasp_kind, []).append(placed)
    parts = [(part, _GRASP_RGBS[k % len(_GRASP_RGBS)]) for k, part in enumerate(object_model.parts)]
    pool = [(_joined(grippers[kind]), _GRASP_RGBS[k % len(_GRASP_RGBS)]) for k, kind in enumerate(sorted(grippers))]
    kinds = ", ".join(f"{len(grippers[kind])} {kind}" for kind in sorted(grippers))
    return [
        Tile(_close_up(parts, 0.55 * size_m + 0.02), f"{object_model.object_id}, convex parts: {len(object_model.parts)}"),
        Tile(_close_up([(object_model.mesh, OBJECT_RGB), *pool], 0.55 * size_m + 0.09), kinds),
    ]


def _close_up(meshes: Sequence[tuple[TriangleMesh, tuple[float, float, float]]], radius_m: float) -> UInt8[np.ndarray, "h w 3"]:
    """Meshes about the origin, from above and the front."""
    eye = tuple(3.0 * radius_m * np.array([0.62, 0.55, 0.56]))
    view = View((eye[0], eye[1], eye[2]), (0.0, 0.0, 0.0), 40.0, 2 * _OBJECT_PX[0], 2 * _OBJECT_PX[1])
    with Renderer() as renderer:
        for mesh, rgb in meshes:
            renderer.add_mesh(mesh, np.eye(4), rgb)
        return shrunk(renderer.photograph(view).rgb)


def _joined(meshes: Sequence[TriangleMesh]) -> TriangleMesh:
    firsts = np.cumsum([0, *(len(mesh.vertices_m) for mesh in meshes[:-1])])
    faces = [mesh.faces + first for mesh, first in zip(meshes, firsts, strict=True)]
    return TriangleMesh(np.concatenate([mesh.vertices_m for mesh in meshes]), np.concatenate(faces))


def _one_an_object(scenes: Mapping[str, Scene]) -> list[Scene]:
    first: dict[str, Scene] = {}
    for name in sorted(scenes):
        first.setdefault(scenes[name].object_id, scenes[name])
    return list(first.values())


def _scene_tile(scene: Scene, object_models: Mapping[str, ObjectModel]) -> Tile:
    return Tile(render_scene(object_models[scene.object_id], scene, _TILE_PX), f"{scene.scene_id} {scene.object_id}")


def _grasp_tile(scene: Scene, object_models: Mapping[str, ObjectModel], rows: Sequence[Row]) -> Tile:
    """The object in close-up with grippers at the lifted grasps, spread over the pool."""
    lifted = [row for row in sorted(rows, key=lambda row: row["grasp_id"]) if row["lift_status"] == "lifted"]
    drawn = lifted[:: max(1, len(lifted) // _N_GRASPS_DRAWN)][:_N_GRASPS_DRAWN]
    x, y, z = scene.T_base_object[:3, 3]
    view = View((x - 0.30, y + 0.38, z + 0.33), (x, y, z + 0.02), 40.0, 2 * _TILE_PX[0], 2 * _TILE_PX[1])
    picture = _picture_of_grasps(scene, object_models[scene.object_id], drawn, view, show_targets=False)
    return Tile(picture, f"{scene.object_id}: {len(drawn)} of {len(lifted)} lifted grasps")


def _title_tile(scenes: Mapping[str, Scene], object_models: Mapping[str, ObjectModel], grasps: Mapping[str, list[Row]]) -> Tile:
    """One scene with obstacles, its targets as ghosts and some grasps: what a ranker is asked about, in one picture."""
    scene = next((scenes[name] for name in sorted(scenes) if len(scenes[name].obstacles) == 2), scenes[min(scenes)])
    lifted = [row for row in sorted(grasps[scene.scene_id], key=lambda row: row["grasp_id"]) if row["lift_status"] == "lifted"]
    view = View((1.25, 0.62, 0.62), (0.44, 0.0, 0.04), 36.0, 2 * _TITLE_PX[0], 2 * _TITLE_PX[1])
    drawn = lifted[:: max(1, len(lifted) // 4)][:4]
    picture = _picture_of_grasps(scene, object_models[scene.object_id], drawn, view, show_targets=True)
    return Tile(picture, f"{scene.scene_id} {scene.object_id}: object blue, obstacles brown, targets green, {len(drawn)} of its grasps")


def _picture_of_grasps(
    scene: Scene, object_model: ObjectModel, rows: Sequence[Row], view: View, *, show_targets: bool
) -> UInt8[np.ndarray, "h w 3"]:
    widths_m = {grasp.grasp_id: grasp.jaw_width_m for grasp in object_model.grasps}
    with Renderer() as renderer:
        add_table(renderer)
        renderer.add_mesh(object_model.mesh, scene.T_base_object, OBJECT_RGB)
        for obstacle in scene.obstacles:
            renderer.add_box(obstacle.size_m, obstacle.T_base_obstacle, OBSTACLE_RGB)
        for k, row in enumerate(rows):
            glyph = _gripper_glyph(min(widths_m[row["grasp_id"]] + 0.004, 0.08))
            renderer.add_mesh(glyph, pose_in(row, "grasp"), _GRASP_RGBS[k % len(_GRASP_RGBS)])
        picture = renderer.photograph(view).rgb.astype(np.float64)
        for target in scene.targets if show_targets else ():
            renderer.add_mesh(object_model.mesh, target.T_base_target, GHOST_RGB)
        picture += _GHOST_OPACITY * (renderer.photograph(view).rgb - picture)
    return shrunk(picture)


def _gripper_glyph(jaw_m: float, thickness: float = 0.25) -> TriangleMesh:
    """A slender gripper: finger boxes and a bar for the hand, thinner than the real ones so that several can be told apart.

    Args:
        jaw_m: distance between the fingers, in metres.
        thickness: as a share of that of the real gripper.
    """
    T_tcp_box, size_m = gripper_boxes(jaw_m)
    parts = []
    for k, (T, size) in enumerate(zip(T_tcp_box, size_m, strict=True)):
        extents = size * ((thickness, jaw_m / size[1] + 0.2, 0.24 * thickness) if k == 0 else (thickness, thickness, 1.0))
        placed = T.copy()
        if k == 0:
            placed[2, 3] += size[2] / 2 - extents[2] / 2
        parts.append(trimesh.creation.box(extents=extents, transform=placed))
    glyph = trimesh.util.concatenate(parts)
    assert isinstance(glyph, trimesh.Trimesh)
    return TriangleMesh(np.asarray(glyph.vertices), np.asarray(glyph.faces, dtype=np.int64))


def _films(tables: Mapping[str, pa.Table], release: Decoded, recipe: Recipe, n_films: int) -> dict[str, list[Tile]]:
    chosen = chosen_executions(frame_of(tables["candidates"], ["candidate_id", "exec_status"]), recipe.seed, n_films)
    return {status: [tile for name in names for tile in _film(release, name, recipe)] for status, names in chosen.items()}


def chosen_executions(candidates: pl.DataFrame, seed: int, n_films: int) -> dict[str, list[str]]:
    """Candidates that the gallery shows, by the execution status that they ended as, the first by the hash of their ids."""
    by_status = {s.value: candidates.filter(pl.col("exec_status") == s.value)["candidate_id"].to_list() for s in ExecStatus}
    key = partial(order_key, seed, "gallery")
    return {status: sorted(names, key=key)[:n_films] for status, names in by_status.items() if names}


def _film(release: Decoded, candidate_id: str, recipe: Recipe) -> list[Tile]:
    """`FRAMES_OF_FILM` frames of a stored plan that is executed again; raises ReportError for an executed candidate without a plan."""
    frames = execution_frames(recording_of(release, candidate_id, recipe), FRAMES_OF_FILM, FRAME_PX)
    tiles = [Tile(frame.picture, f"{frame.phase.value} {frame.time_s:.2f} s") for frame in frames]
    return [Tile(tiles[0].picture, f"{candidate_id} {tiles[0].caption}"), *tiles[1:]]
