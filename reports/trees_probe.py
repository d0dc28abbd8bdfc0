"""How far derived geometry alone ranks: gradient-boosted trees beside the policies that learn nothing, on the same groups.

`python -m reports.trees_probe data/release/pilot [--split object | --cross-validate 5] [--seed 42] [--out DIR]`

A release whose trees are near 100 leaves nothing for a better ranker to show; that is what the probe is for.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import polars as pl
import pyarrow as pa

from model.features import CANDIDATE_GEOMETRY
from model.geometry import geometry_table
from model.settings import SCHEME_OF_PREDICTIONS, scheme_named
from model.trees import TreeData, TreeVariant, cross_validated_predictions, read_tree_data, split_predictions
from pipelines.frames import frame_of
from reports.load import Task, candidate_frame, check_parts, group_frame, load_release, of_scheme, scheme_note
from reports.metrics import (
    HARD,
    MIN_SCENES,
    Estimate,
    auroc,
    coverage,
    expected_random_success,
    group_ranks,
    is_hard,
    proportion,
    success_at_k,
)
from reports.policies import FULL_PLANNER, RANDOM, TREES, TREES_POSES, UNLEARNED, Policy, ranked, with_predictions
from reports.report import Report, ReportError
from reports.resampling import paired_difference
from splits.markdown import percent, table
from tables.errors import PlaceBenchError
from tables.schemas import PREDICTIONS
from tables.store import join_tables, write_table
from tables.vocabulary import Split, SplitScheme

_TREES = {TreeVariant.POSES: TREES_POSES, TreeVariant.GEOMETRY: TREES}


def tree_predictions(
    release_dir: Path, data: TreeData, seed: int, n_folds: int | None, scheme: SplitScheme = SplitScheme.SCENE
) -> pa.Table:
    """Table `predictions` of trees of both kinds: trained on the train split of a scheme, or cross-validated over all scenes."""
    if n_folds is None:
        return join_tables(PREDICTIONS, [split_predictions(release_dir, data, variant, seed, scheme) for variant in TreeVariant])
    return join_tables(PREDICTIONS, [cross_validated_predictions(data, variant, seed, n_folds) for variant in TreeVariant])


def trees_probe_report(
    tables: Mapping[str, pa.Table],
    predictions: pa.Table,
    *,
    split: str,
    seed: int,
    title: str,
    scheme: SplitScheme = SplitScheme.SCENE,
) -> Report:
    """Report `trees_probe`.

    Args:
        tables: `candidates`, `splits`, `scenes`, `targets`, `policy_features` of a release.
        predictions: rows of both kinds of trees of one seed.
        split: the split that is judged, or `all` where the predictions are cross-validated.
        seed: seed of the predictions, the hash order and the resampling.
        title: said in the heading.
        scheme: whose splits they are; the one that the trees were trained under.
    """
    frame = candidate_frame(tables, seed, scheme)
    scores = frame_of(predictions)
    frames: dict[Policy, pl.DataFrame] = {policy: _of_split(frame, split) for policy in UNLEARNED}
    for variant, policy in _TREES.items():
        frames[policy] = _of_split(with_predictions(frame, scores, variant.value, seed), split)
    ranks = {(policy, task): group_ranks(ranked(own, policy, task), task) for policy, own in frames.items() for task in Task}

    metrics: dict[str, float] = {}
    rows: list[list[object]] = [_expected_row(ranks)]
    for policy in frames:
        judged = {task.value: success_at_k(ranks[policy, task], 1) for task in Task}
        judged["fixed_hard"] = success_at_k(_hard(ranks[policy, Task.FIXED]), 1)
        rows.append([policy.label, *judged.values()])
        for name, estimate in judged.items():
            metrics |= _flat(f"{name}.{policy.name}.s1", estimate)
    heads, head_metrics = _heads(frames)
    gains, gain_metrics = _gains(ranks, seed)
    header = ["policy", "joint S1 [95 %]", "fixed S1 [95 %]", f"fixed S1, {HARD[0]} or {HARD[1]} successes"]
    facts = _facts({task: _of_split(group_frame(tables, task, scheme), split) for task in Task}, ranks)
    blocks = [
        f"# {title}{of_scheme(scheme)}",
        *scheme_note(scheme),
        *facts,
        table(header, rows),
        heads,
        gains,
        _misses(frames[_TREES[TreeVariant.GEOMETRY]]),
    ]
    return Report("trees_probe", "\n\n".join(blocks) + "\n", metrics=metrics | head_metrics | gain_metrics)


def _of_split(frame: pl.DataFrame, split: str) -> pl.DataFrame:
    return frame if split == "all" else frame.filter(pl.col("split") == split)


def _hard(ranks: pl.DataFrame) -> pl.DataFrame:
    return ranks.filter(is_hard())


def _facts(groups: Mapping[Task, pl.DataFrame], ranks: Mapping[tuple[Policy, Task], pl.DataFrame]) -> list[str]:
    """How many groups there are, how many hold a success, and how many successes a covered one has."""
    lines = []
    for task in Task:
        own = ranks[RANDOM, task]
        n_candidates, n_success = (own[name].to_numpy() for name in ("n_candidates", "n_success"))
        is_covered = n_success > 0
        line = (
            f"{task.value.capitalize()}: {own.height:,} groups of {own['scene_id'].n_unique()} scenes,"
            f" {n_candidates.sum() / max(1, own.height):.1f} candidates each"
            f"; covered {coverage(groups[task], own, task)} %."
        )
        if is_covered.any():
            rate = float((n_success / n_candidates)[is_covered].mean())
            line += f" A covered group has {np.median(n_success[is_covered]):g} successes (median), {percent(rate)} of its candidates."
        lines.append(line)
    lines.append(f"{_hard(ranks[RANDOM, Task.FIXED]).height:,} fixed groups have {HARD[0]} or {HARD[1]} successes.")
    return ["\n".join(f"- {line}" for line in lines)]


def _expected_row(ranks: Mapping[tuple[Policy, Task], pl.DataFrame]) -> list[object]:
    fixed = ranks[RANDOM, Task.FIXED]
    return ["Random, mean of all orders", *(expected_random_success(own, 1) for own in (ranks[RANDOM, Task.JOINT], fixed, _hard(fixed)))]


def _heads(frames: Mapping[Policy, pl.DataFrame]) -> tuple[str, dict[str, float]]:
    """AUROC of both heads over all candidates, and of the execution head within the fixed groups, where a ranking is decided."""
    rows: list[list[object]] = []
    metrics: dict[str, float] = {}
    for policy in _TREES.values():
        own = frames[policy]
        planned = own.filter("y_plan")
        areas = {
            "plan": auroc(own["log_p_plan"].to_numpy(), own["y_plan"].to_numpy()),
            "exec": auroc(planned["log_p_exec"].to_numpy(), planned["success"].to_numpy()),
            "exec_within": _within_groups(planned),
        }
        rows.append([policy.label, *(None if area is None else f"{area:.3f}" for area in areas.values())])
        metrics |= {f"{policy.name}.auroc_{name}": area for name, area in areas.items() if area is not None}
    return table(["AUROC", "plan", "exec given plan", "exec given plan, mean within fixed groups"], rows), metrics


def _within_groups(planned: pl.DataFrame) -> float | None:
    parts = planned.sort("candidate_id").partition_by(Task.FIXED.group, maintain_order=True)
    areas = [auroc(part["log_p_exec"].to_numpy(), part["success"].to_numpy()) for part in parts]
    known = [area for area in areas if area is not None]
    return float(np.mean(known)) if known else None


def _gains(ranks: Mapping[tuple[Policy, Task], pl.DataFrame], seed: int) -> tuple[str, dict[str, float]]:
    """S1 of the trees minus that of the planner that knows which plans exist, on the same groups."""
    lines: list[str] = []
    metrics: dict[str, float] = {}
    for task in Task:
        own, other = (ranks[policy, task].filter(pl.col("n_success") > 0) for policy in (_TREES[TreeVariant.GEOMETRY], FULL_PLANNER))
        hits = [(covered["first_success"] == 1).to_numpy() for covered in (own, other)]
        gain = paired_difference(hits[0], hits[1], own["scene_id"].to_list(), seed)
        shown = f"{gain} points" if gain is not None else f"not estimated below {MIN_SCENES} scenes"
        lines.append(f"- {task.value}: S1 of the trees on derived geometry minus the full-pool planner's, paired over scenes: {shown}.")
        metrics |= _flat(f"{task.value}.trees_minus_full_planner.s1", gain)
    return "\n".join(lines), metrics


def _misses(frame: pl.DataFrame) -> str:
    """Covered groups whose first choice of the trees fails, the most that a better ranker can win, and what becomes of that choice."""
    lines = []
    for task in Task:
        covered = ranked(frame, _TREES[TreeVariant.GEOMETRY], task).filter(pl.col("success").any().over(task.group))
        first = covered.filter(pl.col("rank") == 1).sort(task.group)
        missed = proportion((~first["success"]).to_numpy(), first["scene_id"].to_list())
        outcome = pl.coalesce(pl.col("exec_status").cast(pl.String), pl.col("plan_status").cast(pl.String))
        counts = Counter(first.filter(~pl.col("success")).select(outcome.alias("outcome"))["outcome"].to_list())
        named = ", ".join(f"{n} {status}" for status, n in sorted(counts.items(), key=lambda item: (-item[1], item[0])))
        lines.append(f"- {task.value}: the first choice of the trees fails in {missed} % of covered groups{f': {named}' if named else ''}.")
    return "\n".join(lines)


def _flat(name: str, estimate: Estimate | None) -> dict[str, float]:
    return {} if estimate is None else {name: estimate.value, f"{name}_low": estimate.low, f"{name}_high": estimate.high}


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m reports.trees_probe", description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("release", type=Path, help="folder of a release")
    parser.add_argument("--cross-validate", type=int, metavar="N", help="N folds over all scenes instead of train on train, judge on test")
    parser.add_argument("--split", default=SplitScheme.SCENE.value, help=f"one of {', '.join(scheme.value for scheme in SplitScheme)}")
    parser.add_argument("--seed", type=int, default=42)
    parser.add_argument("--out", type=Path, help="folder for the report, the predictions and table candidate_geometry")
    options = parser.parse_args(arguments)
    try:
        scheme = scheme_named(options.split)
        if options.cross_validate is not None and scheme is not SplitScheme.SCENE:
            raise ReportError(f"--split {scheme.value}: cross-validation is over all scenes, must be without --split")
        tables = load_release(options.release, ("candidates", "splits", "scenes", "targets", "policy_features"))
        if options.cross_validate is None:
            check_parts(tables, scheme, (Split.TRAIN, Split.TEST))
        data = read_tree_data(options.release)
        predictions = tree_predictions(options.release, data, options.seed, options.cross_validate, scheme)
        split = "test" if options.cross_validate is None else "all"
        how = "train split to test split" if options.cross_validate is None else f"{options.cross_validate}-fold over all scenes"
        title = f"Trees on {options.release.name}, {how}"
        report = trees_probe_report(tables, predictions, split=split, seed=options.seed, title=title, scheme=scheme)
        if options.out is not None:
            made_from = {SCHEME_OF_PREDICTIONS: scheme.value} if options.cross_validate is None else {}
            write_table(CANDIDATE_GEOMETRY, geometry_table(data.inputs, data.geometry), options.out / "candidate_geometry.parquet")
            write_table(PREDICTIONS, predictions, options.out / "predictions.parquet", made_from)
            report.write(options.out)
    except PlaceBenchError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(report.markdown)
    return 0


if __name__ == "__main__":
    sys.exit(main())
