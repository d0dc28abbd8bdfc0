"""Looks at poses with PyBullet's CPU renderer: colour, depth and what each pixel shows; nothing here moves or collides."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from jaxtyping import Float, Int, UInt8

from objects.object_model import TriangleMesh
from pipelines.engines.bullet import pybullet
from pipelines.engines.robot.description import panda_urdf
from tables.poses import pose_of

Rgb = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class View:
    """A pinhole camera: where it stands, what it looks at, its vertical field of view and its pixels."""

    eye_m: tuple[float, float, float]
    look_at_m: tuple[float, float, float]
    fov_deg: float
    width_px: int
    height_px: int
    near_m: float = 0.1
    far_m: float = 4.0


@dataclass(frozen=True, slots=True)
class Photograph:
    """What a view shows. `body` is the number that `add_*` returned, -1 for nothing."""

    rgb: UInt8[np.ndarray, "h w 3"]
    depth: Float[np.ndarray, "h w"]
    body: Int[np.ndarray, "h w"]
    points_m: Float[np.ndarray, "h w 3"]


class Renderer:
    """Context manager around a client of its own that holds visual shapes only."""

    def __enter__(self) -> Self:
        self._folder = tempfile.TemporaryDirectory(prefix="placebench-renderer-")
        self._client = pybullet.connect(pybullet.DIRECT)
        self._n_meshes = 0
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        pybullet.disconnect(physicsClientId=self._client)
        self._folder.cleanup()

    def add_box(self, size_m: Float[np.ndarray, "3"], T_base_box: Float[np.ndarray, "4 4"], colour: Rgb) -> int:
        """A box; returns its number."""
        half = (np.asarray(size_m) / 2).tolist()
        shape = pybullet.createVisualShape(pybullet.GEOM_BOX, halfExtents=half, rgbaColor=[*colour, 1.0], physicsClientId=self._client)
        return self._add(shape, T_base_box)

    def add_mesh(self, mesh: TriangleMesh, T_base_mesh: Float[np.ndarray, "4 4"], colour: Rgb) -> int:
        """A triangle mesh; returns its number."""
        path = Path(self._folder.name) / f"mesh_{self._n_meshes}.obj"
        self._n_meshes += 1
        path.write_text(_flat_shaded_obj(mesh))
        shape = pybullet.createVisualShape(
            pybullet.GEOM_MESH, fileName=str(path), rgbaColor=[*colour, 1.0], specularColor=[0.1] * 3, physicsClientId=self._client
        )
        return self._add(shape, T_base_mesh)

    def add_robot(self) -> int:
        """The Panda with pybullet_data's meshes; returns its number."""
        return int(pybullet.loadURDF(str(panda_urdf()), useFixedBase=True, physicsClientId=self._client))

    def pose_robot(self, robot: int, q: Float[np.ndarray, "7"], fingers_m: Float[np.ndarray, "2"]) -> None:
        """Put the robot at a configuration."""
        for joint, value in zip((*range(7), 9, 10), (*q, *fingers_m), strict=True):
            pybullet.resetJointState(robot, joint, float(value), physicsClientId=self._client)

    def move(self, body: int, T_base_body: Float[np.ndarray, "4 4"]) -> None:
        """Put a body at a pose."""
        pose = pose_of(T_base_body)
        pybullet.resetBasePositionAndOrientation(body, pose[:3].tolist(), pose[3:].tolist(), physicsClientId=self._client)

    def photograph(self, view: View) -> Photograph:
        """Render one view."""
        c, (w, h) = self._client, (view.width_px, view.height_px)
        looking = pybullet.computeViewMatrix(view.eye_m, view.look_at_m, [0, 0, 1], physicsClientId=c)
        lens = pybullet.computeProjectionMatrixFOV(view.fov_deg, w / h, view.near_m, view.far_m, physicsClientId=c)
        _, _, rgba, depth, body = pybullet.getCameraImage(
            w,
            h,
            looking,
            lens,
            shadow=0,  # its shadow map covers half a table and darkens that
            lightDirection=[0.4, -0.5, 1.0],
            lightAmbientCoeff=0.55,
            lightDiffuseCoeff=0.5,
            renderer=pybullet.ER_TINY_RENDERER,
            physicsClientId=c,
        )
        depth_image = np.reshape(depth, (h, w)).astype(np.float64)
        points_m = _back_projected(depth_image, np.reshape(lens, (4, 4)).T @ np.reshape(looking, (4, 4)).T)
        rgb = np.reshape(np.asarray(rgba, dtype=np.uint8), (h, w, 4))[:, :, :3].copy()
        return Photograph(rgb, depth_image, np.reshape(body, (h, w)).astype(np.int64), points_m)

    def _add(self, shape: int, T_base_body: Float[np.ndarray, "4 4"]) -> int:
        body = int(pybullet.createMultiBody(0.0, -1, shape, physicsClientId=self._client))
        self.move(body, T_base_body)
        return body


def _back_projected(depth: Float[np.ndarray, "h w"], clip_from_base: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "h w 3"]:
    """Base-frame point of every pixel (OpenGL conventions: clip coordinates in [-1, 1], first row at the top).

    TinyRenderer samples a pixel at its lower left corner: taken for the centre, points are up to 3 mm off, taken so, 1 um.
    """
    h, w = depth.shape
    x, y = np.meshgrid(np.arange(w) / w * 2 - 1, 1 - (np.arange(h) + 1) / h * 2)
    clip = np.stack([x, y, 2 * depth - 1, np.ones_like(depth)], axis=-1)
    base = clip @ np.linalg.inv(clip_from_base).T
    points_m: Float[np.ndarray, "h w 3"] = base[..., :3] / base[..., 3:]
    return points_m


def _flat_shaded_obj(mesh: TriangleMesh) -> str:
    """OBJ text with one normal a face: shared normals would smear a can's rim over its lid."""
    corners = mesh.vertices_m[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    lines = [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in mesh.vertices_m]
    lines += [f"vn {x:.6f} {y:.6f} {z:.6f}" for x, y, z in normals]
    lines += [f"f {a}//{k} {b}//{k} {c}//{k}" for k, (a, b, c) in enumerate(mesh.faces + 1, 1)]
    return "\n".join(lines) + "\n"
