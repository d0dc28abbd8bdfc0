"""Laws of the loss: what is masked, what a ranking ignores, and numpy twins of its terms."""

from __future__ import annotations

import numpy as np
import torch
from hypothesis import given
from hypothesis import strategies as st

from model.losses import Supervision, listwise_losses, losses
from model.ranker import Prediction
from model.settings import LIGHT


@st.composite
def _cases(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Logits, both labels, and the group of each candidate."""
    n = draw(st.integers(1, 24))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    y_plan = rng.random(n) < draw(st.sampled_from([0.0, 0.3, 0.7, 1.0]))
    return rng.normal(0, 3, (2, n)), y_plan, y_plan & (rng.random(n) < 0.6), np.sort(rng.integers(0, 4, n))


@given(case=_cases())
def test_labels_of_unplanned_candidates_change_neither_loss_nor_gradient(case: tuple[np.ndarray, ...]) -> None:
    logits, y_plan, y_pipe, group = case
    first = _loss_and_gradient(logits, y_plan, y_pipe, group)
    second = _loss_and_gradient(logits, y_plan, y_pipe ^ ~y_plan, group)
    assert first[0] == second[0]
    np.testing.assert_array_equal(first[1], second[1])


@given(case=_cases())
def test_total_equals_the_numpy_twin(case: tuple[np.ndarray, ...]) -> None:
    logits, y_plan, y_pipe, group = case
    p_plan, p_exec = 1 / (1 + np.exp(-logits))
    success = y_plan & y_pipe
    plan = -np.mean(np.where(y_plan, np.log(p_plan), np.log(1 - p_plan)))
    execution = -np.mean(np.where(y_pipe, np.log(p_exec), np.log(1 - p_exec))[y_plan]) if y_plan.any() else 0.0
    ranks = []
    for number in np.unique(group):
        p, good = (p_plan * p_exec)[group == number], success[group == number]
        if good.any() and not good.all():
            ranks.append(-np.log(p[good].sum() / p.sum()))  # softmax of log p is p over its sum
    rank = np.mean(ranks) if ranks else 0.0
    found, _ = _loss_and_gradient(logits, y_plan, y_pipe, group)
    np.testing.assert_allclose(found, 2 * plan + execution + 0.1 * rank, rtol=1e-9, atol=1e-12)


@given(case=_cases(), shift=st.floats(-50, 50))
def test_listwise_loss_ignores_a_shift_the_order_and_padding(case: tuple[np.ndarray, ...], shift: float) -> None:
    logits, _, _, group = case
    score = torch.from_numpy(logits[0])
    success = torch.from_numpy(logits[1] > 0)
    groups = _padded(group)
    expected = listwise_losses(score, success, groups)
    torch.testing.assert_close(listwise_losses(score + shift, success, groups), expected, rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(listwise_losses(score, success, groups.flip(-1)), expected, rtol=1e-9, atol=1e-9)
    padding = torch.full((len(groups), 3), -1)
    torch.testing.assert_close(listwise_losses(score, success, torch.cat([groups, padding], -1)), expected, rtol=1e-9, atol=1e-9)


@given(case=_cases())
def test_listwise_loss_falls_with_a_success_and_rises_with_a_failure(case: tuple[np.ndarray, ...]) -> None:
    logits, _, _, group = case
    score = torch.from_numpy(logits[0]).requires_grad_()
    success = logits[1] > 0
    (gradient,) = torch.autograd.grad(listwise_losses(score, torch.from_numpy(success), _padded(group)).sum(), score)
    for number in np.unique(group):
        mine = group == number
        both = success[mine].any() and not success[mine].all()
        assert np.all(gradient.numpy()[mine & success] < 0) if both else not gradient.numpy()[mine].any()
        assert np.all(gradient.numpy()[mine & ~success] > 0) if both else True


def test_groups_without_a_choice_do_not_count() -> None:
    score, success = torch.tensor([1.0, 2.0, 3.0, 4.0]), torch.tensor([True, True, False, False])
    assert listwise_losses(score, success, torch.tensor([[0, 1], [2, 3]])).numel() == 0
    assert listwise_losses(score, success, torch.tensor([[0, 1], [2, 3], [0, 2]])).numel() == 1


def test_fixed_and_joint_groups_weigh_the_same() -> None:
    score = torch.tensor([0.5, -1.0, 2.0, 0.0], dtype=torch.float64)
    y = torch.tensor([True, False, False, True])
    fixed, joint = torch.tensor([[0, 1], [2, 3]]), torch.tensor([[0, 1, 2, 3]])
    prediction = Prediction(torch.full_like(score, 30.0), score)
    expected = (listwise_losses(prediction.score, y, fixed).mean() + listwise_losses(prediction.score, y, joint)[0]) / 2
    found = losses(prediction, Supervision(torch.ones(4, dtype=torch.bool), y, (fixed, joint)), LIGHT).rank
    torch.testing.assert_close(found, expected)


def test_direct_head_learns_success_over_all_candidates() -> None:
    logit = torch.tensor([1.0, -2.0, 0.5], dtype=torch.float64)
    y_plan, y_pipe = torch.tensor([True, True, False]), torch.tensor([True, False, True])
    found = losses(Prediction(None, logit), Supervision(y_plan, y_pipe, ()), LIGHT)
    p = 1 / (1 + np.exp(-logit.numpy()))
    expected = -(np.log(p[0]) + np.log(1 - p[1]) + np.log(1 - p[2])) / 3
    np.testing.assert_allclose(float(found.total), 2 * expected, rtol=1e-12)
    assert float(found.exec) == 0.0


def _loss_and_gradient(logits: np.ndarray, y_plan: np.ndarray, y_pipe: np.ndarray, group: np.ndarray) -> tuple[float, np.ndarray]:
    values = torch.from_numpy(logits.copy()).requires_grad_()
    labels = Supervision(torch.from_numpy(y_plan), torch.from_numpy(y_pipe), (_padded(group),))
    total = losses(Prediction(values[0], values[1]), labels, LIGHT).total
    (gradient,) = torch.autograd.grad(total, values)
    return float(total.detach()), gradient.numpy()


def _padded(group: np.ndarray) -> torch.Tensor:
    rows = [torch.from_numpy(np.flatnonzero(group == number)) for number in np.unique(group)]
    return torch.nn.utils.rnn.pad_sequence(rows, batch_first=True, padding_value=-1)
