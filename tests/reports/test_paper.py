"""The paper's own sums and sentences, so that a slip in copying a number shows."""

from __future__ import annotations

import pytest

from reports import paper
from reports.load import Task


def test_counts_add_up() -> None:
    assert sum(paper.N_CANDIDATES.values()) == 249_648
    assert paper.N_CANDIDATES["test"] / paper.N_JOINT_GROUPS_TEST == pytest.approx(paper.CANDIDATES_PER_JOINT_GROUP_TEST, abs=0.05)
    assert paper.N_CANDIDATES["test"] / paper.N_FIXED_GROUPS_TEST == pytest.approx(paper.CANDIDATES_PER_FIXED_GROUP_TEST, abs=0.05)
    assert sum(paper.REPEAT_OUTCOMES.values()) == paper.N_REPEAT_TASKS
    # 50 tasks once and 15 of them twice more.
    assert paper.N_REPEAT_TASKS + paper.N_REPEATS - paper.N_TASKS_REPEATED == paper.N_REPEAT_EXECUTIONS


def test_coverage_is_the_share_of_solvable_groups() -> None:
    for task, n_groups in ((Task.JOINT, paper.N_JOINT_GROUPS_TEST), (Task.FIXED, paper.N_FIXED_GROUPS_TEST)):
        groups = paper.SOLVABILITY[task]
        assert groups.n_solvable + groups.n_unsolvable == n_groups
        assert 100 * groups.n_solvable / n_groups == pytest.approx(paper.COVERAGE["test", task], abs=0.005)


def test_balanced_accuracy_is_the_mean_recall() -> None:
    fixed = paper.SOLVABILITY[Task.FIXED]
    assert fixed.recall_solvable is not None
    assert fixed.recall_unsolvable is not None
    assert (fixed.recall_solvable + fixed.recall_unsolvable) / 2 == pytest.approx(fixed.balanced_accuracy, abs=0.01)


def test_every_percentage_of_the_policy_table_is_a_whole_number_of_groups() -> None:
    """S_K of 232 or 959 covered groups comes in steps; a mistyped digit falls between them."""
    for (task, _), ranking in paper.RANKING.items():
        n = paper.SOLVABILITY[task].n_solvable
        for k in (1, 3, 5):
            hits = ranking.s(k) * n / 100
            assert abs(100 * round(hits) / n - ranking.s(k)) < 0.0051, (task, ranking)
        assert ranking.s1 <= ranking.s3 <= ranking.s5


def test_the_gains_of_the_text_are_those_of_the_table() -> None:
    for task, gain in ((Task.JOINT, 12.94), (Task.FIXED, 20.02)):
        assert paper.RANKING[task, "ranker"].s1 - paper.RANKING[task, "full_planner"].s1 == pytest.approx(gain)


def test_the_full_variant_is_the_one_of_the_seed_table() -> None:
    joint_s1, fixed_s1, fixed_s5 = paper.ABLATION["full"]
    assert joint_s1 == paper.SEEDS["validation", Task.JOINT][0]
    assert (fixed_s1, fixed_s5) == (paper.SEEDS["validation", Task.FIXED][0], paper.SEEDS["validation", Task.FIXED][2])
