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
from reports.entries import Entry, differences, entry_of, flat, prediction_frames
from reports.figures import dots_figure
from reports.letters import letter_display
from reports.load import Task, candidate_frame, group_frame, of_scheme, scheme_note
from reports.metrics import MIN_SCENES, coverage, spread_of
from reports.policies import RANKER, Policy, prediction_seeds
from reports.ranking import TASK_TITLE, rank_groups, timing_frame
from reports.report import Report, ReportError
from reports.resampling import SceneBootstrap, pairs_that_differ
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
        seed: seed of the hash order and the resampling.
        scheme: by what scenes are dealt to the splits; the one that the rankers were trained under.

    Raises:
        ReportError: no prediction of any variant, or a validation candidate without one.
    """
    frame = candidate_frame(tables, seed, scheme).filter(pl.col("split") == "validation")
    scores = frame_of(predictions)
    seeds = {variant: prediction_seeds(predictions, variant) for variant in VARIANTS}
    if not any(seeds.values()):
        raise ReportError(f"predictions: 0 rows of the variants {list(VARIANTS)}, must be at least 1")
    trained = {variant: _entries(frame, scores, variant) for variant, own in seeds.items() if own}
    compared = {measure: _compared(trained, measure, seed) for measure in _MEASURES}
    letters = {measure: own for measure, (own, _) in compared.items()}
    is_in_paper = scheme is SplitScheme.SCENE

    rows: list[list[str | None]] = []
    metrics = {name: value for _, own in compared.values() for name, value in own.items()}
    values: dict[str, list[list[float]]] = {}
    for variant, label in VARIANTS.items():
        cells: list[str | None] = [label, ", ".join(map(str, seeds[variant])) or None]
        values[variant] = [trained[variant][task].s_by_training(k) if variant in trained else [] for task, k in _MEASURES]
        for (task, k), own, theirs in zip(_MEASURES, values[variant], paper.ABLATION[variant], strict=True):
            spread, estimate = spread_of(own), trained[variant][task].s(k) if own else None
            interval = "" if estimate is None else f" [{100 * estimate.low:.1f}, {100 * estimate.high:.1f}]"
            cells += [
                None if spread is None else f"{spread}{interval}",
                str(theirs) if is_in_paper else None,
                letters[task, k].get(variant),
            ]
            metrics |= flat(f"{variant}.{_name((task, k))}", estimate)
        rows.append(cells)
        metrics[f"{variant}.n_seeds"] = float(len(seeds[variant]))
    header = ["variant", "seeds", *(cell for measure in _MEASURES for cell in (_title(measure), "paper", "differs"))]
    panels = {
        _title(measure): {label: (values[v][i], paper.ABLATION[v][i].mean if is_in_paper else None) for v, label in VARIANTS.items()}
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


def _entries(frame: pl.DataFrame, scores: pl.DataFrame, variant: str) -> dict[Task, Entry]:
    """A variant as a policy, by task."""
    policy = Policy(variant, VARIANTS[variant], RANKER.keys, variant=variant)
    frames = prediction_frames(frame, scores, variant)
    return {task: entry_of(policy, task, frames, timing_frame({})) for task in Task}


def _compared(trained: Mapping[str, Mapping[Task, Entry]], measure: tuple[Task, int], seed: int) -> tuple[dict[str, str], dict[str, float]]:
    """Letters by variant, the best first, and the differences of all pairs; neither where there are too few scenes to tell."""
    task, k = measure
    bootstrap = SceneBootstrap(next(iter(trained.values()))[task].scene_ids, seed)
    if not bootstrap.is_telling:
        return {}, {}
    means = {variant: entries[task].s_draws(k, bootstrap) for variant, entries in trained.items()}
    letters = letter_display(sorted(means, key=lambda variant: -means[variant].value), pairs_that_differ(means))
    return letters, differences(means, _name(measure))


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
    spread += ", with the 95 % interval of the mean"
    warning = f" **Only {n_scenes} scenes: differences between variants mean little.**" if n_scenes < MIN_SCENES else ""
    return (
        f"S_K on covered groups in percent, {spread}. {'; '.join(sizes)}.{warning} *Paper* is {paper.ABLATION_SOURCE}. Variants are"
        " compared here so that the test split takes no part in choosing between them. Two that share a letter do not differ at 95 %,"
        " all pairs judged together, scenes resampled and the error of few trainings added."
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
