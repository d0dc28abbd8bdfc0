"""Report of the ceiling: how far S1 can go when labels flip, and what the first choice of a policy is worth under small uncertainty.

Replicates are executed in pipelines/proofs/replicates.py. `python -m splits.replicates RELEASE` makes their table.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import polars as pl
import pyarrow as pa
from jaxtyping import Bool, Float

from pipelines.frames import frame_of
from reports.entries import flat, prediction_frames
from reports.load import Task, candidate_frame
from reports.metrics import MIN_SCENES, proportion
from reports.policies import LEARNED, ORACLE, UNLEARNED, Policy, ranked
from reports.ranking import TASK_TITLE
from reports.report import Report, ReportError
from reports.resampling import Draws, SceneBootstrap
from splits.markdown import percent, table
from tables.vocabulary import Split


def cross_fitted_best(outcomes: Bool[np.ndarray, "n r"]) -> float:
    """What the best candidate of a group is worth, chosen and judged on different replicates.

    Each replicate is held out once: of the candidates that succeed most often in the others, its mean outcome counts (the mean over
    ties, whoever would win them). The mean over replicates is then the expected success of a choice made with r - 1 looks at every
    candidate; the largest mean of all r would count the luck of the luckiest of n.

    Args:
        outcomes: success of each of n candidates in each of r >= 2 replicates.
    """
    wins = np.asarray(outcomes, dtype=np.float64)
    n, r = wins.shape
    if n < 1 or r < 2:
        raise ValueError(f"outcomes of shape {wins.shape}, must be of at least 1 candidate and 2 replicates")
    in_others = wins.sum(axis=1, keepdims=True) - wins
    is_best = in_others >= in_others.max(axis=0) - 0.5  # counts are whole numbers
    return float(((wins * is_best).sum(axis=0) / is_best.sum(axis=0)).mean())


def luckiest_mean(outcomes: Bool[np.ndarray, "n r"]) -> float:
    """The largest mean over all replicates of n candidates: more than the best is worth, by the luck of the luckiest.

    Between it and `cross_fitted_best` lies what a choice would be worth that knows every candidate's chance.
    """
    return float(np.asarray(outcomes, dtype=np.float64).mean(axis=1).max())


def ceiling_report(
    tables: Mapping[str, pa.Table], replicates: pa.Table, predictions: pa.Table | None = None, *, tier: str, seed: int
) -> Report:
    """Report `ceiling`, of the test split of the paper's scheme.

    Args:
        tables: `candidates`, `splits`, `scenes`, `targets`, `policy_features` of a release.
        replicates: table `test_replicates` of it, of all or of some scenes; policies are judged on these.
        predictions: table `predictions` of any learned policies.
        tier: printed in the title.
        seed: of the hash order and the resampling.

    Raises:
        ReportError: a planned test candidate without its replicates, or replicates of another candidate.
    """
    of_test = candidate_frame(tables, seed).filter(pl.col("split") == Split.TEST.value)
    # The table may be of some scenes, of each then whole; one without a planned candidate has no covered group.
    executed = frame_of(replicates).join(of_test.select("candidate_id", "scene_id"), on="candidate_id")["scene_id"].unique()
    frame = of_test.filter(pl.col("scene_id").is_in(executed))
    outcomes = _outcomes(frame, frame_of(replicates))
    scores = None if predictions is None else frame_of(predictions)
    n_replicates = outcomes["outcomes"].list.len().max()
    n_scenes = (frame["scene_id"].n_unique(), of_test.filter("y_plan")["scene_id"].n_unique())
    blocks = [f"# The ceiling on tier {tier}, test split", _about(outcomes, n_replicates, *n_scenes)]
    metrics: dict[str, float] = {"n_executions": float(outcomes["outcomes"].list.len().sum())}
    for task in Task:
        section, values = _task_section(frame.join(outcomes, on="candidate_id", how="left"), scores, task, seed)
        blocks += section
        metrics |= values
    flips = _flips(outcomes)
    names = {"success_flips": "stored successes fail", "failure_flips": "stored failures succeed"}
    shares = " and ".join(f"{percent(flips[name])} of the replicates of {text}" for name, text in names.items() if name in flips)
    blocks.insert(2, f"How much labels hang on what cannot be known: {shares}.")
    return Report("ceiling", "\n\n".join(blocks) + "\n", metrics=metrics | flips)


def _outcomes(frame: pl.DataFrame, replicates: pl.DataFrame) -> pl.DataFrame:
    """Success in every replicate of each planned candidate, as a list, beside its stored label."""
    planned = frame.filter("y_plan").select("candidate_id", "success")
    made = replicates.sort("candidate_id", "replicate").group_by("candidate_id").agg(outcomes=pl.col("is_success"))
    foreign = made.join(planned, on="candidate_id", how="anti").sort("candidate_id")
    if not foreign.is_empty():
        raise ReportError(
            f"test_replicates: {foreign['candidate_id'][0]} is no planned test candidate ({foreign.height} candidates, must be 0)"
        )
    joined = planned.join(made, on="candidate_id", how="left").sort("candidate_id")
    n = int(joined["outcomes"].list.len().max() or 0)  # type: ignore[arg-type]
    short = joined.filter(pl.col("outcomes").list.len().fill_null(0) < max(n, 2))
    if not short.is_empty():
        found = 0 if short["outcomes"][0] is None else len(short["outcomes"][0])
        raise ReportError(
            f"test_replicates: {short['candidate_id'][0]} has {found} replicates, must have {max(n, 2)}"
            f" ({short.height} candidates have fewer, must be 0)"
        )
    return joined


def _about(outcomes: pl.DataFrame, n_replicates: object, n_scenes: int, n_all_scenes: int) -> str:
    of_scenes = "" if n_scenes == n_all_scenes else f" in {n_scenes} of its {n_all_scenes} scenes, the first in the order of their hash"
    return (
        f"Every planned candidate of the test split{of_scenes}, {outcomes.height:,}, was executed {n_replicates} more times under small"
        " real uncertainty that the plan does not know: friction ±10 %, mass ±5 %, where the object lies in the hand ±1 mm and ±1° on every"
        " axis, the start of each motion ±1 control step. **S1** is of the stored labels, on covered groups, as everywhere. **Robust"
        " S1** is the mean success over the replicates of what a policy tries first; a first choice without a plan has none. The"
        " **ceiling** is what the best candidate of a group is worth: chosen on all replicates but one and judged on that one, each held"
        " out in turn, so that luck is not counted as merit. **It is what that many looks at every candidate buy**, so a policy that knows"
        " more may pass it; the mean of the luckiest candidate over all replicates, which luck flatters, is above what anybody can get."
        " The oracle knows the stored labels and nothing else. S1 / ceiling may pass 100:"
        " stored labels are one throw, and whoever is judged on them is credited with its luck; robust S1 / ceiling is not. Intervals are"
        f" 95 %, for scenes whose groups are alike and trainings that differ (of one training: for this very one); those of ratios are"
        f" resampled, and there are none below {MIN_SCENES} scenes."
    )


def _task_section(frame: pl.DataFrame, scores: pl.DataFrame | None, task: Task, seed: int) -> tuple[list[str], dict[str, float]]:
    covered = frame.filter(pl.col("success").any().over(task.group))
    if covered.is_empty():
        return [f"## {TASK_TITLE[task]}", "No group is covered."], {}
    groups = covered.filter("y_plan").sort("candidate_id").group_by(task.group, maintain_order=True).agg("outcomes").sort(task.group)
    outcomes = [np.array(own.to_list(), dtype=bool) for own in groups["outcomes"]]
    best, luckiest = (np.array([worth(own) for own in outcomes]) for worth in (cross_fitted_best, luckiest_mean))
    scene_ids = groups["scene_id"].to_list()
    bootstrap = SceneBootstrap(scene_ids, seed)
    ceiling, at_most, prefix = bootstrap.mean(best), proportion(luckiest, scene_ids), f"test.{task.value}"
    own_ceiling = proportion(best, scene_ids)
    metrics = flat(f"{prefix}.ceiling", own_ceiling) | flat(f"{prefix}.ceiling_at_most", at_most)
    rows: list[list[object]] = []
    for policy, frames in _policies(covered, scores):
        firsts = [_first_choices(own, policy, task) for own in frames]
        parts = [np.stack([first[k] for first in firsts]) for k in (0, 1)]
        shares = [proportion(part, scene_ids) for part in parts]
        ratios = [bootstrap.mean(part, policy.name) / ceiling for part in parts] if ceiling.value else []
        rows.append([policy.label, *shares, *[_shown(own, bootstrap) for own in ratios], *[None] * (2 - len(ratios))])
        for name, share in zip(("s1", "robust_s1"), shares, strict=True):
            metrics |= flat(f"{prefix}.{policy.name}.{name}", share)
        for name, ratio in zip(("s1_of_ceiling", "robust_s1_of_ceiling"), ratios, strict=False):
            metrics |= _metric(f"{prefix}.{policy.name}.{name}", ratio, bootstrap)
    header = ["policy", "S1 [95 %]", "robust S1 [95 %]", "S1 / ceiling", "robust S1 / ceiling"]
    text = (
        f"{len(best):,} covered groups of {bootstrap.n_scenes:,} scenes. **Ceiling: {own_ceiling} %** of a choice made with one look less"
        f" than there are replicates; at most {at_most} % of one that knows all."
    )
    return [f"## {TASK_TITLE[task]}", text, table(header, rows)], metrics


def _policies(covered: pl.DataFrame, scores: pl.DataFrame | None) -> list[tuple[Policy, list[pl.DataFrame]]]:
    learned = [(policy, list(prediction_frames(covered, scores, policy.variant).values())) for policy in LEARNED]
    return [*((policy, [covered]) for policy in (*UNLEARNED, ORACLE)), *((policy, frames) for policy, frames in learned if frames)]


def _first_choices(frame: pl.DataFrame, policy: Policy, task: Task) -> tuple[Float[np.ndarray, "g"], Float[np.ndarray, "g"]]:
    """Of what a policy tries first in each group: the stored success, and the mean over the replicates."""
    first = ranked(frame, policy, task).filter(pl.col("rank") == 1).sort(task.group)
    mean = first["outcomes"].list.eval(pl.element().cast(pl.Float64)).list.mean().fill_null(0.0)
    return first["success"].cast(pl.Float64).to_numpy(), mean.to_numpy()


def _flips(outcomes: pl.DataFrame) -> dict[str, float]:
    """Share of replicates whose outcome is not the stored one, by what is stored."""
    each = outcomes.explode("outcomes")
    kinds = (("success_flips", each.filter("success")), ("failure_flips", each.filter(~pl.col("success"))))
    return {name: float((own["success"] != own["outcomes"]).mean()) for name, own in kinds if own.height}  # type: ignore[arg-type]


def _shown(draws: Draws, bootstrap: SceneBootstrap) -> str:
    return str(draws.estimate()) if bootstrap.is_telling else f"{100 * draws.value:.1f}"


def _metric(name: str, draws: Draws, bootstrap: SceneBootstrap) -> dict[str, float]:
    return flat(name, draws.estimate()) if bootstrap.is_telling else {name: draws.value}
