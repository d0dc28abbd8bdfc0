"""Which candidates two engines judge, and what their agreement is; a judgement is both_engines.py's."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from pipelines.codecs import Row
from tables.identity import order_key
from tables.vocabulary import Category, ExecStatus

CATEGORIES = (Category.CAN, Category.CUBOID)
# How the label-making engine says it ended: valid, lost on the way, or let go and not where it should be.
SUCCESS, LOST, MISSED = "success", "lost", "missed"
_LOST = (ExecStatus.DROPPED, ExecStatus.SLIPPED, ExecStatus.STOPPED)


@dataclass(frozen=True, slots=True)
class Chosen:
    """A candidate to judge and how many executed candidates it stands for."""

    candidate_id: str
    weight: float


def choose(candidates: pa.Table, seed: int, n: int = 150) -> list[Chosen]:
    """Executed candidates, half cans, half cuboids, of each a third in every stratum of the stored status, those that hash lowest.

    Args:
        candidates: table `candidates`.
        n: candidates in all, as far as there are enough; a stratum that has too few leaves its places to the next larger.
    """
    strata: dict[tuple[str, str], list[str]] = {(c.value, s): [] for c in CATEGORIES for s in (SUCCESS, LOST, MISSED)}
    for row in candidates.select(["candidate_id", "category", "exec_status"]).to_pylist():
        if row["exec_status"] is not None and row["category"] in [c.value for c in CATEGORIES]:
            strata[row["category"], stratum_of(row["exec_status"])].append(row["candidate_id"])
    chosen: list[Chosen] = []
    for k, category in enumerate(CATEGORIES):
        left = n // 2 + (n % 2 if k == 0 else 0)
        members = sorted((ids for (name, _), ids in strata.items() if name == category.value), key=len)
        for place, ids in enumerate(members):
            few = sorted(ids, key=lambda name: order_key(seed, "second_engine", name))[: round(left / (len(members) - place))]
            left -= len(few)
            chosen += [Chosen(name, len(ids) / len(few)) for name in few]
    return sorted(chosen, key=lambda one: one.candidate_id)


def stratum_of(exec_status: str) -> str:
    """Success, lost on the way, or missed."""
    if exec_status == ExecStatus.SUCCESS.value:
        return SUCCESS
    return LOST if exec_status in [status.value for status in _LOST] else MISSED


def summary(rows: Sequence[Row], weights: Mapping[str, float] | None = None) -> dict[str, float]:
    """Agreement of both engines on success, and Cohen's kappa, over the rows of `opinion`.

    Args:
        weights: of each candidate id, to count every row as what it stands for; 1 where not given.

    Returns:
        `engine2_agreement`, `engine2_kappa`, `n_engine2`, the first two `_weighted` and for each category; what both engines' rigid
        pads change against the yielding pads that make the labels, and how many statuses are equal.
    """
    mujoco, bullet, yielding = (np.array([row[f"{name}_success"] for row in rows], dtype=bool) for name in ("mujoco", "bullet", "yielding"))
    w = np.array([(weights or {}).get(row["candidate_id"], 1.0) for row in rows])
    ones = np.ones(len(rows))
    out = {
        "engine2_agreement": _agreement(mujoco, bullet, ones),
        "engine2_kappa": _kappa(mujoco, bullet, ones),
        "engine2_agreement_weighted": _agreement(mujoco, bullet, w),
        "engine2_kappa_weighted": _kappa(mujoco, bullet, w),
        "engine2_status_agreement": float(np.mean([row["mujoco_status"] == row["bullet_status"] for row in rows])),
        "n_engine2": float(len(rows)),
        "rigid_pads_agreement": _agreement(yielding, mujoco, ones),
        "rigid_pads_agreement_weighted": _agreement(yielding, mujoco, w),
        "rigid_pads_kappa_weighted": _kappa(yielding, mujoco, w),
    }
    for category in CATEGORIES:
        of = np.array([row["category"] == category.value for row in rows], dtype=bool)
        if of.any():
            out[f"engine2_agreement_{category.value}"] = _agreement(mujoco[of], bullet[of], ones[of])
            out[f"engine2_kappa_{category.value}"] = _kappa(mujoco[of], bullet[of], ones[of])
            out[f"n_engine2_{category.value}"] = float(of.sum())
    return out


def confusion(rows: Sequence[Row]) -> dict[tuple[str, str], int]:
    """How many candidates each pair of statuses has, MuJoCo's first."""
    return dict(sorted(Counter((row["mujoco_status"], row["bullet_status"]) for row in rows).items()))


def _agreement(a: np.ndarray, b: np.ndarray, w: np.ndarray) -> float:
    return float(w @ (a == b) / w.sum())


def _kappa(a: np.ndarray, b: np.ndarray, w: np.ndarray) -> float:
    """Cohen's kappa, 1 where chance leaves nothing to disagree about."""
    p, q = float(w @ a / w.sum()), float(w @ b / w.sum())
    by_chance = p * q + (1 - p) * (1 - q)
    return 1.0 if by_chance == 1.0 else (_agreement(a, b, w) - by_chance) / (1 - by_chance)
