"""What the ranker is trained on: planning over all candidates, execution over planned ones, ranking within groups."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch.nn import functional

from model.ranker import Prediction
from model.settings import TrainingSettings


@dataclass(frozen=True, slots=True)
class Supervision:
    """Labels of a batch and its ranking groups.

    A ranking group is a row of candidate numbers padded with -1. Two kinds count: fixed-target groups, complete in every batch because a
    batch consists of them, and joint groups, those scenes whose fixed-target groups are all in the batch. Each kind is averaged over
    its groups that hold both a success and a failure, and the kinds are averaged, so that many small groups do not drown few large ones.
    """

    y_plan: Bool[torch.Tensor, "c"]
    y_pipe: Bool[torch.Tensor, "c"]
    ranking_groups: tuple[Int[torch.Tensor, "_g _k"], ...]

    @property
    def success(self) -> Bool[torch.Tensor, "c"]:
        return self.y_plan & self.y_pipe

    def repeated(self, n: int) -> Supervision:
        """The same of n copies of the batch, end to end, whose groups stay apart."""
        groups = []
        for rows in self.ranking_groups:
            shift = torch.arange(n, device=rows.device)[:, None, None] * len(self.y_plan)
            groups.append(torch.where(rows >= 0, rows + shift, rows).flatten(0, 1))
        return Supervision(self.y_plan.repeat(n), self.y_pipe.repeat(n), tuple(groups))


@dataclass(frozen=True, slots=True)
class Losses:
    """The terms and their weighted sum, each a scalar; a term that nothing in the batch supervises is 0."""

    plan: torch.Tensor
    exec: torch.Tensor
    rank: torch.Tensor
    total: torch.Tensor


def losses(prediction: Prediction, supervision: Supervision, settings: TrainingSettings) -> Losses:
    """2 L_plan + L_exec + 0.1 L_rank at the default weights.

    The direct variant has one head: binary cross-entropy of the final success over all candidates takes the place of L_plan, the term that
    sees all candidates in the hierarchical model, so that the ranking term keeps its relative weight; L_exec is 0.
    """
    zero = prediction.exec_logit.sum() * 0.0
    if prediction.plan_logit is None:
        plan, execution = _cross_entropy(prediction.exec_logit, supervision.success), zero
    else:
        plan = _cross_entropy(prediction.plan_logit, supervision.y_plan)
        planned = supervision.y_plan
        # Selecting, not multiplying by 0: an unplanned candidate has no execution outcome, so none may reach the graph.
        execution = _cross_entropy(prediction.exec_logit[planned], supervision.y_pipe[planned]) if bool(planned.any()) else zero
    rank = _mean_of_kinds(prediction.score, supervision.success, supervision.ranking_groups, zero)
    total = settings.weight_plan * plan + settings.weight_exec * execution + settings.weight_rank * rank
    return Losses(plan, execution, rank, total)


def listwise_losses(
    score: Float[torch.Tensor, "c"], success: Bool[torch.Tensor, "c"], groups: Int[torch.Tensor, "g k"]
) -> Float[torch.Tensor, "h"]:
    """-log of the probability that one draw from the softmax of a group's scores is a success; only groups with a success and a failure.

    Top-one likelihood of ListNet (Cao et al. 2007) with the successes pooled: any success on top is right, which is how S1 counts.
    """
    is_member = groups >= 0
    members = groups.clamp_min(0)
    is_success = success[members] & is_member
    has_both = is_success.any(-1) & (is_member & ~is_success).any(-1)
    members, is_member, is_success = members[has_both], is_member[has_both], is_success[has_both]
    scores = score.index_select(0, members.reshape(-1)).reshape(members.shape)
    of_all = scores.masked_fill(~is_member, -torch.inf).logsumexp(-1)
    of_successes = scores.masked_fill(~is_success, -torch.inf).logsumexp(-1)
    return of_all - of_successes


def _cross_entropy(logit: Float[torch.Tensor, "c"], label: Bool[torch.Tensor, "c"]) -> torch.Tensor:
    return functional.binary_cross_entropy_with_logits(logit, label.to(logit.dtype))


def _mean_of_kinds(
    score: Float[torch.Tensor, "c"], success: Bool[torch.Tensor, "c"], kinds: Sequence[Int[torch.Tensor, "_g _k"]], zero: torch.Tensor
) -> torch.Tensor:
    per_kind = [listwise_losses(score, success, groups) for groups in kinds if groups.numel()]
    means = [values.mean() for values in per_kind if values.numel()]
    return torch.stack(means).mean() if means else zero
