"""How long the trees take to order a group: derived geometry of its candidates and the predictions of both heads."""

from __future__ import annotations

import time
from pathlib import Path

from model.decision_times import N_TIMED_SCENES, DecisionTime, timed_groups
from model.geometry import candidate_geometry
from model.inputs import InputReader, ReleaseInputs, read_inputs, scenes_of_split
from model.trees import Trees
from tables.vocabulary import Split, SplitScheme


def tree_decision_times(
    release_dir: Path, trees: Trees, split: str = Split.TEST.value, n_scenes: int = N_TIMED_SCENES, scheme: SplitScheme = SplitScheme.SCENE
) -> list[DecisionTime]:
    """Decision time of every group of the first scenes of a split, as networks are timed: wall-clock, one thread.

    All derived geometry is computed, so it is that of trees that read it all.
    """

    def decide(inputs: ReleaseInputs) -> tuple[float, float]:
        start_s = time.perf_counter()
        geometry = candidate_geometry(inputs)
        prepared_s = time.perf_counter()
        trees.log_probabilities(geometry).sum(axis=0)
        return prepared_s - start_s, time.perf_counter() - prepared_s

    reader = InputReader(release_dir, scheme)
    return timed_groups(read_inputs(reader, scenes_of_split(reader, split)[:n_scenes]), decide)
