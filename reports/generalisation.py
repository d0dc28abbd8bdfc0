"""Report of generalisation: what rankers are worth on objects, categories and clutter that they were not trained on.

Under each split scheme the same rankers are trained on its train split and judged on its test split. `make rankers SPLIT=...` trains them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import polars as pl
import pyarrow as pa

from pipelines.frames import frame_of
from reports.entries import Entry, entry_of, flat, learned_entries
from reports.load import Task, candidate_frame
from reports.metrics import MIN_SCENES
from reports.policies import FULL_PLANNER, IK_AND_GRIPPER, LOCAL, TREES, Policy
from reports.ranking import TASK_TITLE, timing_frame
from reports.report import Report, ReportError
from reports.resampling import SceneBootstrap
from splits.markdown import table
from tables.vocabulary import Split, SplitScheme

_LEVELS = (IK_AND_GRIPPER, FULL_PLANNER)
_JUDGED = (LOCAL, TREES)
_UNSEEN = {
    SplitScheme.SCENE: "scenes alone",
    SplitScheme.OBJECT: "objects",
    SplitScheme.CATEGORY_CAN: "cans",
    SplitScheme.CATEGORY_MUG: "mugs",
    SplitScheme.CATEGORY_CUBOID: "cuboids",
    SplitScheme.LAYOUT: "two obstacles",
}


@dataclass(frozen=True, slots=True, eq=False)
class Trained:
    """A split scheme: the candidates of its test split, and what rankers of its train split say of them."""

    scheme: SplitScheme
    test: pl.DataFrame
    scores: pl.DataFrame

    def among(self, scene_ids: set[str]) -> Trained:
        """The same of some scenes of its test split."""
        return Trained(self.scheme, self.test.filter(pl.col("scene_id").is_in(scene_ids)), self.scores)

    @property
    def scene_ids(self) -> set[str]:
        return set(self.test["scene_id"])

    def levels(self, task: Task) -> list[Entry]:
        """Policies that learn nothing: how hard the groups are."""
        return [entry_of(policy, task, self.test, timing_frame({})) for policy in _LEVELS]

    def learned(self, task: Task) -> dict[Policy, Entry]:
        return {entry.policy: entry for entry in learned_entries(self.test, self.scores, task, timing_frame({}), _JUDGED)}


def generalisation_report(tables: Mapping[str, pa.Table], predictions: Mapping[SplitScheme, pa.Table], *, tier: str, seed: int) -> Report:
    """Report `generalisation`, of the test split of every scheme.

    Args:
        tables: `candidates`, `splits`, `scenes`, `targets`, `policy_features` of a release.
        predictions: by the scheme that their rankers were trained under; the paper's and others.
        tier: printed in the title.
        seed: of the hash order and the resampling.

    Raises:
        ReportError: no predictions of the paper's scheme, or a candidate of a test split without one.
    """
    if SplitScheme.SCENE not in predictions:
        raise ReportError("predictions: none of rankers of the paper's split, must be there to compare with")
    trained = {scheme: _trained(tables, scheme, predictions[scheme], seed) for scheme in SplitScheme if scheme in predictions}
    blocks = [f"# What rankers were not trained on, tier {tier}", _ABOUT]
    metrics: dict[str, float] = {}
    for task in Task:
        rows, drops = [], []
        for scheme, own in trained.items():
            entries = [*own.levels(task), *own.learned(task).values()]
            by_policy = {entry.policy: entry.s(1) for entry in entries}
            rows.append(
                [f"`{scheme.value}`", _UNSEEN[scheme], f"{len(own.scene_ids):,}", f"{entries[0].covered.height:,}"]
                + [by_policy.get(policy) for policy in (*_LEVELS, *_JUDGED)]
            )
            for policy in _JUDGED:
                metrics |= flat(f"test.{task.value}.{policy.name}.{scheme.value}.s1", by_policy.get(policy))
            if scheme is not SplitScheme.SCENE:
                shown, values = _drops(trained[SplitScheme.SCENE], own, task, seed)
                drops += shown
                metrics |= values
        blocks += [f"## {TASK_TITLE[task]}", "S1 on the test split of each scheme, by rankers of its train split:"]
        names = [policy.label for policy in (*_LEVELS, *_JUDGED)]
        blocks.append(table(["split", "unseen", "scenes", "covered groups", *names], rows, align="llrrrrrr"))
        blocks.append("On scenes that no ranker was trained on, those of both test splits:")
        header = ["split", "policy", "scenes", "covered groups", "trained on others like them", "not trained on any", "difference"]
        blocks.append(table(header, drops, align="llrrrrr"))
    return Report("generalisation", "\n\n".join(blocks) + "\n", metrics=metrics)


_ABOUT = (
    "Rankers are trained on the train split of a scheme, their epoch is chosen on its validation split, and what is judged is its test"
    " split. Test splits are of other scenes and as hard as they are, which the policies that learn nothing show; so what a ranker loses is"
    " **measured on the scenes that are in test of the paper's split and of the other one**: neither ranker was trained on these scenes,"
    " but that of the paper's split was trained on others with the same object, category and number of obstacles. The difference is paired"
    f" by group. Intervals are 95 %, resampled by scene and training; none below {MIN_SCENES} scenes."
)


def _trained(tables: Mapping[str, pa.Table], scheme: SplitScheme, predictions: pa.Table, seed: int) -> Trained:
    frame = candidate_frame(tables, seed, scheme).filter(pl.col("split") == Split.TEST.value)
    return Trained(scheme, frame, frame_of(predictions).with_columns(pl.col("variant").cast(pl.String)))


def _drops(known: Trained, held_out: Trained, task: Task, seed: int) -> tuple[list[list[object]], dict[str, float]]:
    """Rows and metrics of what each ranker loses on the scenes of both test splits."""
    both = known.scene_ids & held_out.scene_ids
    before, after = known.among(both).learned(task), held_out.among(both).learned(task)
    rows: list[list[object]] = []
    metrics: dict[str, float] = {}
    for policy in (policy for policy in _JUDGED if policy in before and policy in after):
        bootstrap = SceneBootstrap(before[policy].scene_ids, seed)
        start = [f"`{held_out.scheme.value}`", policy.label, f"{len(both):,}", f"{before[policy].covered.height:,}"]
        if not bootstrap.is_telling:
            rows.append([*start, None, None, None])
            continue
        draws = [entry.s_draws(1, bootstrap) for entry in (before[policy], after[policy])]
        difference = (draws[1] - draws[0]).estimate()
        rows.append([*start, before[policy].s(1), after[policy].s(1), difference])
        metrics |= flat(f"test.{task.value}.{policy.name}.{held_out.scheme.value}.s1_minus_trained_on_others", difference)
    return rows, metrics
