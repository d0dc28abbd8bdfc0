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
from reports.metrics import MIN_SCENES, Estimate, best_threshold, proportion
from reports.policies import LEARNED, Policy
from reports.ranker_figures import RocCurve, RocPanel, roc_figure
from reports.ranking import TASK_TITLE
from reports.report import Report, ReportError
from reports.resampling import Draws, SceneBootstrap, auroc_draws
from splits.markdown import table
from tables.vocabulary import Split, SplitScheme


@dataclass(frozen=True, slots=True, eq=False)
class Solvability:
    """How the largest p_succ of a group tells groups with a success from those without, over the trainings of a policy.

    Attributes:
        scores: of each group, a row a training.
        labels: whether a group holds a success.
        thresholds: of each training; none where the validation split lacks a kind of group.
        area: None where the test split lacks a kind.
    """

    scores: Float[np.ndarray, "r n"]
    labels: Bool[np.ndarray, "n"]
    scene_ids: list[str]
    thresholds: tuple[float, ...]
    area: Draws | None
    balanced_accuracy: Draws | None
    recall_solvable: Estimate | None
    recall_unsolvable: Estimate | None
    is_telling: bool


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
        judged = {policy: _solvability(policy, list(own.values()), task, seed) for policy, own in frames.items()}
        rows = [_row(policy, own) for policy, own in judged.items()] + ([_paper_row(task)] if scheme is SplitScheme.SCENE else [])
        header = [
            "", "groups", "solvable", "unsolvable", "AUROC [95 %]", "balanced accuracy [95 %]", "recall solvable [95 %]",
            "recall unsolvable [95 %]", "threshold",
        ]  # fmt: skip
        blocks += [f"## {TASK_TITLE[task]}", table(header, rows)]
        for policy, solved in judged.items():
            metrics |= _metrics(solved, f"test.{task.value}.{policy.name}.solvability")
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
        f" are 95 %, scenes and trainings resampled, none below {MIN_SCENES} scenes but for recalls. A dash means that a split lacks one of"
        f" the two kinds of group. Groups without candidates are left out.{in_paper}"
    )


def _solvability(policy: Policy, trainings: Sequence[pl.DataFrame], task: Task, seed: int) -> Solvability:
    test = [_groups(own, task, Split.TEST) for own in trainings]
    scores, labels = np.stack([own["p_max"].to_numpy() for own in test]), test[0]["success"].to_numpy()
    scene_ids = test[0]["scene_id"].to_list()
    known = [_groups(own, task, Split.VALIDATION) for own in trainings]
    chosen = [best_threshold(own["p_max"].to_numpy(), own["success"].to_numpy()) for own in known]
    thresholds = tuple(value for value in chosen if value is not None)
    bootstrap = SceneBootstrap(scene_ids, seed)
    areas = [own for row in scores if (own := auroc_draws(row, labels, bootstrap)) is not None]
    area = bootstrap.mean_of(areas, policy.name) if areas else None
    balanced = solvable = unsolvable = None
    if thresholds and area is not None:
        is_called = scores >= np.array(thresholds)[:, None]
        scenes = np.array(scene_ids)
        solvable = proportion(is_called[:, labels], scenes[labels].tolist())
        unsolvable = proportion(~is_called[:, ~labels], scenes[~labels].tolist())
        balanced = balanced_accuracy_draws(is_called, labels, bootstrap, policy.name)
    return Solvability(scores, labels, scene_ids, thresholds, area, balanced, solvable, unsolvable, bootstrap.is_telling)


def balanced_accuracy_draws(
    is_called: Bool[np.ndarray, "r n"], labels: Bool[np.ndarray, "n"], bootstrap: SceneBootstrap, name: str
) -> Draws:
    """Mean of the recalls of both kinds of unit, of which there must be some; draws without one of them are left out.

    Args:
        is_called: what each training calls true.
        labels: what is.
        bootstrap: of the scenes of the units.
        name: of the policy that was trained.
    """
    n_true, n_false = bootstrap.mean(labels), bootstrap.mean(~labels)
    right_true, right_false = bootstrap.mean(is_called & labels, name), bootstrap.mean(~is_called & ~labels, name)
    is_defined = (n_true.draws > 0.0) & (n_false.draws > 0.0)
    draws = (right_true.draws[is_defined] / n_true.draws[is_defined] + right_false.draws[is_defined] / n_false.draws[is_defined]) / 2
    value = (right_true.value / n_true.value + right_false.value / n_false.value) / 2
    return Draws(value, draws, len(labels), bootstrap.n_scenes)


def _groups(candidates: pl.DataFrame, task: Task, split: Split) -> pl.DataFrame:
    return (
        candidates.filter(pl.col("split") == split.value)
        .group_by(task.group)
        .agg(pl.col("score").max().exp().alias("p_max"), pl.col("success").any())
        .sort(task.group)
    )


def _row(policy: Policy, own: Solvability) -> list[object]:
    n, n_true = len(own.labels), int(own.labels.sum())
    threshold = f"{np.mean(own.thresholds):.3f}" if own.thresholds else None
    draws = (_shown(draws, own.is_telling) for draws in (own.area, own.balanced_accuracy))
    return [policy.label, f"{n:,}", f"{n_true:,}", f"{n - n_true:,}", *draws, own.recall_solvable, own.recall_unsolvable, threshold]


def _shown(draws: Draws | None, is_telling: bool) -> str | None:
    return None if draws is None else str(draws.estimate()) if is_telling else f"{100 * draws.value:.1f}"


def _paper_row(task: Task) -> list[object]:
    theirs = paper.SOLVABILITY[task]
    percentages = (theirs.auroc, theirs.balanced_accuracy, theirs.recall_solvable, theirs.recall_unsolvable)
    cells = [None if value is None else f"{value:.2f}" for value in percentages]
    n = theirs.n_solvable + theirs.n_unsolvable
    return ["paper", f"{n:,}", f"{theirs.n_solvable:,}", f"{theirs.n_unsolvable:,}", *cells, None]


def _metrics(own: Solvability, prefix: str) -> dict[str, float]:
    metrics = {f"{prefix}.n_solvable": float(own.labels.sum()), f"{prefix}.n_unsolvable": float((~own.labels).sum())}
    for name, draws in (("auroc", own.area), ("balanced_accuracy", own.balanced_accuracy)):
        if draws is not None:
            metrics |= flat(f"{prefix}.{name}", draws.estimate()) if own.is_telling else {f"{prefix}.{name}": draws.value}
    metrics |= flat(f"{prefix}.recall_solvable", own.recall_solvable) | flat(f"{prefix}.recall_unsolvable", own.recall_unsolvable)
    return metrics | ({f"{prefix}.threshold": float(np.mean(own.thresholds))} if own.thresholds else {})


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
         "p_max": row["p_max"], "is_solvable": row["success"]}
        for task in Task for policy, own in frames.items() for seed, frame in own.items()
        for row in _groups(frame, task, Split.TEST).iter_rows(named=True)
    ]  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    def make(asked: Asked) -> Report:
        assert asked.predictions is not None
        return solvability_report(asked.tables, asked.predictions, tier=asked.tier, seed=asked.seed, scheme=asked.scheme)

    return report_command("solvability", make, arguments, needs=(Split.VALIDATION, Split.TEST), needs_predictions=True)


if __name__ == "__main__":
    sys.exit(main())
