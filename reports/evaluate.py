"""Anyone's ranker on a release, beside the policies that learn nothing: S_K, paired differences, hard groups, solvability, calibration.

`python -m reports.evaluate PREDICTIONS.parquet --release data/release/pilot [--split object] [--out DIR]`

The file has `candidate_id` and `score`, or `log_p_plan` and `log_p_exec`, or `p_plan` and `p_exec`, for every candidate of the test split.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import polars as pl
import pyarrow as pa

from model.settings import scheme_named
from pipelines.frames import frame_of
from reports.calibration import COLUMNS, N_BINS, Fit, Judged, row_of
from reports.entries import FIRST_RANK, Entry, entries_of, entry_of, flat, hard_groups, random_first_rank, random_mean, shown_rank
from reports.load import Task, candidate_frame, check_parts, group_frame, of_scheme, scheme_note
from reports.metrics import HARD, MIN_SCENES, coverage, expected_random_success, is_hard
from reports.policies import FULL_PLANNER, IK_AND_GRIPPER, IK_ONLY, Policy
from reports.ranking import KS, TASK_TITLE, timing_frame
from reports.report import Report
from reports.resampling import Draws, SceneBootstrap
from reports.solvability import HEADER as SOLVABILITY_HEADER
from reports.solvability import best_of_groups, solvability_of
from reports.sources import Sources, folder_beside
from reports.submission import Submission, read_submission
from splits.markdown import table
from splits.release_reader import Release
from tables.errors import PlaceBenchError
from tables.vocabulary import Split, SplitScheme

SUBMISSION = Policy("submission", "**Submission**", (-pl.col("score"),), variant="submission")
_NEEDED = ("candidates", "splits", "scenes", "targets", "policy_features")
_BASELINES = (IK_ONLY, IK_AND_GRIPPER, FULL_PLANNER)


@dataclass(frozen=True, slots=True, eq=False)
class _Inputs:
    """What every section reads; frames are of the test split."""

    submission: Submission
    scheme: SplitScheme
    seed: int
    plain: pl.DataFrame
    submitted: pl.DataFrame
    committed: pl.DataFrame | None


def evaluation_report(
    tables: Mapping[str, pa.Table],
    submission: Submission,
    committed: pa.Table | None = None,
    *,
    release: str,
    seed: int,
    scheme: SplitScheme = SplitScheme.SCENE,
) -> Report:
    """Report `evaluation`.

    Args:
        tables: `candidates`, `splits`, `scenes`, `targets`, `policy_features` of a release.
        submission: predictions that were checked against it.
        committed: rows of `predictions` of networks and trees to stand beside it, trained under the same scheme; None for none.
        release: tier and hash, printed in the title.
        seed: of the hash order and the resampling.
        scheme: by what scenes are dealt to the splits.
    """
    frame = candidate_frame(tables, seed, scheme)
    scored = frame.join(submission.frame, on="candidate_id", how="left").sort("candidate_id")
    test = pl.col("split") == Split.TEST.value
    inputs = _Inputs(submission, scheme, seed, frame.filter(test), scored.filter(test), None if committed is None else frame_of(committed))
    blocks = [f"# {submission.path.name} on {release}{of_scheme(scheme)}, test split", *scheme_note(scheme), _about(inputs)]
    metrics: dict[str, float] = {}
    for task in Task:
        section, values = _task_section(inputs, group_frame(tables, task, scheme).filter(test), task)
        blocks += section
        metrics |= values
    for section, values in (_solvability(inputs, scored), _calibration(inputs)):
        blocks += section
        metrics |= values
    return Report("evaluation", "\n\n".join(blocks) + "\n", metrics=metrics)


def _about(inputs: _Inputs) -> str:
    return (
        f"Candidates are ordered by {inputs.submission.ordered_by}, larger first; ties are broken by the candidate's hash, as in every"
        " policy. A group is *covered* when it holds a success; S_K is the share of covered groups with a success among the first K tried."
        " Intervals are 95 % and take into account that groups of a scene are alike; differences are paired over groups and resampled by"
        " scene. *Random, mean* is the mean over all orders. Learned policies of the release are means over their trainings."
    )


def _task_section(inputs: _Inputs, groups: pl.DataFrame, task: Task) -> tuple[list[str], dict[str, float]]:
    no_timings = timing_frame({})
    submitted = entry_of(SUBMISSION, task, inputs.submitted, no_timings)
    others = entries_of(inputs.plain, inputs.committed, task, no_timings)
    covered = coverage(groups, submitted.rankings[0].ranks, task)
    blocks = [
        f"## {TASK_TITLE[task]}",
        f"{groups.height:,} groups of {groups['scene_id'].n_unique():,} scenes; {submitted.covered.height:,} are covered ({covered} %).",
    ]
    prefix = f"test.{task.value}"
    metrics = {f"{prefix}.n_groups": float(groups.height), f"{prefix}.n_covered": float(submitted.covered.height)}
    if submitted.covered.is_empty():
        return [*blocks, "Nothing can be ranked well or badly here."], metrics
    rows, values = _policies(submitted, others, prefix)
    hard_title = f"S1, {HARD[0]} or {HARD[1]} successes (n = {submitted.covered.filter(is_hard()).height:,})"
    blocks.append(table(["policy", *(f"S{k} [95 %]" for k in KS), hard_title], rows))
    section, more = _differences(submitted, others, inputs.seed, prefix)
    return [*blocks, *section], metrics | values | more


def _policies(submitted: Entry, others: Sequence[Entry], prefix: str) -> tuple[list[list[object]], dict[str, float]]:
    entries = [submitted, *others]
    hard = hard_groups(entries)
    ranks = submitted.rankings[0].ranks
    expected = [expected_random_success(own, k) for own, k in (*((ranks, k) for k in KS), (ranks.filter(is_hard()), 1))]
    rows: list[list[object]] = [["Random, mean", *expected]]
    metrics: dict[str, float] = {}
    for k, own_mean in zip(KS, expected, strict=False):
        metrics |= flat(f"{prefix}.random.s{k}_expected", own_mean)
    for entry in entries:
        own = {k: entry.s(k) for k in KS}
        rows.append([entry.policy.label, *own.values(), hard[entry.policy.name]])
        name = f"{prefix}.{entry.policy.name}"
        for k, estimate in own.items():
            metrics |= flat(f"{name}.s{k}", estimate)
        metrics |= flat(f"{name}.hard_s1", hard[entry.policy.name])
    return [rows[1], rows[0], *rows[2:]], metrics


def _differences(submitted: Entry, others: Sequence[Entry], seed: int, prefix: str) -> tuple[list[str], dict[str, float]]:
    """S_K and mean first rank of the submission minus those of whom it is compared with, on the same groups."""
    bootstrap = SceneBootstrap(submitted.scene_ids, seed)
    if not bootstrap.is_telling:
        return [f"Differences between policies: not estimated below {MIN_SCENES} scenes, there are {bootstrap.n_scenes}."], {}
    ours = {k: submitted.s_draws(k, bootstrap) for k in KS}
    our_rank = submitted.rank_draws(bootstrap)
    compared: dict[str, tuple[str, dict[int, Draws], Draws]] = {
        "random_mean": (
            "Random, mean",
            {k: random_mean(submitted, k, bootstrap) for k in KS},
            random_first_rank(submitted, bootstrap),
        )
    }
    for entry in others:
        if entry.policy in _BASELINES or entry.policy.is_learned:
            theirs = {k: entry.s_draws(k, bootstrap) for k in KS}
            compared[entry.policy.name] = (entry.policy.label, theirs, entry.rank_draws(bootstrap))
    rows: list[list[object]] = []
    metrics = flat(f"{prefix}.{SUBMISSION.name}.{FIRST_RANK}", our_rank.estimate())
    for name, (label, theirs, their_rank) in compared.items():
        gains = {k: (ours[k] - theirs[k]).estimate() for k in KS}
        rank_gain = (our_rank - their_rank).estimate()
        rows.append([label, *gains.values(), shown_rank(rank_gain)])
        for k, gain in gains.items():
            metrics |= flat(f"{prefix}.{SUBMISSION.name}_minus_{name}.s{k}", gain)
        metrics |= flat(f"{prefix}.{SUBMISSION.name}_minus_{name}.{FIRST_RANK}", rank_gain)
    header = ["submission minus", *(f"S{k}, points [95 %]" for k in KS), "rank of the first success, mean [95 %]"]
    text = f"The submission's first success is at rank {shown_rank(our_rank.estimate())} of a covered group, on average; fewer is better."
    return [text, table(header, rows)], metrics


def _solvability(inputs: _Inputs, scored: pl.DataFrame) -> tuple[list[str], dict[str, float]]:
    """Whether the largest score of a group tells those with a success from those without."""
    rows: list[list[object]] = []
    metrics: dict[str, float] = {}
    has_threshold = Split.VALIDATION.value in inputs.submission.splits
    for task in Task:
        known = [best_of_groups(scored, task, Split.VALIDATION)] if has_threshold else []
        own = solvability_of([best_of_groups(inputs.submitted, task, Split.TEST)], known, inputs.seed, SUBMISSION.name)
        rows.append([task.value, *own.cells()])
        metrics |= own.metrics(f"test.{task.value}.{SUBMISSION.name}.solvability")
    how = (
        "The threshold is the one with the best balanced accuracy on the validation split."
        if has_threshold
        else "The validation split is not predicted, so there is no threshold to choose there."
    )
    text = (
        f"A group's score is the largest in it; groups without candidates are left out. {how} A dash means that a split lacks one of"
        " the two kinds of group."
    )
    return ["## Solvability", text, table(["task", *SOLVABILITY_HEADER], rows)], metrics


def _calibration(inputs: _Inputs) -> tuple[list[str], dict[str, float]]:
    if not inputs.submission.has_probabilities:
        return ["## Calibration", "No probabilities were given, so there is nothing to say about them."], {}
    frame, rows = inputs.submitted, []
    metrics: dict[str, float] = {}
    judged = {
        "plan": (frame, pl.col("p_plan"), "y_plan"),
        "exec": (frame.filter("y_plan"), pl.col("p_exec"), "success"),
        "success": (frame, pl.col("p_plan") * pl.col("p_exec"), "success"),
    }
    for name, (own, probability, happened) in judged.items():
        if own.is_empty():
            continue
        p = own.select(probability).to_series().to_numpy()
        of = Judged(p[None], own[happened].to_numpy(), own["scene_id"].to_list())
        fit, prefix = Fit.of(of, inputs.seed, SUBMISSION.name), f"test.{SUBMISSION.name}.calibration.{name}"
        rows.append([*row_of(name, of, fit), f"{of.brier_of_rate:.4f}"])
        metrics |= fit.metrics(prefix) | {f"{prefix}.rate": of.rate}
    text = (
        f"ECE is over {N_BINS} bins of equal width. The last column is the Brier score of whoever says the rate of this split for every"
        " candidate: a probability with a higher one knows less than that."
    )
    return ["## Calibration", text, table([*COLUMNS, "Brier score of the rate"], rows)], metrics


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line: 0, or 1 with one line on standard error where the release or the predictions are not what they should be."""
    about, _, more = (__doc__ or "").partition("\n")
    parser = argparse.ArgumentParser(prog="python -m reports.evaluate", description=about, epilog=more.rpartition("\n\n")[2])
    parser.add_argument("predictions", type=Path, help="Parquet file")
    parser.add_argument("--release", type=Path, required=True, help="folder of a release, whole or light")
    parser.add_argument("--split", default=SplitScheme.SCENE.value, help=f"one of {', '.join(scheme.value for scheme in SplitScheme)}")
    parser.add_argument("--beside", type=Path, metavar="DIR", help="folder of the tables about the release, with its own predictions")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for evaluation.md and evaluation.json")
    options = parser.parse_args(arguments)
    try:
        scheme = scheme_named(options.split)
        release = Release.open(options.release)
        manifest, tables = release.manifest, release.tables(*_NEEDED)
        check_parts(tables, scheme, (Split.TEST,))
        candidates = release.candidates.select("candidate_id", pl.col(scheme.column).alias("split"))
        submission = read_submission(options.predictions, candidates, manifest.release_hash, scheme)
        sources = Sources(release, options.beside or folder_beside(options.release, manifest.tier, scheme), scheme=scheme)
        title = f"{manifest.tier} {manifest.version} ({manifest.release_hash[:12]})"
        report = evaluation_report(tables, submission, sources.scores(), release=title, seed=sources.seed, scheme=scheme)
        if options.out is not None:
            report.write(options.out)
    except PlaceBenchError as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        return 1
    print(report.markdown)
    return 0


if __name__ == "__main__":
    sys.exit(main())
