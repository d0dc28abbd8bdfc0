"""Temperature scaling: one number by which the logits of a head are divided so that its probabilities fit what happened on validation.

Guo et al., On Calibration of Modern Neural Networks (ICML 2017). It cannot change which of two candidates a head finds likelier.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import minimize_scalar

# Of the natural logarithm of a temperature: a head that is wrong so far is not mended by a number.
_LOG_BOUNDS = (-4.0, 4.0)
# A 32-bit log probability is 0 where the logit is larger than this.
_MAX_LOGIT = 104.0


def logits_of(log_p: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
    """Logits of log probabilities; those of 0 and of probabilities that vanish are cut off at what 32 bits can tell."""
    log_p = np.minimum(np.asarray(log_p, dtype=np.float64), 0.0)
    with np.errstate(divide="ignore"):
        log_not = np.log(-np.expm1(log_p))
    return np.asarray(np.clip(log_p - log_not, -_MAX_LOGIT, _MAX_LOGIT))


def negative_log_likelihood(logits: Float[np.ndarray, "n"], happened: Float[np.ndarray, "n"] | Bool[np.ndarray, "n"]) -> float:
    """Mean over candidates, in nats; `happened` may be a rate."""
    logits, rate = np.asarray(logits, dtype=np.float64), np.asarray(happened, dtype=np.float64)
    return float(np.mean(np.logaddexp(0.0, logits) - rate * logits))


def fitted_temperature(logits: Float[np.ndarray, "n"], happened: Float[np.ndarray, "n"] | Bool[np.ndarray, "n"]) -> float | None:
    """The temperature with the smallest negative log likelihood, in [e^-4, e^4].

    The likelihood of a head is convex in the inverse of its temperature, so the minimum is the only one.

    Args:
        logits: of some candidates.
        happened: of each, or a rate.

    Returns:
        None where everything happened or nothing did, which no temperature fits best.
    """
    rate = np.asarray(happened, dtype=np.float64)
    if not len(rate) or not 0.0 < float(rate.mean()) < 1.0:
        return None
    found = minimize_scalar(
        lambda log_t: negative_log_likelihood(logits / np.exp(log_t), rate), bounds=_LOG_BOUNDS, method="bounded", options={"xatol": 1e-7}
    )
    return float(np.exp(found.x))


def scaled(logits: Float[np.ndarray, "n"], temperature: float) -> Float[np.ndarray, "n"]:
    """Probabilities of logits at a temperature."""
    return np.asarray(np.exp(-np.logaddexp(0.0, -np.asarray(logits, dtype=np.float64) / temperature)))
