"""Report of the learning curve: S1 on the validation split by the number of scenes that a ranker was trained on.

Its table `learning_curve` holds predictions of rankers that were trained on some scenes of the train split; `make curve` trains them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import polars as pl
import pyarrow as pa

from pipelines.frames import frame_of
from reports.entries import Entry, entry_of, flat
from reports.load import Task, candidate_frame
from reports.metrics import spread_of
from reports.policies import FULL_PLANNER, IK_AND_GRIPPER, POLICIES, Policy, with_predictions
from reports.ranker_figures import Curve, Line, curve_figure
from reports.ranking import KS, TASK_TITLE, timing_frame
from reports.report import Report, ReportError
from reports.resampling import Draws, SceneBootstrap
from splits.markdown import table
from tables.schemas import LEARNING_CURVE, PREDICTIONS
from tables.store import join_tables, table_from_columns
from tables.vocabulary import Split

_LEVELS = (FULL_PLANNER, IK_AND_GRIPPER)


def learning_curve_report(tables: Mapping[str, pa.Table], predictions: pa.Table, *, tier: str, seed: int) -> Report:
    """Report `learning_curve`, of the validation split of the paper's scheme.

    Args:
        tables: `candidates`, `splits`, `scenes`, `targets`, `policy_features` of a release.
        predictions: table `learning_curve`.
        tier: printed in the title.
        seed: of the hash order and the resampling.

    Raises:
        ReportError: no rows, more scenes than the train split has, or a candidate of the validation split without a prediction.
    """
    everything = candidate_frame(tables, seed)
    frame, scores = everything.filter(pl.col("split") == Split.VALIDATION.value), frame_of(predictions)
    n_train = int((frame_of(tables["splits"], ["split"])["split"].cast(pl.String) == Split.TRAIN.value).sum())
    sizes = _sizes(scores, n_train)
    blocks = [f"# Learning curve on tier {tier}, validation split", _ABOUT.format(n_train=f"{n_train:,}")]
    metrics: dict[str, float] = {"n_train_scenes": float(n_train)}
    panels: dict[str, tuple[list[Curve], list[Line]]] = {}
    points: list[dict[str, object]] = []
    for task in Task:
        entries = {(variant, n): _entry(frame, scores, variant, n, task) for variant, n in sizes}
        levels = [entry_of(policy, task, frame, timing_frame({})) for policy in _LEVELS]
        doubling, values = _doubling(entries, _labels(sizes), seed, f"validation.{task.value}")
        blocks += [f"## {TASK_TITLE[task]}", _section(entries, levels, n_train), *doubling]
        metrics |= values
        for (variant, n), entry in entries.items():
            for k in KS:
                metrics |= flat(f"validation.{task.value}.{variant}.n{n}.s{k}", entry.s(k))
            points += [
                {"task": task.value, "variant": variant, "n_train_scenes": n, "seed": own, "s1": s / 100.0}
                for own, s in zip(entry.seeds, entry.s_by_training(1), strict=False)
            ]
        curves = [
            Curve(label, [n for own, n in entries if own == variant], [entry.s(1) for (own, _), entry in entries.items() if own == variant])
            for variant, label in _labels(sizes).items()
        ]
        lines = [Line(level.policy.label, estimate.value) for level in levels if (estimate := level.s(1)) is not None]
        panels[f"{TASK_TITLE[task]}, {levels[0].covered.height:,} covered groups"] = (curves, lines)
    png = curve_figure(panels, f"S1 on validation by scenes trained on, {tier}", "training scenes", "S1, covered groups [%]")
    blocks.append("![S1 by number of training scenes, with 95 % intervals](learning_curve.png)")
    text, figures = "\n\n".join(blocks) + "\n", {"learning_curve": png}
    return Report("learning_curve", text, figures, metrics, {"learning_curve-trainings": points})


_ABOUT = (
    "S1 on covered groups of the validation split by the number of scenes of the train split, {n_train} in all, that a ranker was"
    " trained on: mean over its trainings, with the 95 % interval that takes into account that groups of a scene are alike and that"
    " trainings differ; where there is one training it is of this very one, and so is what twice the scenes are worth. The epoch of a"
    " network is chosen on this split too, so what is compared are sizes, not rankers with those that learn nothing. The test split is"
    " not read."
)


def learning_curve_table(predictions: Mapping[int, Sequence[pa.Table]], candidates: pa.Table, splits: pa.Table) -> pa.Table:
    """Table `learning_curve`: of each prediction the candidates of the validation split.

    Args:
        predictions: tables of predictions by the number of scenes that their rankers were trained on.

    Raises:
        SchemaError: the same training twice.
    """
    scenes = frame_of(splits, ["scene_id", "split"]).filter(pl.col("split").cast(pl.String) == Split.VALIDATION.value)
    wanted = frame_of(candidates, ["candidate_id", "scene_id"]).join(scenes, on="scene_id").select("candidate_id")
    parts = []
    for n, own in predictions.items():
        frame = frame_of(join_tables(PREDICTIONS, list(own))).with_columns(pl.col("variant").cast(pl.String))
        parts.append(frame.join(wanted, on="candidate_id").with_columns(pl.lit(n, pl.Int32).alias("n_train_scenes")))
    joined = pl.concat(parts).sort(LEARNING_CURVE.key)
    return table_from_columns(LEARNING_CURVE, {name: joined[name].to_list() for name in LEARNING_CURVE.names})


def _sizes(scores: pl.DataFrame, n_train: int) -> list[tuple[str, int]]:
    found = scores.select(pl.col("variant").cast(pl.String), "n_train_scenes").unique()
    sizes = sorted(found.iter_rows(), key=lambda row: (_rank(row[0]), row))
    if not sizes:
        raise ReportError("learning_curve: 0 rows, must be at least 1")
    for variant, n in sizes:
        if not 1 <= n <= n_train:
            raise ReportError(f"learning_curve: {variant} of {n} scenes, must be in [1, {n_train}], the scenes of the train split")
    return sizes


def _rank(variant: str) -> int:
    known = [policy.variant for policy in POLICIES]
    return known.index(variant) if variant in known else len(known)


def _policy(variant: str, n: int) -> Policy:
    """One size as a policy of its own: trainings of two sizes are not drawn alike."""
    return Policy(f"{variant}.n{n}", variant, (-pl.col("score"),), variant=variant)


def _labels(sizes: Sequence[tuple[str, int]]) -> dict[str, str]:
    labels = {policy.variant: policy.label for policy in POLICIES if policy.is_learned}
    return {variant: labels.get(variant, variant) for variant, _ in sizes}


def _entry(frame: pl.DataFrame, scores: pl.DataFrame, variant: str, n: int, task: Task) -> Entry:
    own = scores.filter((pl.col("variant").cast(pl.String) == variant) & (pl.col("n_train_scenes") == n)).drop("n_train_scenes")
    seeds = sorted(own["seed"].unique().to_list())
    return entry_of(_policy(variant, n), task, {seed: with_predictions(frame, own, variant, seed) for seed in seeds}, timing_frame({}))


def _section(entries: Mapping[tuple[str, int], Entry], levels: Sequence[Entry], n_train: int) -> str:
    labels = _labels(list(entries))
    rows: list[list[object]] = []
    for (variant, n), entry in entries.items():
        spread = spread_of(entry.s_by_training(1))
        shares = [entry.s(k) for k in KS]
        rows.append(
            [labels[variant], f"{n:,}", f"{100 * n / n_train:.0f} %", len(entry.seeds), *shares, None if spread is None else str(spread)]
        )
    for level in levels:
        rows.append([level.policy.label, None, None, None, *(level.s(k) for k in KS), None])
    header = ["policy", "training scenes", "of the train split", "trainings", *(f"S{k} [95 %]" for k in KS), "S1 of the trainings"]
    return table(header, rows)


def doubling_draws(entries: Mapping[int, Entry], bootstrap: SceneBootstrap) -> Draws:
    """What twice the scenes are worth: the slope of S1 over the binary logarithm of their number, by least squares.

    Args:
        entries: at least two, by number of scenes; all of the groups that the bootstrap was made for.
    """
    x = np.log2(list(entries)) - np.mean(np.log2(list(entries)))
    weights = x / (x @ x)
    s1 = [entry.s_draws(1, bootstrap) for entry in entries.values()]
    draws = np.einsum("k,kd->d", weights, np.stack([own.draws for own in s1]))
    return Draws(float(weights @ [own.value for own in s1]), draws, s1[0].n, s1[0].n_scenes)


def _doubling(
    entries: Mapping[tuple[str, int], Entry], labels: Mapping[str, str], seed: int, prefix: str
) -> tuple[list[str], dict[str, float]]:
    """A line a variant of two sizes or more, and the same among metrics."""
    lines: list[str] = []
    metrics: dict[str, float] = {}
    for variant, label in labels.items():
        own = {n: entry for (name, n), entry in entries.items() if name == variant}
        scene_ids = next(iter(own.values())).scene_ids
        if len(own) < 2 or not scene_ids:
            continue
        bootstrap = SceneBootstrap(scene_ids, seed)
        slope = doubling_draws(own, bootstrap)
        shown = str(slope.estimate()) if bootstrap.is_telling else f"{100 * slope.value:.1f}"
        metrics |= flat(f"{prefix}.{variant}.s1_of_twice_the_scenes", slope.estimate()) if bootstrap.is_telling else {}
        lines.append(f"- {label}: {shown} points of S1 for twice the scenes (least squares over all sizes).")
    return ["\n".join(lines)] if lines else [], metrics
