"""Report of solvability: whether a ranker knows that a group holds no success at all; how well it orders a group is success_at_k.py's.

`python -m reports.solvability data/release/pilot --predictions FILE ... [--split object] [--out DIR]`
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl
import pyarrow as pa
from jaxtyping import Bool, Float

from pipelines.frames import frame_of
from reports import paper
from reports.command import Asked, report_command
from reports.entries import flat, prediction_frames
from reports.load import Task, candidate_frame, of_scheme, scheme_note
from reports.metrics import MIN_SCENES, Estimate, best_threshold, mean_of_two, proportion
from reports.policies import LEARNED, Policy
from reports.ranker_figures import RocCurve, RocPanel, roc_figure
from reports.ranking import TASK_TITLE
from reports.report import Report, ReportError
from reports.resampling import auroc_estimate
from splits.markdown import table
from tables.vocabulary import Split, SplitScheme

HEADER = (
    "groups", "solvable", "unsolvable", "AUROC [95 %]", "balanced accuracy [95 %]", "recall solvable [95 %]", "recall unsolvable [95 %]",
    "threshold",
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Solvability:
    """How the largest score of a group tells groups with a success from those without, over the trainings of a policy.

    Attributes:
        scores: of each group, a row a training.
        labels: whether a group holds a success.
        thresholds: of each training; none where there was nothing to choose one on.
        area: None where a kind of group is missing.
    """

    scores: Float[np.ndarray, "r n"]
    labels: Bool[np.ndarray, "n"]
    thresholds: tuple[float, ...]
    area: Estimate | None
    recall_solvable: Estimate | None = None
    recall_unsolvable: Estimate | None = None

    @property
    def balanced_accuracy(self) -> Estimate | None:
        """Mean of both recalls."""
        known = self.recall_solvable, self.recall_unsolvable
        return mean_of_two(known[0], known[1]) if known[0] is not None and known[1] is not None else None

    def cells(self) -> list[object]:
        """A row of a table under `HEADER`."""
        n, n_true = len(self.labels), int(self.labels.sum())
        threshold = f"{np.mean(self.thresholds):.3f}" if self.thresholds else None
        counts = (f"{number:,}" for number in (n, n_true, n - n_true))
        return [*counts, self.area, self.balanced_accuracy, self.recall_solvable, self.recall_unsolvable, threshold]

    def metrics(self, prefix: str) -> dict[str, float]:
        metrics = {f"{prefix}.n_solvable": float(self.labels.sum()), f"{prefix}.n_unsolvable": float((~self.labels).sum())}
        for name, own in (("auroc", self.area), ("balanced_accuracy", self.balanced_accuracy)):
            metrics |= flat(f"{prefix}.{name}", own)
        metrics |= flat(f"{prefix}.recall_solvable", self.recall_solvable) | flat(f"{prefix}.recall_unsolvable", self.recall_unsolvable)
        return metrics | ({f"{prefix}.threshold": float(np.mean(self.thresholds))} if self.thresholds else {})


def solvability_report(
    tables: Mapping[str, pa.Table], predictions: pa.Table, *, tier: str, seed: int, scheme: SplitScheme = SplitScheme.SCENE
) -> Report:
    """Report `solvability`, of the test split.

    A group without candidates has no score and is left out: nothing needs to be predicted about it.

    Args:
        tables: `candidates`, `splits`, `scenes`, `targets`, `policy_features` of a release.
        predictions: rows of any learned policies.
        tier: printed in the title.
        seed: of the hash order and the resampling.
        scheme: by what scenes are dealt to the splits; the paper's rows stand below ours for its own only.

    Raises:
        ReportError: predictions of no learned policy.
    """
    frame, scores = candidate_frame(tables, seed, scheme), frame_of(predictions)
    frames = {policy: own for policy in LEARNED if (own := prediction_frames(frame, scores, policy.variant))}
    if not frames:
        raise ReportError("predictions: 0 learned policies, must be at least 1")
    blocks = [f"# Solvability on tier {tier}{of_scheme(scheme)}, test split", *scheme_note(scheme), _about(scheme)]
    metrics: dict[str, float] = {}
    panels: dict[str, RocPanel] = {}
    for task in Task:
        judged = {policy: _judged(policy, list(own.values()), task, seed) for policy, own in frames.items()}
        rows = [[policy.label, *own.cells()] for policy, own in judged.items()]
        rows += [_paper_row(task)] if scheme is SplitScheme.SCENE else []
        blocks += [f"## {TASK_TITLE[task]}", table(["", *HEADER], rows)]
        for policy, solved in judged.items():
            metrics |= solved.metrics(f"test.{task.value}.{policy.name}.solvability")
        if any(solved.area is not None for solved in judged.values()):
            panels[TASK_TITLE[task]] = _panel(judged, task, is_paper=scheme is SplitScheme.SCENE)
    figures = {}
    if panels:
        title = f"Solvable or not, {tier}{of_scheme(scheme)}".replace("`", "")
        figures["solvability"] = roc_figure(panels, title)
        blocks += [
            "![Recall of solvable groups against that of unsolvable ones](solvability.png)",
            "A curve is of the scores of all trainings together, a dot the mean of the trainings at the thresholds that validation chose.",
        ]
    return Report("solvability", "\n\n".join(blocks) + "\n", figures, metrics, {"solvability-groups": _group_rows(frames)})


def _about(scheme: SplitScheme) -> str:
    in_paper = f" Paper: {paper.SOLVABILITY_SOURCE}." if scheme is SplitScheme.SCENE else ""
    return (
        "A group is solvable when it holds a success; its score is the largest predicted success probability in it. AUROC needs no"
        " threshold. For the other columns a group is called solvable from the threshold on that has the best balanced accuracy on the"
        " validation split, each training its own (their mean is shown). Numbers are percentages and means over the trainings; intervals"
        " are 95 %, for scenes whose groups are alike and for trainings that differ (of one training: for this very one). Where fewer than"
        f" {MIN_SCENES} scenes hold a kind of group, that of the AUROC is a score interval for as many groups as scenes. A dash means that"
        f" a split lacks one of the two kinds. Groups without candidates are left out.{in_paper}"
    )


def solvability_of(test: Sequence[pl.DataFrame], known: Sequence[pl.DataFrame], seed: int, name: str) -> Solvability:
    """Judge what each training of a policy says of groups.

    Args:
        test: the groups that are judged, as `best_of_groups` has them, one frame a training.
        known: those of the validation split, which choose the threshold; empty for none.
        seed: of the resampling.
        name: of the policy.
    """
    scores, labels = np.stack([own["best"].to_numpy() for own in test]), test[0]["success"].to_numpy()
    scene_ids = test[0]["scene_id"].to_list()
    chosen = [best_threshold(own["best"].to_numpy(), own["success"].to_numpy()) for own in known]
    thresholds = tuple(value for value in chosen if value is not None)
    area = auroc_estimate(scores, labels, scene_ids, seed, name)
    if not thresholds or area is None:
        return Solvability(scores, labels, thresholds, area)
    is_called, scenes = scores >= np.array(thresholds)[:, None], np.array(scene_ids)
    recalls = (proportion(right[:, kind], scenes[kind].tolist()) for right, kind in ((is_called, labels), (~is_called, ~labels)))
    return Solvability(scores, labels, thresholds, area, *recalls)


def best_of_groups(candidates: pl.DataFrame, task: Task, split: Split) -> pl.DataFrame:
    """The largest `score` of each group of a split as `best`, and whether it holds a `success`."""
    own = candidates.filter(pl.col("split") == split.value)
    return own.group_by(task.group).agg(pl.col("score").max().alias("best"), pl.col("success").any()).sort(task.group)


def _judged(policy: Policy, trainings: Sequence[pl.DataFrame], task: Task, seed: int) -> Solvability:
    test, known = ([_p_succ(best_of_groups(own, task, split)) for own in trainings] for split in (Split.TEST, Split.VALIDATION))
    return solvability_of(test, known, seed, policy.name)


def _p_succ(groups: pl.DataFrame) -> pl.DataFrame:
    return groups.with_columns(pl.col("best").exp())


def _paper_row(task: Task) -> list[object]:
    theirs = paper.SOLVABILITY[task]
    percentages = (theirs.auroc, theirs.balanced_accuracy, theirs.recall_solvable, theirs.recall_unsolvable)
    cells = [None if value is None else f"{value:.2f}" for value in percentages]
    n = theirs.n_solvable + theirs.n_unsolvable
    return ["paper", f"{n:,}", f"{theirs.n_solvable:,}", f"{theirs.n_unsolvable:,}", *cells, None]


def _panel(judged: Mapping[Policy, Solvability], task: Task, *, is_paper: bool) -> RocPanel:
    """Recalls at every threshold, of the scores of all trainings together."""
    curves = []
    for policy, own in judged.items():
        scores, labels = own.scores.ravel(), np.tile(own.labels, len(own.scores))
        steps = np.concatenate([np.unique(scores), [np.inf]])[::-1]
        recall_true = 1.0 - np.searchsorted(np.sort(scores[labels]), steps) / max(1, labels.sum())
        recall_false = np.searchsorted(np.sort(scores[~labels]), steps) / max(1, (~labels).sum())
        chosen = own.recall_solvable, own.recall_unsolvable
        dot = (chosen[0].value, chosen[1].value) if chosen[0] and chosen[1] else None
        curves.append(RocCurve(policy.label, recall_true, recall_false, dot))
    theirs = paper.SOLVABILITY[task]
    has_point = is_paper and theirs.recall_solvable is not None and theirs.recall_unsolvable is not None
    return RocPanel(curves, (theirs.recall_solvable or 0.0, theirs.recall_unsolvable or 0.0) if has_point else None)


def _group_rows(frames: Mapping[Policy, Mapping[int, pl.DataFrame]]) -> list[dict[str, object]]:
    """What is plotted: the largest p_succ of every test group."""
    return [
        {"task": task.value, "policy": policy.name, "seed": seed, "scene_id": row["scene_id"], "target_id": row.get("target_id"),
         "p_max": row["best"], "is_solvable": row["success"]}
        for task in Task for policy, own in frames.items() for seed, frame in own.items()
        for row in _p_succ(best_of_groups(frame, task, Split.TEST)).iter_rows(named=True)
    ]  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    def make(asked: Asked) -> Report:
        assert asked.predictions is not None
        return solvability_report(asked.tables, asked.predictions, tier=asked.tier, seed=asked.seed, scheme=asked.scheme)

    return report_command("solvability", make, arguments, needs=(Split.VALIDATION, Split.TEST), needs_predictions=True)


if __name__ == "__main__":
    sys.exit(main())
