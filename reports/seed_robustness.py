"""Report of the trainings of every learned policy: S_K of each, mean and standard deviation, on the validation and test splits.

`python -m reports.seed_robustness data/release/pilot --predictions FILE ... [--split object] [--out DIR]`
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence

import polars as pl
import pyarrow as pa

from pipelines.frames import frame_of
from reports import paper
from reports.command import Asked, report_command
from reports.entries import Entry, flat, learned_entries
from reports.figures import dots_figure
from reports.load import Task, candidate_frame, group_frame, of_scheme, scheme_note
from reports.metrics import coverage, spread_of
from reports.policies import RANKER
from reports.ranking import KS, TASK_TITLE, timing_frame
from reports.report import Report, ReportError
from splits.markdown import table
from tables.vocabulary import Split, SplitScheme

_SPLITS = (Split.VALIDATION, Split.TEST)


def seed_robustness_report(
    tables: Mapping[str, pa.Table], predictions: pa.Table, *, tier: str, seed: int, scheme: SplitScheme = SplitScheme.SCENE
) -> Report:
    """Report `seed_robustness`.

    Args:
        tables: `candidates`, `splits`, `scenes`, `targets`, `policy_features` of a release.
        predictions: rows of any learned policies, any trainings.
        tier: printed in the title.
        seed: of the hash order and the resampling.
        scheme: by what scenes are dealt to the splits; the one that the policies were trained under.

    Raises:
        ReportError: predictions of no learned policy.
    """
    frame, scores = candidate_frame(tables, seed, scheme), frame_of(predictions)
    is_paper = scheme is SplitScheme.SCENE
    text = (
        "Mean ± sample standard deviation over the trainings, in percent; a single training has no deviation. In brackets the 95 % interval"
        " of the mean, which takes into account that the groups of a scene are alike and that trainings differ. Every training orders the"
        f" same groups.{_about_paper(is_paper)}"
    )
    blocks = [f"# Trainings of the learned policies on tier {tier}{of_scheme(scheme)}", *scheme_note(scheme), text]
    points: list[dict[str, object]] = []
    metrics: dict[str, float] = {}
    panels: dict[str, dict[str, tuple[Sequence[float], float | None]]] = {}
    for split, task in ((split, task) for split in _SPLITS for task in Task):
        entries = learned_entries(frame.filter(pl.col("split") == split.value), scores, task, timing_frame({}))
        if not entries:
            raise ReportError("predictions: 0 learned policies, must be at least 1")
        groups = group_frame(tables, task, scheme).filter(pl.col("split") == split.value)
        covered = coverage(groups, entries[0].rankings[0].ranks, task)
        blocks += [
            f"## {TASK_TITLE[task]}, {split.value}",
            f"Coverage {covered} %, {entries[0].covered.height:,} groups"
            + (f"; paper {paper.COVERAGE[split.value, task]:.2f} %." if is_paper else "."),
            table(
                ["policy", "trainings", *(cell for k in KS for cell in (f"S{k}", "paper"))],
                [_row(entry, split, is_paper) for entry in entries],
            ),
        ]
        metrics |= flat(f"{split.value}.{task.value}.coverage", covered)
        for entry in entries:
            metrics |= _metrics(entry, f"{split.value}.{task.value}.{entry.policy.name}")
            points += _points(entry, split)
        dots: dict[str, tuple[Sequence[float], float | None]] = {
            entry.policy.label: (entry.s_by_training(1), _in_paper(entry, split, is_paper)) for entry in entries
        }
        panels[f"$S_1$, {split.value}, {task.value}"] = dots
    figure = dots_figure(panels, f"Every training, {tier}{of_scheme(scheme)}".replace("`", ""), "covered groups [%]")
    blocks += ["![S1 of every training](seed_robustness.png)", "## Every training", _each(points)]
    return Report(
        "seed_robustness", "\n\n".join(blocks) + "\n", {"seed_robustness": figure}, metrics, {"seed_robustness-trainings": points}
    )


def _about_paper(is_paper: bool) -> str:
    return f" Paper: {paper.SEEDS_SOURCE}; S_K of its ranker, with the labels of its own planner and physics." if is_paper else ""


def _row(entry: Entry, split: Split, is_paper: bool) -> list[object]:
    cells: list[object] = []
    for number, k in enumerate(KS):
        spread, estimate = spread_of(entry.s_by_training(k)), entry.s(k)
        interval = "" if estimate is None else f" [{100 * estimate.low:.1f}, {100 * estimate.high:.1f}]"
        theirs = paper.SEEDS[split.value, entry.task][number] if is_paper and entry.policy is RANKER else None
        cells += [None if spread is None else f"{spread}{interval}", theirs]
    return [entry.policy.label, ", ".join(map(str, entry.seeds)), *cells]


def _in_paper(entry: Entry, split: Split, is_paper: bool) -> float | None:
    return paper.SEEDS[split.value, entry.task][0].mean if is_paper and entry.policy is RANKER else None


def _metrics(entry: Entry, prefix: str) -> dict[str, float]:
    metrics = {f"{prefix}.n_trainings": float(len(entry.seeds))}
    for k in KS:
        metrics |= flat(f"{prefix}.s{k}", entry.s(k))
        spread = spread_of(entry.s_by_training(k))
        if spread is not None and spread.deviation is not None:
            metrics[f"{prefix}.s{k}_sd"] = spread.deviation / 100.0
        metrics |= {f"{prefix}.s{k}_seed_{own}": s / 100.0 for own, s in zip(entry.seeds, entry.s_by_training(k), strict=False)}
    return metrics


def _points(entry: Entry, split: Split) -> list[dict[str, object]]:
    shares = {k: [s / 100.0 for s in entry.s_by_training(k)] for k in KS}
    where = {"split": split.value, "task": entry.task.value, "policy": entry.policy.name}
    rows = zip(entry.seeds, *shares.values(), strict=False)  # no shares where no group is covered
    return [{**where, "seed": own, **{f"s{k}": s for k, s in zip(KS, row, strict=True)}} for own, *row in rows]


def _each(points: Sequence[Mapping[str, object]]) -> str:
    shown = [*("split", "task", "policy", "seed"), *(f"s{k}" for k in KS)]
    rows = [[f"{100 * value:.2f}" if isinstance(value, float) else value for value in map(point.get, shown)] for point in points]
    return table(["split", "task", "policy", "seed", *(f"S{k}" for k in KS)], rows, align="lllr" + "r" * len(KS))


def main(arguments: Sequence[str] | None = None) -> int:
    def make(asked: Asked) -> Report:
        assert asked.predictions is not None
        return seed_robustness_report(asked.tables, asked.predictions, tier=asked.tier, seed=asked.seed, scheme=asked.scheme)

    return report_command("seed_robustness", make, arguments, needs=_SPLITS, needs_predictions=True)


if __name__ == "__main__":
    sys.exit(main())
