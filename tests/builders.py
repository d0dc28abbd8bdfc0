"""Small scenes and objects for tests, built by hand; pipelines/scenes/sampling.py and objects/build.py make the real ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import trimesh
from jaxtyping import Float

from objects.object_model import ObjectModel, PoolGrasp, StablePose, TriangleMesh
from pipelines.engines.robot.arm import fk, follow_line
from pipelines.grasps.admission import AdmissionParams
from pipelines.stage import Law, Stage, Unit, UnitResult
from pipelines.values import AdmittedGrasp, LiftedGrasp, Obstacle, Scene, Target
from tables.poses import inverse
from tables.schemas import SPLITS
from tables.vocabulary import Symmetry

OBSTACLE_SIZE_M = (0.10, 0.08, 0.12)


def pose(x: float, y: float, z: float, yaw_rad: float = 0.0) -> Float[np.ndarray, "4 4"]:
    """An upright pose."""
    T = np.eye(4)
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    T[:3, :3] = [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]
    T[:3, 3] = (x, y, z)
    return T


def tcp_pose(point: Sequence[float], approach: Sequence[float], jaw: Sequence[float]) -> Float[np.ndarray, "4 4"]:
    """TCP pose at a point, z along the approach, y along the jaw."""
    z = np.asarray(approach, dtype=np.float64) / np.linalg.norm(approach)
    y = np.asarray(jaw, dtype=np.float64) / np.linalg.norm(jaw)
    T = np.eye(4)
    T[:3, :3] = np.column_stack([np.cross(y, z), y, z])
    T[:3, 3] = point
    return T


def box_model(size_m: Sequence[float] = (0.05, 0.06, 0.12), object_id: str = "cuboid_test") -> ObjectModel:
    """A cuboid grasped from above and from four sides, each at three offsets."""
    sz = size_m[2]
    grasps = []
    for offset in (0.0, -0.01, 0.01):
        grasps += [
            tcp_pose((offset, 0, sz / 2 - 0.02), (0, 0, -1), (0, 1, 0)),
            tcp_pose((0, offset, sz / 2 - 0.02), (0, 0, -1), (1, 0, 0)),
            *(tcp_pose((0, 0, 2 * offset), (side, 0, 0), (0, 1, 0)) for side in (1, -1)),
            *(tcp_pose((0, 0, 2 * offset), (0, side, 0), (1, 0, 0)) for side in (1, -1)),
        ]
    widths = [float(np.abs(T[:3, 1]) @ np.array(size_m)) for T in grasps]
    return _model(object_id, "cuboid", Symmetry.BOX, trimesh.creation.box(extents=size_m), sz / 2, grasps, widths)


def can_model(radius_m: float = 0.033, height_m: float = 0.12, object_id: str = "can_test") -> ObjectModel:
    """A can grasped from twelve sides at three heights, and from above."""
    grasps = []
    for height in (0.02, -0.02, 0.04):
        for angle in np.arange(12) * np.pi / 6:
            approach = np.array([-np.cos(angle), -np.sin(angle), 0.0])
            grasps.append(tcp_pose((0, 0, height), approach, np.cross([0.0, 0.0, 1.0], approach)))
    grasps += [tcp_pose((0, 0, height_m / 2 - 0.02), (0, 0, -1), (np.cos(a), np.sin(a), 0)) for a in np.arange(4) * np.pi / 4]
    mesh = trimesh.creation.cylinder(radius=radius_m, height=height_m, sections=48)
    return _model(object_id, "can", Symmetry.REVOLUTION_Z, mesh, height_m / 2, grasps, [2 * radius_m] * len(grasps))


def panda_scene(
    object_model: ObjectModel, obstacles_xy: Sequence[tuple[float, float]] = (), targets: Sequence[Float[np.ndarray, "4 4"]] | None = None
) -> Scene:
    """The object upright in front of the robot, boxes around it, and eight upright targets unless others are given."""
    z = float(object_model.stable_poses[0].T_plane_object[2, 3])
    if targets is None:
        spots = [(0.35, 0.3), (0.45, 0.3), (0.55, 0.3), (0.65, 0.1), (0.65, -0.1), (0.35, -0.3), (0.45, -0.3), (0.55, -0.3)]
        targets = [pose(x, y, z, 0.7 * k) for k, (x, y) in enumerate(spots)]
    return Scene(
        scene_id="full-0000",
        object_id=object_model.object_id,
        stable_pose_id=0,
        T_base_object=pose(0.5, 0.0, z, 0.2),
        obstacles=tuple(
            Obstacle(k, pose(x, y, OBSTACLE_SIZE_M[2] / 2, 0.4), np.array(OBSTACLE_SIZE_M)) for k, (x, y) in enumerate(obstacles_xy)
        ),
        targets=tuple(Target(k, 0, T) for k, T in enumerate(targets)),
    )


def ideally_lifted(object_model: ObjectModel, admitted: AdmittedGrasp) -> LiftedGrasp:
    """The state after a lift in which nothing slipped."""
    pool, params = object_model.grasp(admitted.grasp_id), AdmissionParams()
    T_end = admitted.T_base_grasp.copy()
    T_end[2, 3] += params.lift_m
    line = follow_line(admitted.T_base_grasp, T_end, admitted.grasp_q_rad, params.line_step_m, params.max_joint_jump_rad)
    assert line is not None
    T_tcp_object = inverse(pool.T_object_grasp)
    fingers_m = np.full(2, pool.jaw_width_m / 2)
    return LiftedGrasp(admitted.grasp_id, line[-1], fingers_m, fk(line[-1]) @ T_tcp_object, T_tcp_object)


def made_up_stage(
    run: Callable[[Unit], UnitResult], code_version: str = "1", law: Law = lambda tables, promise: [], engines: tuple[str, ...] = ()
) -> Stage:
    """A stage that stands at the start of a chain and makes rows of `splits`."""
    return Stage("draw", "made up", "Makes up rows.", code_version, (), (), (SPLITS,), (), engines, run, law)


def _model(
    object_id: str,
    category: str,
    symmetry: Symmetry,
    mesh: trimesh.Trimesh,
    rest_z_m: float,
    grasps: Sequence[Float[np.ndarray, "4 4"]],
    widths_m: Sequence[float],
) -> ObjectModel:
    body = TriangleMesh(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    mass = 0.3
    return ObjectModel(
        object_id=object_id,
        category=category,
        symmetry=symmetry,
        mass_kg=mass,
        friction=0.8,
        com_m=np.zeros(3),
        inertia_kg_m2=np.asarray(mesh.moment_inertia) * mass / mesh.volume,
        mesh=body,
        parts=(body,),
        stable_poses=(StablePose(0, "upright", 1.0, pose(0.0, 0.0, rest_z_m)),),
        grasps=tuple(PoolGrasp(k, "test", T, width) for k, (T, width) in enumerate(zip(grasps, widths_m, strict=True))),
    )
