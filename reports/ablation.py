"""Report of the model ablation: four variants on the validation split, over the seeds that were trained; the test split stays unread.

`python -m reports.ablation data/release/pilot --predictions FILE ... [--split object] [--out DIR]`
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence

import polars as pl
import pyarrow as pa

from pipelines.frames import frame_of
from reports import paper
from reports.command import Asked, report_command
from reports.figures import dots_figure
from reports.load import Task, candidate_frame, group_frame, of_scheme, scheme_note
from reports.metrics import MIN_SCENES, coverage, spread_of
from reports.policies import RANKER, prediction_seeds, with_predictions
from reports.ranking import KS, TASK_TITLE, rank_groups, timing_frame
from reports.report import Report, ReportError
from splits.markdown import table
from tables.vocabulary import Split, SplitScheme

VARIANTS = {
    "direct": "Direct final-success head",
    "no_object_relative": "Without object-relative pose",
    "no_target_hypothesis": "Without target-object hypothesis",
    "full": "Full hierarchical model",
}

# The columns of Table III of the paper, in its order.
_MEASURES = ((Task.JOINT, 1), (Task.FIXED, 1), (Task.FIXED, 5))


def ablation_report(
    tables: Mapping[str, pa.Table], predictions: pa.Table, *, tier: str, seed: int, scheme: SplitScheme = SplitScheme.SCENE
) -> Report:
    """Report `ablation`.

    Args:
        tables: a release: `candidates`, `splits`, `scenes`, `targets`, `policy_features`.
        predictions: table `predictions` with any of the four variants and any seeds.
        tier: printed in the title.
        seed: seed of the hash order.
        scheme: by what scenes are dealt to the splits; the one that the rankers were trained under.

    Raises:
        ReportError: no prediction of any variant, or a validation candidate without one.
    """
    frame = candidate_frame(tables, seed, scheme).filter(pl.col("split") == "validation")
    scores = frame_of(predictions)
    seeds = {variant: prediction_seeds(predictions, variant) for variant in VARIANTS}
    if not any(seeds.values()):
        raise ReportError(f"predictions: 0 rows of the variants {list(VARIANTS)}, must be at least 1")
    values = {variant: _values(frame, scores, variant, trained) for variant, trained in seeds.items()}
    is_in_paper = scheme is SplitScheme.SCENE

    rows: list[list[str | None]] = []
    metrics: dict[str, float] = {}
    for variant, label in VARIANTS.items():
        cells: list[str | None] = [label, ", ".join(map(str, seeds[variant])) or None]
        for measure, theirs in zip(_MEASURES, paper.ABLATION[variant], strict=True):
            spread = spread_of(values[variant][measure])
            cells += [None if spread is None else str(spread), str(theirs) if is_in_paper else None]
            if spread is not None:
                metrics[f"{variant}.{_name(measure)}"] = spread.mean / 100
        rows.append(cells)
        metrics[f"{variant}.n_seeds"] = float(len(seeds[variant]))
    header = ["variant", "seeds", *(cell for measure in _MEASURES for cell in (_title(measure), "paper"))]
    panels = {
        _title(measure): {label: (values[v][measure], paper.ABLATION[v][i].mean if is_in_paper else None) for v, label in VARIANTS.items()}
        for i, measure in enumerate(_MEASURES)
    }
    blocks = [
        f"# Ablation on tier {tier}{of_scheme(scheme)}, validation split",
        *scheme_note(scheme),
        _about(tables, frame, seeds, scheme),
        table(header, rows, align="ll" + "r" * (len(header) - 2)),
        "![S_K of four variants of the ranker](ablation.png)",
    ]
    figures = {"ablation": dots_figure(panels, f"Ablation, {tier}{of_scheme(scheme)}, validation".replace("`", ""), "covered groups [%]")}
    return Report("ablation", "\n\n".join(blocks) + "\n", figures, metrics)


def _values(frame: pl.DataFrame, scores: pl.DataFrame, variant: str, seeds: list[int]) -> dict[tuple[Task, int], list[float]]:
    """Percentages by task and K, one a seed."""
    values: dict[tuple[Task, int], list[float]] = {(task, k): [] for task in Task for k in KS}
    for training_seed in seeds:
        scored = with_predictions(frame, scores, variant, training_seed)
        for task in Task:
            for k, estimate in rank_groups(scored, RANKER, task, timing_frame({})).s.items():
                values[task, k] += [] if estimate is None else [100 * estimate.value]
    return values


def _about(tables: Mapping[str, pa.Table], frame: pl.DataFrame, seeds: Mapping[str, list[int]], scheme: SplitScheme) -> str:
    no_rank = frame.with_columns(pl.lit(0.0).alias("score"))
    sizes = []
    n_scenes = 0
    for task in Task:
        groups = group_frame(tables, task, scheme).filter(pl.col("split") == "validation")
        ranking = rank_groups(no_rank, RANKER, task, timing_frame({}))
        covered = coverage(groups, ranking.ranks, task)
        n_scenes = ranking.covered["scene_id"].n_unique()
        in_paper = f", paper {paper.COVERAGE['validation', task]:.2f} %" if scheme is SplitScheme.SCENE else ""
        sizes.append(f"{TASK_TITLE[task].lower()} {ranking.covered.height:,} covered groups of {groups.height:,} ({covered} %{in_paper})")
    counts = {len(trained) for trained in seeds.values()}
    spread = "mean ± sample standard deviation over seeds" if max(counts) > 1 else "one seed a variant, so no deviation and no conclusion"
    warning = f" **Only {n_scenes} scenes: differences between variants mean little.**" if n_scenes < MIN_SCENES else ""
    return (
        f"S_K on covered groups in percent, {spread}. {'; '.join(sizes)}.{warning} *Paper* is {paper.ABLATION_SOURCE}. Variants are"
        " compared here so that the test split takes no part in choosing between them."
    )


def _title(measure: tuple[Task, int]) -> str:
    return f"{measure[0].value} S{measure[1]}"


def _name(measure: tuple[Task, int]) -> str:
    return f"{measure[0].value}.s{measure[1]}"


def main(arguments: Sequence[str] | None = None) -> int:
    def make(asked: Asked) -> Report:
        assert asked.predictions is not None, "the command line demands them"
        return ablation_report(asked.tables, asked.predictions, tier=asked.tier, seed=asked.seed, scheme=asked.scheme)

    return report_command("ablation", make, arguments, needs=(Split.VALIDATION,), needs_predictions=True)


if __name__ == "__main__":
    sys.exit(main())
