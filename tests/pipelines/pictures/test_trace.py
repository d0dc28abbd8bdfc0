"""A trace reads back what ran, equal runs give equal bytes, and what is no trace is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer

from pipelines.codecs import Row, pose_in
from pipelines.engines.physics.hand_world import HandWorld
from pipelines.engines.physics.phases import Phase
from pipelines.labels.execution import ExecutionParams, ExecutionSetup, execute_candidate
from pipelines.pictures.trace import TraceError, TraceRecorder, read_trace
from tests.pipelines.engines.physics.lifted import MOTION, PHYSICS, lifted

SETUP = ExecutionSetup(ExecutionParams(), MOTION, PHYSICS)


def _traced(path: Path) -> Row:
    case = lifted("cuboid")
    candidate, plan = case.planned[0]
    with (
        HandWorld(case.object_model, (), PHYSICS) as world,
        TraceRecorder(path, world, {"candidate_id": candidate.candidate_id}) as trace,
    ):
        return execute_candidate(world, candidate, plan, SETUP, trace.record)


def test_a_trace_holds_the_execution(tmp_path: Path) -> None:
    row = _traced(tmp_path / "a.mcap")
    trace = read_trace(tmp_path / "a.mcap")
    grasp = lifted("cuboid").grasps[0]
    assert trace.metadata["candidate_id"].startswith("full-0000-t")
    assert trace.step[-1] == row["n_physics_steps"]
    assert np.all(np.diff(trace.step) > 0)
    np.testing.assert_allclose(trace.time_s, trace.step * PHYSICS.dt_s, atol=1e-8)
    np.testing.assert_allclose(trace.T_base_object[-1], pose_in(row, "final"), atol=1e-12)
    np.testing.assert_allclose(trace.q_rad[0], grasp.lifted_q_rad, atol=1e-3)
    phases = list(dict.fromkeys(trace.phase))
    assert phases == [Phase.HOLD, Phase.TRANSPORT, Phase.DESCEND, Phase.OPEN, Phase.RETREAT, Phase.SETTLE]
    settling = np.array([phase is Phase.SETTLE for phase in trace.phase])
    assert np.isnan(trace.q_rad[settling]).all()
    assert np.isfinite(trace.q_rad[~settling]).all()
    carried = np.array([phase is Phase.TRANSPORT for phase in trace.phase])
    # Two pads with the grip force each; the table carries nothing of it on the way and all of the weight in the end.
    assert np.median(trace.robot_object_n[carried]) == pytest.approx(2 * PHYSICS.finger_force_n, rel=0.05)
    assert trace.object_fixed_n[carried].max() == 0.0
    assert trace.object_fixed_n[-1] == pytest.approx(lifted("cuboid").object_model.mass_kg * 9.81, rel=0.05)


def test_equal_executions_give_equal_bytes_and_a_trace_changes_nothing(tmp_path: Path) -> None:
    first, second = _traced(tmp_path / "a.mcap"), _traced(tmp_path / "b.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
    case = lifted("cuboid")
    with HandWorld(case.object_model, (), PHYSICS) as world:
        untraced = execute_candidate(world, *case.planned[0], SETUP)
    assert first == second == untraced


def test_other_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "noise.mcap").write_bytes(b"not an mcap file at all, only some bytes")
    with pytest.raises(TraceError, match=r"noise\.mcap"):
        read_trace(tmp_path / "noise.mcap")
    with (tmp_path / "empty.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.finish()
    with pytest.raises(TraceError, match="no metadata record"):
        read_trace(tmp_path / "empty.mcap")
