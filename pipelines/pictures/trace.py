"""One candidate as an MCAP file with Foxglove's well-known schemas, for any viewer that reads them; what stands in it is trace_scene.py's.

Topics: `/tf` (FrameTransforms: links, TCP, object, obstacles, target, place pose of the hand, all below `base`), `/joint_states`
(JointStates), `/scene` (SceneUpdate), `/points` (PointCloud of the initial scene), `/log` (Log: every phase as it begins, and the verdict)
and, without a well-known schema, `/contacts` (JSON). Times are simulated, from zero. Metadata record `placebench`: ids and hashes.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from importlib import metadata as packages
from typing import Any

from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointState_pb2 import JointState
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import register_schema

from pipelines.codecs import Row
from pipelines.pictures.recording import Moment, Recording
from pipelines.pictures.trace_scene import BASE, JOINTS, POINT_TYPES, bodies, cloud, frames_at, pose_message
from tables.vocabulary import ExecStatus

METADATA = "placebench"
_CONTACTS = {
    "type": "object",
    "properties": {
        "robot_object_n": {"type": "number", "description": "net force of the hand on the object, N"},
        "object_fixed_n": {"type": "number", "description": "net forces of table and obstacles on the object, summed, N"},
    },
}


def trace(recording: Recording, point_rows: Sequence[Row], identity: Mapping[str, str]) -> bytes:
    """The bytes of the file: zstd chunks, indexed; equal recordings give equal bytes.

    Args:
        point_rows: rows of `scene_points` of the scene; none leaves the topic out.
        identity: written to the metadata record beside candidate, object and statuses: hashes of recipe and release.
    """
    out = io.BytesIO()
    writer = _Writer(out)
    writer.metadata({**_about(recording), **identity})
    first, last = recording.moments[0], recording.moments[-1]
    writer.send("/scene", bodies(recording), 0.0)
    if point_rows:
        writer.send("/points", cloud(point_rows), 0.0)
    phase = None
    for moment in recording.moments:
        if recording.is_executed and moment.phase is not phase:
            phase = moment.phase
            writer.log(Log.INFO, phase.value, moment.time_s)
        writer.send("/tf", _transforms(recording, moment), moment.time_s)
        writer.send("/joint_states", _joints(moment), moment.time_s)
        writer.contacts(moment)
    is_success = recording.labels.get("exec_status") == ExecStatus.SUCCESS.value
    writer.log(Log.INFO if is_success else Log.WARNING, recording.verdict, last.time_s if recording.is_executed else first.time_s)
    writer.finish()
    return out.getvalue()


def _about(recording: Recording) -> dict[str, str]:
    labels = recording.labels
    statuses = {name: str(labels[name]) for name in ("plan_status", "exec_status") if labels.get(name) is not None}
    return {
        "candidate_id": recording.candidate.candidate_id,
        "scene_id": recording.candidate.scene.scene_id,
        "object_id": recording.object_model.object_id,
        "point_types": ", ".join(f"{k} {kind.value}" for k, kind in enumerate(POINT_TYPES)),
        **statuses,
    }


def _transforms(recording: Recording, moment: Moment) -> FrameTransforms:
    stamp, messages = _stamp(moment.time_s), []
    for name, T in frames_at(recording, moment).items():
        pose = pose_message(T)
        messages.append(
            FrameTransform(timestamp=stamp, parent_frame_id=BASE, child_frame_id=name, translation=pose.position, rotation=pose.orientation)
        )
    return FrameTransforms(transforms=messages)


def _joints(moment: Moment) -> JointStates:
    positions = [*moment.q_rad.tolist(), *moment.fingers_m.tolist()]
    joints = [JointState(name=name, position=position) for name, position in zip(JOINTS, positions, strict=True)]
    return JointStates(timestamp=_stamp(moment.time_s), joints=joints)


def _ns(time_s: float) -> int:
    return round(time_s * 1e9)


def _stamp(time_s: float) -> Timestamp:
    return Timestamp(seconds=_ns(time_s) // 10**9, nanos=_ns(time_s) % 10**9)


class _Writer:
    """Messages onto topics; schemas and channels are written when they are first needed."""

    def __init__(self, out: io.BytesIO) -> None:
        self._writer = Writer(out, compression=CompressionType.ZSTD)
        self._channels: dict[str, int] = {}
        # No clock and no version but that of the schemas: the bytes depend on the execution.
        self._writer.start(profile="", library=f"placebench, foxglove-schemas-protobuf {packages.version('foxglove-schemas-protobuf')}")

    def metadata(self, values: Mapping[str, str]) -> None:
        self._writer.add_metadata(METADATA, dict(sorted(values.items())))

    def send(self, topic: str, message: Any, time_s: float) -> None:
        if "timestamp" in message.DESCRIPTOR.fields_by_name:
            message.timestamp.CopyFrom(_stamp(time_s))
        if topic not in self._channels:
            self._channels[topic] = self._writer.register_channel(topic, "protobuf", register_schema(self._writer, type(message)))
        self._add(topic, message.SerializeToString(deterministic=True), time_s)

    def log(self, level: Log.Level.ValueType, text: str, time_s: float) -> None:
        self.send("/log", Log(level=level, message=text, name="placebench"), time_s)

    def contacts(self, moment: Moment) -> None:
        topic = "/contacts"
        if topic not in self._channels:
            schema = self._writer.register_schema("placebench.Contacts", "jsonschema", json.dumps(_CONTACTS, sort_keys=True).encode())
            self._channels[topic] = self._writer.register_channel(topic, "json", schema)
        values = {"robot_object_n": moment.robot_object_n, "object_fixed_n": moment.object_fixed_n}
        self._add(topic, json.dumps(values, sort_keys=True).encode(), moment.time_s)

    def finish(self) -> None:
        self._writer.finish()

    def _add(self, topic: str, data: bytes, time_s: float) -> None:
        self._writer.add_message(self._channels[topic], log_time=_ns(time_s), data=data, publish_time=_ns(time_s))
