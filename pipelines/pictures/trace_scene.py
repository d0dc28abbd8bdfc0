"""What stands in a trace, as Foxglove messages: frames, bodies and the typed point cloud of one candidate; files are written in trace.py.

Every body is an entity that is locked to a frame of its own, so a trace needs no robot description beside it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import pinocchio as pin
import trimesh
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.TriangleListPrimitive_pb2 import TriangleListPrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from jaxtyping import Float

from objects.gripper import gripper_boxes, open_jaw_m
from objects.object_model import TriangleMesh
from pipelines.codecs import Row
from pipelines.engines.robot.arm import fk
from pipelines.engines.robot.geometry import LAST_LINK, N_LINKS, Shape, panda
from pipelines.pictures.filmstrip import PLACE_HAND_RGB
from pipelines.pictures.recording import Moment, Recording
from pipelines.pictures.renderer import Rgb
from pipelines.pictures.views import GHOST_RGB, OBJECT_RGB, OBSTACLE_RGB, TABLE_RGB
from pipelines.values import TABLE_X_M, TABLE_Y_M
from tables.poses import pose_of
from tables.vocabulary import PointType

BASE = "base"
JOINTS = (*(f"panda_joint{k}" for k in range(1, 8)), "panda_finger_joint1", "panda_finger_joint2")
POINT_TYPES = tuple(PointType)  # the number in field `point_type` of the cloud is the place in this list

_ROBOT_RGB: Rgb = (0.85, 0.85, 0.87)
_TABLE_THICKNESS_M = 0.04
_POINT_RGB = {PointType.ENVIRONMENT: TABLE_RGB, PointType.OBJECT: OBJECT_RGB, PointType.OBSTACLE: OBSTACLE_RGB}
_POINT = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("point_type", "u1"), ("red", "u1"), ("green", "u1"), ("blue", "u1"), ("alpha", "u1")]
)


def frames_at(recording: Recording, moment: Moment) -> dict[str, Float[np.ndarray, "4 4"]]:
    """T_base_frame of every link, the TCP, object, obstacles, target and the place pose of the hand, by name of the frame."""
    scene = recording.candidate.scene
    return {
        **_links(moment),
        "tcp": fk(moment.q_rad),
        "object": moment.T_base_object,
        "target": recording.candidate.target.T_base_target,
        "place_hand": recording.T_base_place,
        **{f"obstacle_{obstacle.obstacle_id}": obstacle.T_base_obstacle for obstacle in scene.obstacles},
    }


def _links(moment: Moment) -> dict[str, Float[np.ndarray, "4 4"]]:
    model = panda().model
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.concatenate([moment.q_rad, moment.fingers_m]))
    return {
        frame.name: data.oMf[number].homogeneous
        for number, frame in enumerate(model.frames)
        if frame.type == pin.FrameType.BODY and frame.name.startswith("panda_")
    }


def bodies(recording: Recording) -> SceneUpdate:
    """Table, obstacles, object, the target as a ghost, and the robot as the convex hulls that planning checks.

    A candidate without a plan has the open hand at the place too.
    """
    mesh = recording.object_model.mesh
    entities = [
        _entity("table", BASE, cubes=[_cube(_table_pose(), _table_size_m(), TABLE_RGB)]),
        _entity("object", "object", triangles=[_triangles(mesh, OBJECT_RGB)]),
        _entity("target", "target", triangles=[_triangles(mesh, GHOST_RGB, 0.4)]),
        *(
            _entity(
                f"obstacle_{obstacle.obstacle_id}",
                f"obstacle_{obstacle.obstacle_id}",
                cubes=[_cube(np.eye(4), obstacle.size_m, OBSTACLE_RGB)],
            )
            for obstacle in recording.candidate.scene.obstacles
        ),
        *(_entity(shape.name, frame, triangles=[_triangles(_hull(shape), _ROBOT_RGB)]) for shape, frame in _robot_shapes()),
    ]
    if not recording.is_executed:
        boxes = zip(*gripper_boxes(_open_jaw_m(recording)), strict=True)
        entities.append(_entity("place_hand", "place_hand", cubes=[_cube(T, size_m, PLACE_HAND_RGB, 0.5) for T, size_m in boxes]))
    return SceneUpdate(entities=entities)


def cloud(point_rows: Sequence[Row]) -> PointCloud:
    """The typed cloud of the initial scene, a colour for each type.

    Args:
        point_rows: rows of `scene_points` of one scene.
    """
    points = np.zeros(len(point_rows), _POINT)
    for axis in "xyz":
        points[axis] = [row[f"{axis}_m"] for row in point_rows]
    kinds = [POINT_TYPES.index(PointType(row["point_type"])) for row in point_rows]
    points["point_type"] = kinds
    colours = np.round(255 * np.array([_POINT_RGB[kind] for kind in POINT_TYPES])).astype(np.uint8)[kinds]
    points["red"], points["green"], points["blue"], points["alpha"] = *colours.T, 255
    types = {np.dtype("<f4"): PackedElementField.FLOAT32, np.dtype("u1"): PackedElementField.UINT8}
    fields: Mapping[str, tuple[np.dtype, int]] = _POINT.fields  # type: ignore[assignment]
    return PointCloud(
        frame_id=BASE,
        pose=pose_message(np.eye(4)),
        point_stride=_POINT.itemsize,
        fields=[PackedElementField(name=name, offset=offset, type=types[dtype]) for name, (dtype, offset) in fields.items()],
        data=points.tobytes(),
    )


def pose_message(T: Float[np.ndarray, "4 4"]) -> Pose:
    """A pose as Foxglove has it."""
    x, y, z, qx, qy, qz, qw = pose_of(T).tolist()
    return Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))


def _entity(name: str, frame: str, **primitives: list[CubePrimitive] | list[TriangleListPrimitive]) -> SceneEntity:
    return SceneEntity(id=name, frame_id=frame, frame_locked=True, **primitives)


def _cube(T: Float[np.ndarray, "4 4"], size_m: Float[np.ndarray, "3"], rgb: Rgb, opacity: float = 1.0) -> CubePrimitive:
    x, y, z = (float(edge) for edge in size_m)
    return CubePrimitive(pose=pose_message(T), size=Vector3(x=x, y=y, z=z), color=_colour(rgb, opacity))


def _triangles(mesh: TriangleMesh, rgb: Rgb, opacity: float = 1.0) -> TriangleListPrimitive:
    points = [Point3(x=x, y=y, z=z) for x, y, z in mesh.vertices_m.tolist()]
    return TriangleListPrimitive(
        pose=pose_message(np.eye(4)), points=points, color=_colour(rgb, opacity), indices=mesh.faces.ravel().tolist()
    )


def _colour(rgb: Rgb, opacity: float) -> Color:
    return Color(r=rgb[0], g=rgb[1], b=rgb[2], a=opacity)


def _table_pose() -> Float[np.ndarray, "4 4"]:
    T = np.eye(4)
    T[:3, 3] = sum(TABLE_X_M) / 2, sum(TABLE_Y_M) / 2, -_TABLE_THICKNESS_M / 2
    return T


def _table_size_m() -> Float[np.ndarray, "3"]:
    return np.array([TABLE_X_M[1] - TABLE_X_M[0], TABLE_Y_M[1] - TABLE_Y_M[0], _TABLE_THICKNESS_M])


def _robot_shapes() -> Iterator[tuple[Shape, str]]:
    robot = panda()
    yield from ((link, f"panda_link{k}") for k, link in zip(range(N_LINKS), robot.links, strict=True))
    yield robot.hand, f"panda_link{LAST_LINK}"
    for finger in robot.fingers:
        yield finger, f"panda_{'left' if finger.name.startswith('left') else 'right'}finger"


def _hull(shape: Shape) -> TriangleMesh:
    hull = trimesh.PointCloud(shape.vertices_m).convex_hull  # type: ignore[no-untyped-call]
    return TriangleMesh(np.asarray(hull.vertices), np.asarray(hull.faces, dtype=np.int64))


def _open_jaw_m(recording: Recording) -> float:
    return open_jaw_m(recording.object_model.grasp(recording.candidate.grasp.grasp_id).jaw_width_m)
