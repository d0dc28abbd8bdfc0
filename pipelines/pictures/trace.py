"""An execution as an MCAP file (joint states, object pose, contacts, phase) and back; see labels/execution.py for how it is run."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from jaxtyping import Float, Int
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from pipelines.engines.physics.hand_world import HandWorld
from pipelines.engines.physics.phases import Phase
from tables.errors import PlaceBenchError
from tables.poses import matrix_of, pose_of

_NUMBERS = {"type": "array", "items": {"type": "number"}}
_SCHEMAS: dict[str, dict[str, Any]] = {
    "joint_states": {"q_rad": _NUMBERS, "fingers_m": _NUMBERS},
    "object_pose": {"position_m": _NUMBERS, "quaternion_xyzw": _NUMBERS},
    "contacts": {"robot_object_n": {"type": "number"}, "object_fixed_n": {"type": "number"}},
    "phase": {"phase": {"type": "string", "enum": [phase.value for phase in Phase]}},
}
_METADATA = "execution"


class TraceError(PlaceBenchError, ValueError):
    """A file that is not a trace of ours."""


@dataclass(frozen=True, slots=True)
class Trace:
    """An execution, sample by sample; arm and fingers are NaN after the hand was taken out of the world.

    Contact forces are net forces of each pair in newton: of the hand on the object, and of table and obstacles on the object.
    """

    metadata: dict[str, str]
    step: Int[np.ndarray, "n"]
    time_s: Float[np.ndarray, "n"]
    phase: tuple[Phase, ...]
    q_rad: Float[np.ndarray, "n 7"]
    fingers_m: Float[np.ndarray, "n 2"]
    T_base_object: Float[np.ndarray, "n 4 4"]
    robot_object_n: Float[np.ndarray, "n"]
    object_fixed_n: Float[np.ndarray, "n"]


class TraceRecorder:
    """Context manager that writes what a world does; `record` is a watch of a rollout. Equal executions give equal bytes.

    Args:
        path: the file to write.
        world: the world that runs.
        metadata: what identifies the execution, for example its candidate id.
    """

    def __init__(self, path: Path, world: HandWorld, metadata: Mapping[str, str]) -> None:
        self._path, self._world, self._metadata = path, world, dict(metadata)

    def __enter__(self) -> Self:
        self._file = self._path.open("wb")
        self._writer = Writer(self._file, compression=CompressionType.ZSTD)
        # No library versions and no clock: times are simulated, so that the bytes depend on the execution only.
        self._writer.start(profile="placebench", library="placebench")
        self._channels = {}
        for topic, properties in _SCHEMAS.items():
            properties = {"step": {"type": "integer"}, **properties}
            schema = {"type": "object", "properties": properties, "required": list(properties)}
            number = self._writer.register_schema(f"placebench.{topic}", "jsonschema", json.dumps(schema, sort_keys=True).encode())
            self._channels[topic] = self._writer.register_channel(f"/{topic}", "json", number)
        self._writer.add_metadata(_METADATA, self._metadata)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._writer.finish()
        self._file.close()

    def record(self, phase: Phase) -> bool:
        """Write the world's present state; never ends a motion."""
        world = self._world
        if world.has_robot:
            q, fingers_m = world.arm_state()
            self._write("joint_states", {"q_rad": q.tolist(), "fingers_m": fingers_m.tolist()})
        pose = pose_of(world.object_pose()).tolist()
        self._write("object_pose", {"position_m": pose[:3], "quaternion_xyzw": pose[3:]})
        fixed_n = sum(world.force_n("object", name) for name in world.fixed_bodies)
        contacts = {
            "robot_object_n": world.force_n("robot", "object"),
            "object_fixed_n": fixed_n,
        }
        self._write("contacts", contacts)
        self._write("phase", {"phase": phase.value})
        return False

    def _write(self, topic: str, message: Mapping[str, Any]) -> None:
        time_ns = round(self._world.n_steps * self._world.params.dt_s * 1e9)
        data = json.dumps({"step": self._world.n_steps, **message}, sort_keys=True).encode()
        self._writer.add_message(self._channels[topic], time_ns, data, time_ns)


def read_trace(path: Path) -> Trace:
    """A trace as arrays.

    Raises:
        TraceError: the file is no MCAP file or holds other topics than ours.
    """
    samples: dict[int, dict[str, Any]] = {}
    with path.open("rb") as file:
        try:
            reader = make_reader(file)
            metadata = next((dict(record.metadata) for record in reader.iter_metadata() if record.name == _METADATA), None)
            for _, channel, message in reader.iter_messages():
                content = json.loads(message.data)
                samples.setdefault(content["step"], {"time_s": message.log_time * 1e-9})[channel.topic.removeprefix("/")] = content
        except Exception as error:  # whatever the parser meets in a foreign file
            raise TraceError(f"{path}: {error}") from error
    if metadata is None:
        raise TraceError(f"{path}: no metadata record {_METADATA!r}; not a trace of an execution")
    ordered = [samples[step] for step in sorted(samples)]
    nothing = {"q_rad": [np.nan] * 7, "fingers_m": [np.nan] * 2}
    joints = [sample.get("joint_states", nothing) for sample in ordered]
    poses = [sample["object_pose"]["position_m"] + sample["object_pose"]["quaternion_xyzw"] for sample in ordered]
    return Trace(
        metadata=metadata,
        step=np.array(sorted(samples), dtype=np.int64),
        time_s=np.array([sample["time_s"] for sample in ordered]),
        phase=tuple(Phase(sample["phase"]["phase"]) for sample in ordered),
        q_rad=np.array([joint["q_rad"] for joint in joints]).reshape(-1, 7),
        fingers_m=np.array([joint["fingers_m"] for joint in joints]).reshape(-1, 2),
        T_base_object=matrix_of(np.array(poses).reshape(-1, 7)),
        robot_object_n=np.array([sample["contacts"]["robot_object_n"] for sample in ordered]),
        object_fixed_n=np.array([sample["contacts"]["object_fixed_n"] for sample in ordered]),
    )
