from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from reports.temperature import fitted_temperature, logits_of, negative_log_likelihood, scaled

LOGITS = np.random.default_rng(0).normal(0.3, 2.0, 400)


def test_probabilities_that_are_the_rates_have_temperature_1() -> None:
    """Where each probability is the rate of what it speaks of, no temperature is likelier."""
    assert fitted_temperature(LOGITS, scaled(LOGITS, 1.0)) == pytest.approx(1.0, abs=1e-4)


@given(st.floats(0.1, 10.0))
def test_logits_that_are_too_large_by_a_factor_have_it_as_temperature(factor: float) -> None:
    made = fitted_temperature(factor * LOGITS, scaled(LOGITS, 1.0))
    assert made == pytest.approx(factor, rel=1e-4)
    assert made is not None
    assert scaled(factor * LOGITS, made) == pytest.approx(scaled(LOGITS, 1.0), abs=1e-4)


def test_the_temperature_is_the_best_of_a_fine_grid() -> None:
    happened = np.random.default_rng(1).random(400) < scaled(LOGITS, 2.5)
    made = fitted_temperature(LOGITS, happened)
    grid = np.geomspace(0.05, 20.0, 4001)
    best = min(grid, key=lambda t: negative_log_likelihood(LOGITS / t, happened))
    assert made == pytest.approx(best, rel=2e-3)


@given(st.floats(0.02, 50.0))
def test_a_temperature_keeps_the_order_and_one_half(temperature: float) -> None:
    made = scaled(np.array([-3.0, -0.1, 0.0, 0.1, 3.0]), temperature)
    assert (np.diff(made) >= 0.0).all()
    assert made[2] == 0.5


def test_logits_are_those_of_the_probabilities() -> None:
    log_p = np.log(scaled(LOGITS, 1.0))
    assert logits_of(log_p) == pytest.approx(LOGITS, abs=1e-6)
    certain = logits_of(np.array([0.0, -1e-45, -500.0], dtype=np.float32))
    assert np.isfinite(certain).all()
    assert certain[0] == 104.0
    assert certain[2] == -104.0


def test_likelihood_is_the_sum_of_logarithms() -> None:
    happened = np.array([True, False, True])
    p = scaled(LOGITS[:3], 1.0)
    assert negative_log_likelihood(LOGITS[:3], happened) == pytest.approx(-np.mean(np.log(np.where(happened, p, 1.0 - p))))


@pytest.mark.parametrize("happened", [np.ones(400, dtype=bool), np.zeros(400, dtype=bool), np.zeros(0, dtype=bool)])
def test_without_both_outcomes_there_is_none(happened: np.ndarray) -> None:
    assert fitted_temperature(LOGITS[: len(happened)], happened) is None
