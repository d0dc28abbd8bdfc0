"""A picture of one object: its convex parts, its whole grasp pool, and one grasp of each kind with the boxes of the gripper."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

from objects.gripper import MAX_JAW_M, gripper_boxes, open_jaw_m
from objects.object_model import ObjectModel, PoolGrasp, TriangleMesh

_COLOURS = [colormaps["tab10"](k)[:3] for k in range(10)]
_LIGHT = np.array([0.3, -0.5, 0.81])
_ELEVATION_DEG, _AZIMUTH_DEG = 25.0, -60.0
_TO_VIEWER = np.array(
    [
        np.cos(np.radians(_ELEVATION_DEG)) * np.cos(np.radians(_AZIMUTH_DEG)),
        np.cos(np.radians(_ELEVATION_DEG)) * np.sin(np.radians(_AZIMUTH_DEG)),
        np.sin(np.radians(_ELEVATION_DEG)),
    ]
)


def draw_object(object_model: ObjectModel, path: Path) -> None:
    """Write the picture as PNG; the folder must exist."""
    kinds = sorted({grasp.grasp_kind for grasp in object_model.grasps})
    colour_of = {kind: _COLOURS[k % len(_COLOURS)] for k, kind in enumerate(kinds)}
    n_columns = 2 + len(kinds)
    figure = Figure(figsize=(4.2 * n_columns, 4.6))
    parts = _panel(figure, n_columns, 1, f"{object_model.object_id}: {len(object_model.parts)} convex parts", _radius(object_model, 0.6))
    for k, part in enumerate(object_model.parts):
        _add_mesh(parts, part, _COLOURS[k % len(_COLOURS)], alpha=1.0)
    pool = _panel(figure, n_columns, 2, f"{len(object_model.grasps)} grasps", _radius(object_model, 1.0))
    _add_mesh(pool, object_model.mesh, (0.75, 0.75, 0.75), alpha=0.9)
    for grasp in object_model.grasps:
        pool.add_collection3d(Line3DCollection(_fork(grasp), colors=[colour_of[grasp.grasp_kind]], linewidths=0.8))
    for k, kind in enumerate(kinds):
        own = [grasp for grasp in object_model.grasps if grasp.grasp_kind == kind]
        panel = _panel(figure, n_columns, 3 + k, f"{kind}: {len(own)}, grasp {own[0].grasp_id} shown", _radius(object_model, 1.0))
        _add_mesh(panel, object_model.mesh, (0.75, 0.75, 0.75), alpha=0.9)
        _add_gripper(panel, own[0], colour_of[kind])
    figure.tight_layout()
    figure.savefig(path, dpi=80)


def _radius(object_model: ObjectModel, share: float) -> float:
    """Half the edge of a panel: the object, and room for a hand where grasps are shown."""
    return max(0.09 * share, 0.55 * float(np.ptp(object_model.mesh.vertices_m, axis=0).max()) + 0.06 * (share - 0.5))


def _panel(figure: Figure, n_columns: int, position: int, title: str, radius_m: float) -> Any:
    axes: Any = figure.add_subplot(1, n_columns, position, projection="3d")
    axes.set(xlim=(-radius_m, radius_m), ylim=(-radius_m, radius_m), zlim=(-radius_m, radius_m), xlabel="x", ylabel="y", zlabel="z")
    axes.set_box_aspect((1, 1, 1))
    axes.set_proj_type("ortho")
    axes.view_init(elev=_ELEVATION_DEG, azim=_AZIMUTH_DEG)
    axes.tick_params(labelsize=6)
    axes.set_title(title, fontsize=10)
    return axes


def _add_mesh(axes: Any, mesh: TriangleMesh, colour: tuple[float, ...], alpha: float) -> None:
    triangles = mesh.vertices_m[mesh.faces]
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    # Painted back to front by their middles, large faces cover each other wrongly: leave out those that face away.
    facing = normal @ _TO_VIEWER > 0.0
    triangles, normal = triangles[facing], normal[facing]
    shade = 0.65 + 0.35 * (normal @ _LIGHT)
    faces = np.column_stack([np.outer(shade, colour[:3]), np.full(len(shade), alpha)])
    axes.add_collection3d(Poly3DCollection(triangles, facecolors=np.clip(faces, 0.0, 1.0)))


def _fork(grasp: PoolGrasp) -> Float[np.ndarray, "4 2 3"]:
    """Fingers, palm and wrist as lines at the grasped width."""
    y = grasp.jaw_width_m / 2
    tip, root, wrist = 0.0095, -0.045, -0.07
    local = np.array([
        [[0, y, tip], [0, y, root]],
        [[0, -y, tip], [0, -y, root]],
        [[0, -y, root], [0, y, root]],
        [[0, 0, root], [0, 0, wrist]],
    ])  # fmt: skip
    return np.asarray(local @ grasp.T_object_grasp[:3, :3].T + grasp.T_object_grasp[:3, 3])


def _add_gripper(axes: Any, grasp: PoolGrasp, colour: tuple[float, ...]) -> None:
    """Edges of the boxes of the gripper: hand, fingers at the grasped width, and thin the fingers at the opening they approach with."""
    for jaw_m, alpha in ((min(grasp.jaw_width_m, MAX_JAW_M), 1.0), (open_jaw_m(grasp.jaw_width_m), 0.3)):
        for T, size in zip(*gripper_boxes(jaw_m), strict=True):
            corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * size
            placed = corners @ (grasp.T_object_grasp @ T)[:3, :3].T + (grasp.T_object_grasp @ T)[:3, 3]
            edges = [(a, b) for a in range(8) for b in range(a) if (a ^ b) in (1, 2, 4)]
            axes.add_collection3d(Line3DCollection([placed[[a, b]] for a, b in edges], colors=[colour], linewidths=1.0, alpha=alpha))
