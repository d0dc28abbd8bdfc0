"""How long a ranker takes to order a group, whatever ranks: the clock and the groups; what is timed is in scoring.py and tree_times.py."""

from __future__ import annotations

import platform
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from model.inputs import ReleaseInputs, restricted

N_TIMED_SCENES = 20


@dataclass(frozen=True, slots=True)
class DecisionTime:
    """Time to order one group, from the scene's points and poses in memory to scores; reading files is not in it.

    `prepare_s` makes of them what the ranker reads, on the CPU: a sampled cloud and neighbours, views from the hand, derived geometry.
    `forward_s` runs the ranker, a network on its device.
    """

    task: str  # joint or fixed
    scene_id: str
    target_id: int | None  # None in the joint task
    n_candidates: int
    prepare_s: float
    forward_s: float


def timed_groups(inputs: ReleaseInputs, decide: Callable[[ReleaseInputs], tuple[float, float]]) -> list[DecisionTime]:
    """Decision time of the joint group and of every fixed-target group of some scenes, one group at a time.

    The first scene is decided once beforehand, unmeasured.

    Args:
        inputs: the scenes; nothing is kept from one decision for another.
        decide: orders the candidates of what it is given; returns seconds to prepare and to rank.
    """
    times = []
    for scene, cloud in enumerate(inputs.clouds):
        groups = np.flatnonzero(inputs.group_scene == scene)
        joint = restricted(inputs, groups)
        if scene == 0:
            decide(joint)
        times.append(DecisionTime("joint", cloud.scene_id, None, len(joint.candidate_ids), *decide(joint)))
        for group in groups:
            own = restricted(inputs, np.array([group]))
            times.append(DecisionTime("fixed", cloud.scene_id, int(inputs.group_target_id[group]), len(own.candidate_ids), *decide(own)))
    return times


def machine_name() -> str:
    """Operating system, architecture and processor of this machine: what a time depends on besides the code."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:  # other systems than Linux
        lines = []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    processor = models[0] if models else platform.processor() or "unknown processor"
    return f"{platform.system()} {platform.machine()}, {processor}"
