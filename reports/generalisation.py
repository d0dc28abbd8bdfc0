"""Report of generalisation: what rankers are worth on objects, categories and clutter that they were not trained on.

Under each split scheme the same rankers are trained on its train split and judged on its test split. `make rankers SPLIT=...` trains them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import polars as pl
import pyarrow as pa

from pipelines.frames import frame_of
from reports.by_object import ABOUT_OBJECTS, by_object
from reports.entries import Entry, entry_of, flat, learned_entries
from reports.load import Task, candidate_frame, group_frame
from reports.metrics import MIN_SCENES, Estimate
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
    """A split scheme: the candidates of its test split, what rankers of its train split say of them, and how many scenes that has."""

    scheme: SplitScheme
    test: pl.DataFrame
    scores: pl.DataFrame
    n_train_scenes: int

    def among(self, scene_ids: set[str]) -> Trained:
        """The same of some scenes of its test split."""
        return replace(self, test=self.test.filter(pl.col("scene_id").is_in(scene_ids)))

    def n_trainings(self, policy: Policy) -> int:
        """How many rankers of a policy were trained."""
        return self.scores.filter(pl.col("variant") == policy.variant)["seed"].n_unique()

    @property
    def scene_ids(self) -> set[str]:
        return set(self.test["scene_id"])

    @property
    def objects(self) -> dict[str, str]:
        """Object of each of its scenes."""
        return dict(self.test.select("scene_id", "object_id").unique().iter_rows())

    def levels(self, task: Task) -> dict[Policy, Entry]:
        """Policies that learn nothing: how hard the groups are."""
        return {policy: entry_of(policy, task, self.test, timing_frame({})) for policy in _LEVELS}

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
    blocks = [f"# What rankers were not trained on, tier {tier}", _ABOUT, "## Trainings", *_trainings(trained)]
    metrics = {f"train.{scheme.value}.n_scenes": float(own.n_train_scenes) for scheme, own in trained.items()}
    for task in Task:
        section, values = _of_task(trained, task, seed)
        blocks += [f"## {TASK_TITLE[task]}", *section]
        metrics |= values
    return Report("generalisation", "\n\n".join(blocks) + "\n", metrics=metrics)


_ABOUT = (
    "Rankers are trained on the train split of a scheme, their epoch is chosen on its validation split, and what is judged is its test"
    " split. Test splits are of other scenes and as hard as they are, which the policies that learn nothing show; so what a ranker loses is"
    " **measured on the scenes that are in test of the paper's split and of the other one**: neither ranker was trained on these scenes,"
    " but that of the paper's split was trained on others with the same object, category and number of obstacles. The difference is paired"
    " by group, and is one of training: in what was trained on, and in how much and how often, which table *Trainings* tells. What a"
    " ranker is worth that was not trained on any is its difference from the full-pool planner, which learns nothing and plans every"
    f" candidate, on the same groups. Intervals are 95 %, scenes resampled and the error of few trainings"
    f" added (of one training: of this very one); none below {MIN_SCENES} scenes."
)


def _trainings(trained: Mapping[SplitScheme, Trained]) -> list[str]:
    """How much the rankers of each scheme were trained on, and how often, beside those of the paper's split."""
    n_known = trained[SplitScheme.SCENE].n_train_scenes
    rows: list[list[object]] = []
    for scheme, own in trained.items():
        more = None if scheme is SplitScheme.SCENE else f"{own.n_train_scenes - n_known:+,}"
        trainings = [own.n_trainings(policy) or None for policy in _JUDGED]
        rows.append([f"`{scheme.value}`", _UNSEEN[scheme], f"{own.n_train_scenes:,}", more, *trainings])
    header = ["split", "unseen", "train scenes", "beside the paper's", *(f"trainings, {policy.label.lower()}" for policy in _JUDGED)]
    return [
        "Where there are fewer train scenes a loss holds what they take, too; one training may be a good or a bad one, which its interval"
        " does not tell:",
        table(header, rows, align="llrrrr"),
    ]


def _trained(tables: Mapping[str, pa.Table], scheme: SplitScheme, predictions: pa.Table, seed: int) -> Trained:
    frame = candidate_frame(tables, seed, scheme).filter(pl.col("split") == Split.TEST.value)
    n_train = group_frame(tables, Task.JOINT, scheme).filter(pl.col("split") == Split.TRAIN.value).height
    return Trained(scheme, frame, frame_of(predictions).with_columns(pl.col("variant").cast(pl.String)), n_train)


def _of_task(trained: Mapping[SplitScheme, Trained], task: Task, seed: int) -> tuple[list[str], dict[str, float]]:
    levels: list[list[object]] = []
    drops: list[list[object]] = []
    gains: list[list[object]] = []
    one_by_one: list[str] = []
    metrics: dict[str, float] = {}
    for scheme, own in trained.items():
        entries = own.levels(task) | own.learned(task)
        s1 = {policy: entry.s(1) for policy, entry in entries.items()}
        cells = [s1.get(policy) for policy in (*_LEVELS, *_JUDGED)]
        levels.append([f"`{scheme.value}`", _UNSEEN[scheme], f"{len(own.scene_ids):,}", _n_covered(entries), *cells])
        for policy in (FULL_PLANNER, *_JUDGED):
            metrics |= flat(f"test.{task.value}.{policy.name}.{scheme.value}.s1", s1.get(policy))
        if scheme is not SplitScheme.SCENE:
            for rows, compare in ((drops, _drops), (gains, _gains)):
                shown, values = compare(trained[SplitScheme.SCENE], own, task, seed)
                rows += shown
                metrics |= values
        if scheme is SplitScheme.OBJECT:
            of_objects, values = by_object(
                {policy: entries[policy] for policy in (FULL_PLANNER, *_JUDGED) if policy in entries}, own.objects
            )
            one_by_one = [ABOUT_OBJECTS, of_objects]
            metrics |= {f"test.{task.value}.{name}": value for name, value in values.items()}
    of_levels = ["split", "unseen", "scenes", "covered groups", *(policy.label for policy in (*_LEVELS, *_JUDGED))]
    of_drops = ["split", "policy", "scenes", "covered groups", "trained on others like them", "not trained on any", "difference"]
    of_gains = ["split", "policy", "not trained on any", "full-pool planner", "difference", "difference, whole test split"]
    return [
        "S1 on the test split of each scheme, by rankers of its train split:",
        table(of_levels, levels, align="llrrrrrr"),
        "On scenes that no ranker was trained on, those of both test splits:",
        table(of_drops, drops, align="llrrrrr"),
        "The same rankers beside the full-pool planner, on the same groups, and on all of their own test split:",
        table(of_gains, gains, align="llrrrr"),
        *one_by_one,
    ], metrics


def _n_covered(entries: Mapping[Policy, Entry]) -> str:
    return f"{entries[FULL_PLANNER].covered.height:,}"


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


def _gains(known: Trained, held_out: Trained, task: Task, seed: int) -> tuple[list[list[object]], dict[str, float]]:
    """Rows and metrics of what each ranker is worth more than the planner where it was not trained on any: on the same scenes, on all."""
    parts = {"s1_both_tests": held_out.among(known.scene_ids), "s1": held_out}
    planner = {name: own.levels(task)[FULL_PLANNER] for name, own in parts.items()}
    rankers = {name: own.learned(task) for name, own in parts.items()}
    rows: list[list[object]] = []
    metrics = flat(f"test.{task.value}.{FULL_PLANNER.name}.{held_out.scheme.value}.s1_both_tests", planner["s1_both_tests"].s(1))
    for policy, both in rankers["s1_both_tests"].items():
        gains = {name: _gain(rankers[name][policy], planner[name], seed) for name in parts}
        rows.append([f"`{held_out.scheme.value}`", policy.label, both.s(1), planner["s1_both_tests"].s(1), *gains.values()])
        prefix = f"test.{task.value}.{policy.name}.{held_out.scheme.value}"
        metrics |= flat(f"{prefix}.s1_both_tests", both.s(1))
        for name, gain in gains.items():
            metrics |= flat(f"{prefix}.{name}_minus_{FULL_PLANNER.name}", gain)
    return rows, metrics


def _gain(ranker: Entry, planner: Entry, seed: int) -> Estimate | None:
    """S1 of a ranker minus that of the planner, paired by group; None below `MIN_SCENES` scenes."""
    bootstrap = SceneBootstrap(ranker.scene_ids, seed)
    return (ranker.s_draws(1, bootstrap) - planner.s_draws(1, bootstrap)).estimate() if bootstrap.is_telling else None
