"""A strip is one row of as many pictures as were asked for: an execution, or the hand where it could not be brought."""

from __future__ import annotations

import numpy as np

from pipelines.labels.execution import ExecutionParams, ExecutionSetup
from pipelines.pictures.filmstrip import PLACE_HAND_RGB, strip_tiles
from pipelines.pictures.recording import record_execution, record_rejection
from tests.pipelines.engines.physics.lifted import MOTION, PHYSICS, lifted

SIZE_PX = (120, 90)


def n_orange(picture: np.ndarray) -> int:
    """Pixels of the colour of the hand at the place, in whatever light."""
    shades = picture / np.maximum(picture.max(axis=2, keepdims=True), 1)
    return int((np.abs(shades - np.array(PLACE_HAND_RGB) / max(PLACE_HAND_RGB)).max(axis=2) < 0.08).sum())


def test_a_rejection_shows_the_hand_at_its_place_and_fills_its_row() -> None:
    case = lifted("can")
    candidate, _ = case.planned[0]
    tiles = strip_tiles(record_rejection(case.object_model, candidate, 0.003, {"plan_status": "retreat_blocked"}), 5, SIZE_PX)
    assert [tile.caption for tile in tiles] == [f"{candidate.candidate_id}  after the lift", "retreat blocked", "", "", ""]
    assert [tile.picture.shape for tile in tiles] == [(90, 120, 3)] * 5
    assert [n_orange(tile.picture) > 20 for tile in tiles] == [False, True, False, False, False]
    assert all(tile.picture.min() == 255 for tile in tiles[2:])


def test_an_execution_begins_with_its_id_and_ends_with_its_verdict() -> None:
    case = lifted("can")
    candidate, motion = case.planned[0]
    recording = record_execution(case.object_model, candidate, motion, ExecutionSetup(ExecutionParams(), MOTION, PHYSICS))
    tiles = strip_tiles(recording, 4, SIZE_PX)
    assert len(tiles) == 4
    assert tiles[0].caption == f"{candidate.candidate_id}  hold  0.00 s"
    assert tiles[-1].caption.endswith(f" s: {str(recording.labels['exec_status']).replace('_', ' ')}")
    assert not any(n_orange(tile.picture) > 20 for tile in tiles)
