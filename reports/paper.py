"""What the paper reports, to be printed beside ours, with the table or section each figure was read from.

Liu, Patamia, Champion, Dazeley, Cosgun: Execution-Aware Pre-Execution Ranking for Grasp-Conditioned Robotic Placement. It used
Isaac Sim and cuMotion, so its figures are a landmark for the protocol and no target for the labels.
"""

from __future__ import annotations

from dataclasses import dataclass

from reports.load import Task
from reports.metrics import Spread


@dataclass(frozen=True, slots=True)
class PaperRanking:
    """S_K on covered groups in percent, and mean decision time."""

    s1: float
    s3: float
    s5: float
    seconds: float | None = None
    is_upper_bound: bool = False  # the paper prints `< seconds`

    def s(self, k: int) -> float:
        return {1: self.s1, 3: self.s3, 5: self.s5}[k]


RANKING_SOURCE = "Table I, test split, seed 42"
RANKING = {
    (Task.JOINT, "random"): PaperRanking(15.95, 37.07, 52.16, 0.001, True),
    (Task.JOINT, "ik_only"): PaperRanking(20.26, 46.98, 60.78, 0.254),
    (Task.JOINT, "gripper_only"): PaperRanking(39.66, 69.40, 82.33, 4.990),
    (Task.JOINT, "ik_and_gripper"): PaperRanking(41.81, 71.55, 84.91, 5.243),
    (Task.JOINT, "full_planner"): PaperRanking(72.84, 91.38, 94.40, 255.746),
    (Task.JOINT, "ranker"): PaperRanking(85.78, 97.84, 99.14, 0.232),
    (Task.FIXED, "random"): PaperRanking(28.26, 53.08, 65.28, 0.001, True),
    (Task.FIXED, "ik_only"): PaperRanking(33.16, 60.48, 72.47, 0.032),
    (Task.FIXED, "gripper_only"): PaperRanking(53.28, 77.16, 82.27, 0.624),
    (Task.FIXED, "ik_and_gripper"): PaperRanking(54.95, 78.42, 82.48, 0.655),
    (Task.FIXED, "full_planner"): PaperRanking(59.65, 73.31, 74.66, 31.968),
    (Task.FIXED, "ranker"): PaperRanking(79.67, 94.47, 97.60, 0.029),
}

# Section VI-A, test split, seed 42.
PLAN_HEAD_S1 = {Task.JOINT: 78.45, Task.FIXED: 76.02}
PLANNER_CALLS_MEAN = {Task.JOINT: 1.17, Task.FIXED: 1.47}
PLANNER_CALLS_MEDIAN = 1
PLANNER_CALLS_P90 = 2

SEEDS_SOURCE = "Table II, seeds 42, 43, 44"
SEEDS = {
    ("validation", Task.JOINT): (Spread(85.79, 0.64), Spread(98.87, 0.24), Spread(99.44, 0.24)),
    ("validation", Task.FIXED): (Spread(81.05, 0.41), Spread(93.89, 0.12), Spread(96.88, 0.16)),
    ("test", Task.JOINT): (Spread(85.63, 1.08), Spread(97.70, 0.25), Spread(99.28, 0.25)),
    ("test", Task.FIXED): (Spread(79.84, 0.16), Spread(94.86, 0.34), Spread(97.43, 0.16)),
}
COVERAGE = {
    ("validation", Task.JOINT): 100.00,
    ("validation", Task.FIXED): 51.21,
    ("test", Task.JOINT): 97.89,
    ("test", Task.FIXED): 50.58,
}

ABLATION_SOURCE = "Table III, validation split, seeds 42, 43, 44"
ABLATION = {  # joint S1, fixed S1, fixed S5
    "direct": (Spread(83.40, 0.88), Spread(79.13, 0.42), Spread(96.53, 0.12)),
    "no_object_relative": (Spread(66.95, 1.29), Spread(64.50, 0.42), Spread(89.43, 0.12)),
    "no_target_hypothesis": (Spread(86.78, 0.24), Spread(79.68, 0.26), Spread(97.22, 0.21)),
    "full": (Spread(85.79, 0.64), Spread(81.05, 0.41), Spread(96.88, 0.16)),
}


@dataclass(frozen=True, slots=True)
class PaperSolvability:
    """Telling covered from uncovered groups by the largest predicted success probability; in percent."""

    n_solvable: int
    n_unsolvable: int
    auroc: float
    balanced_accuracy: float | None = None
    recall_solvable: float | None = None
    recall_unsolvable: float | None = None


SOLVABILITY_SOURCE = "Table IV, test split, seed 42"
SOLVABILITY = {
    Task.JOINT: PaperSolvability(232, 5, 99.66),
    Task.FIXED: PaperSolvability(959, 937, 97.77, 94.30, 94.89, 93.70),
}

REPEATABILITY_SOURCE = "Section VI-E"
N_REPEAT_TASKS = 50
N_REPEAT_MATCHES = 50  # in planning, in final and in three-class outcome
N_TASKS_REPEATED = 15
N_REPEATS = 45
N_REPEAT_EXECUTIONS = 80
REPEAT_OUTCOMES = {"planning failure": 31, "downstream failure": 1, "success": 18}

# Sections V-A and V-B.
N_OBJECTS = 30
N_SCENES = 1_235
N_CANDIDATES = {"train": 153_072, "validation": 48_200, "test": 48_376}
N_JOINT_GROUPS_TEST = 237
N_FIXED_GROUPS_TEST = 1_896
CANDIDATES_PER_JOINT_GROUP_TEST = 204.1
CANDIDATES_PER_FIXED_GROUP_TEST = 25.5
