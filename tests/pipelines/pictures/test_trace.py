"""A trace reads back what ran, by mcap's own reader and by Rerun's; equal runs give equal bytes; a rejection says what it is."""

from __future__ import annotations

import io
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from pipelines.codecs import Row, pose_in
from pipelines.engines.physics.phases import Phase
from pipelines.labels.execution import ExecutionParams, ExecutionSetup
from pipelines.pictures.recording import Recording, record_execution, record_rejection
from pipelines.pictures.trace import METADATA, trace
from tables.poses import matrix_of
from tables.vocabulary import PointType
from tests.pipelines.engines.physics.lifted import MOTION, PHYSICS, lifted

SETUP = ExecutionSetup(ExecutionParams(), MOTION, PHYSICS)
POINTS: list[Row] = [
    {"scene_id": "full-0000", "point": k, "point_type": kind.value, "x_m": 0.125 * k, "y_m": -0.25, "z_m": 0.5}
    for k, kind in enumerate(PointType)
]
IDENTITY = {"recipe_hash": "r" * 64, "release_hash": "h" * 64}


@lru_cache(maxsize=1)
def _recording() -> Recording:
    case = lifted("cuboid")
    candidate, motion = case.planned[0]
    return record_execution(case.object_model, candidate, motion, SETUP, {"plan_status": "solved"})


def _messages(data: bytes) -> dict[str, list[tuple[int, Any]]]:
    found: dict[str, list[tuple[int, Any]]] = {}
    for _, channel, message, content in make_reader(io.BytesIO(data), decoder_factories=[DecoderFactory()]).iter_decoded_messages(
        topics=["/tf", "/joint_states", "/scene", "/points", "/log"]
    ):
        found.setdefault(channel.topic, []).append((message.log_time, content))
    return found


def test_a_trace_holds_the_execution() -> None:
    recording = _recording()
    data = trace(recording, POINTS, IDENTITY)
    messages = _messages(data)
    times_ns = [round(moment.time_s * 1e9) for moment in recording.moments]
    assert [t for t, _ in messages["/tf"]] == [t for t, _ in messages["/joint_states"]] == times_ns
    assert times_ns[0] == 0
    last = {x.child_frame_id: x for x in messages["/tf"][-1][1].transforms}
    assert {x.parent_frame_id for x in last.values()} == {"base"}
    assert {*(f"panda_link{k}" for k in range(9)), "panda_hand", "panda_leftfinger", "panda_rightfinger", "tcp", "object", "target"} <= set(
        last
    )
    p, q = last["object"].translation, last["object"].rotation
    end = matrix_of(np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w]))
    np.testing.assert_allclose(end, pose_in(recording.labels, "final"), atol=1e-12)
    states = messages["/joint_states"]
    np.testing.assert_array_equal([joint.position for joint in states[0][1].joints][:7], recording.moments[0].q_rad)
    phases = [Phase.HOLD, Phase.TRANSPORT, Phase.DESCEND, Phase.OPEN, Phase.RETREAT, Phase.SETTLE]
    assert [log.message for _, log in messages["/log"]][:-1] == [phase.value for phase in phases]
    assert messages["/log"][-1][1].message == f"{recording.candidate.candidate_id}: {recording.labels['exec_status']}"


def test_frames_of_the_fingers_are_where_the_object_is_held() -> None:
    """A twin of the kinematics: halfway between the finger frames, along the hand's z, lies the TCP that the arm's closed form gives."""
    frames = {x.child_frame_id: x.translation for x in _messages(trace(_recording(), POINTS, IDENTITY))["/tf"][0][1].transforms}
    at = {name: np.array([v.x, v.y, v.z]) for name, v in frames.items()}
    np.testing.assert_allclose(np.linalg.norm(at["tcp"] - at["panda_hand"]), 0.1034, atol=1e-6)
    middle = (at["panda_leftfinger"] + at["panda_rightfinger"]) / 2
    along = (at["tcp"] - at["panda_hand"]) / 0.1034
    np.testing.assert_allclose(middle, at["panda_hand"] + 0.0584 * along, atol=2e-3)


def test_bodies_and_the_typed_cloud_are_in_it() -> None:
    messages = _messages(trace(_recording(), POINTS, IDENTITY))
    ((time_ns, scene),) = messages["/scene"]
    assert time_ns == 0
    entities = {entity.id: entity for entity in scene.entities}
    assert {"table", "object", "target", "link0", "link7", "hand", "left_finger_pad"} <= set(entities)
    assert entities["target"].triangles[0].color.a < 1.0
    mesh = _recording().object_model.mesh
    assert len(entities["object"].triangles[0].points) == len(mesh.vertices_m)
    ((_, cloud),) = messages["/points"]
    points = np.frombuffer(cloud.data, dtype=[("xyz", "<f4", 3), ("kind", "u1"), ("rgba", "u1", 4)])
    assert cloud.point_stride == points.itemsize
    np.testing.assert_array_equal(points["xyz"], [[0.125 * k, -0.25, 0.5] for k in range(3)])
    assert points["kind"].tolist() == [0, 1, 2]


def test_the_file_is_indexed_zstd_and_says_what_it_is_of() -> None:
    data = trace(_recording(), POINTS, IDENTITY)
    reader = make_reader(io.BytesIO(data))
    summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_start_time == 0
    assert {chunk.compression for chunk in summary.chunk_indexes} == {"zstd"}
    assert summary.metadata_indexes
    (record,) = reader.iter_metadata()
    assert record.name == METADATA
    assert record.metadata["candidate_id"] == _recording().candidate.candidate_id
    assert {name: record.metadata[name] for name in IDENTITY} == IDENTITY
    schemas = {schema.name for schema in summary.schemas.values()}
    assert schemas >= {"foxglove.FrameTransforms", "foxglove.JointStates", "foxglove.SceneUpdate", "foxglove.PointCloud", "foxglove.Log"}


def test_equal_executions_give_equal_bytes() -> None:
    case = lifted("cuboid")
    candidate, motion = case.planned[0]
    again = record_execution(case.object_model, candidate, motion, SETUP, {"plan_status": "solved"})
    assert trace(again, POINTS, IDENTITY) == trace(_recording(), POINTS, IDENTITY)


def test_forces_are_those_of_the_hold() -> None:
    recording, mass_kg = _recording(), lifted("cuboid").object_model.mass_kg
    carried = [moment for moment in recording.moments if moment.phase is Phase.TRANSPORT]
    # Two pads with the grip force each; the table carries nothing of it on the way and all of the weight in the end.
    assert np.median([moment.robot_object_n for moment in carried]) == pytest.approx(2 * PHYSICS.finger_force_n, rel=0.05)
    assert max(moment.object_fixed_n for moment in carried) == 0.0
    assert recording.moments[-1].object_fixed_n == pytest.approx(mass_kg * 9.81, rel=0.05)


def test_a_rejection_shows_the_hand_at_the_place_and_its_status() -> None:
    case = lifted("cuboid")
    candidate = case.planned[0][0]
    recording = record_rejection(case.object_model, candidate, 0.003, {"candidate_id": candidate.candidate_id, "plan_status": "no_ik"})
    messages = _messages(trace(recording, [], IDENTITY))
    assert "/points" not in messages
    assert [log.message for _, log in messages["/log"]] == [f"{candidate.candidate_id}: not planned, no_ik; nothing was executed"]
    assert len(messages["/tf"]) == 1
    assert "place_hand" in {entity.id for entity in messages["/scene"][0][1].entities}
    (hand,) = [x.translation for x in messages["/tf"][0][1].transforms if x.child_frame_id == "place_hand"]
    np.testing.assert_allclose([hand.x, hand.y, hand.z], candidate.place_pose(0.003)[:3, 3])


def test_rerun_opens_it(tmp_path: Any) -> None:
    """Rerun's own loader for MCAP, into a recording that is read back."""
    chunks = pytest.importorskip("rerun.chunk", reason="rerun-sdk is not installed: pip install -c constraints.txt '.[viewers]'")
    path = tmp_path / "a.mcap"
    path.write_bytes(trace(_recording(), POINTS, IDENTITY))
    reader = chunks.McapReader(path, timeline_type="duration_ns")
    assert reader.time_bounds() == (0, round(_recording().moments[-1].time_s * 1e9))
    columns: dict[str, set[str]] = {}
    for chunk in reader.stream():
        columns.setdefault(chunk.entity_path, set()).update(chunk.to_record_batch().schema.names)
    assert columns.keys() >= {"/tf", "/joint_states", "/scene", "/points", "/log"}
    assert any(name.startswith("Points3D:") for name in columns["/points"])
    assert any(name.startswith("Transform3D:") for name in columns["/tf"])
    assert any(name.startswith("TextLog:") for name in columns["/log"])
