"""How good a posterior over theta is, and how much posteriors differ."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import entr

from pipeline.arrays import FloatArray
from pipeline.choice.logspace import log_sum_exp
from pipeline.choice.validation import vector
from pipeline.errors import ArgumentError

# Probabilities whose relative difference is below this are equal: they differ by rounding.
TIE_TOLERANCE = 1e-9


def true_posterior(marginal: ArrayLike, k: int) -> float:
    """The posterior probability of the true theta, P(theta* | demonstrations).

    >>> true_posterior([0.2, 0.5, 0.3], 1)
    0.5

    Args:
        marginal: (K,) posterior probabilities of the thetas, summing to one.
        k: row of the true theta.

    Raises:
        ArgumentError: `marginal` is no distribution, or `k` no row of it.

    Source: paper, TruePosterior.
    """
    probabilities = _distribution(marginal)
    return float(probabilities[_row(k, len(probabilities))])


def true_match(marginal: ArrayLike, k: int) -> float:
    """Whether the most probable theta is the true one: 1 or 0, and 1/m where m thetas share the maximum.

    Hypotheses that the features cannot tell apart have equal posteriors. To count the first of them as the maximum
    would reward the order of the grid; 1/m is what a fair draw among them scores on average.

    >>> true_match([0.4, 0.4, 0.2], 1)
    0.5

    Args:
        marginal: (K,) posterior probabilities of the thetas, summing to one.
        k: row of the true theta.

    Raises:
        ArgumentError: `marginal` is no distribution, or `k` no row of it.

    Source: paper, TrueMatch.
    """
    probabilities = _distribution(marginal)
    largest = probabilities >= probabilities.max() * (1 - TIE_TOLERANCE)
    return float(largest[_row(k, len(probabilities))]) / int(largest.sum())


def entropy(marginal: ArrayLike) -> float:
    """Shannon entropy of a posterior, -sum_k p_k log p_k, in nats.

    Args:
        marginal: (K,) posterior probabilities, summing to one.

    Raises:
        ArgumentError: `marginal` is no distribution.
    """
    return float(np.sum(entr(_distribution(marginal))))


def kl_aggregate(log_posteriors: ArrayLike) -> float:
    """Sum of the Kullback-Leibler divergences of all ordered pairs of posteriors, in nats.

    sum_P sum_Q sum_k P_k (log P_k - log Q_k). It is +inf only where some Q_k is zero (its log -inf) and P_k is not.

    >>> import numpy as np
    >>> round(kl_aggregate(np.log([[0.5, 0.5], [0.9, 0.1]])), 6)
    0.87889

    Args:
        log_posteriors: (R, K) log probabilities of R posteriors over the same K thetas; -inf for zero.

    Raises:
        ArgumentError: the rows are not logs of distributions.

    Source: paper section "LESS robustness", KLAggregate.
    """
    log_p = np.asarray(log_posteriors, dtype=np.float64)
    if log_p.ndim != 2 or log_p.size == 0:
        raise ArgumentError(f"log_posteriors has shape {log_p.shape}; (R, K) with R, K >= 1 is needed.")
    if np.isnan(log_p).any() or not np.allclose(log_sum_exp(log_p, axis=1), 0.0, atol=1e-6):
        raise ArgumentError("log_posteriors has rows whose exponentials do not sum to one; give log probabilities.")
    return float(divergences(log_p).sum())


def divergences(log_posteriors: FloatArray) -> FloatArray:
    """Kullback-Leibler divergences of all ordered pairs of posteriors, in nats; their sum is KLAggregate.

    Args:
        log_posteriors: (..., R, K) log probabilities of R posteriors over the same K hypotheses, not checked.

    Returns:
        (..., R, R): entry [..., p, q] is sum_k P_k (log P_k - log Q_k), infinite where Q_k alone is zero.
    """
    log_p, log_q = log_posteriors[..., :, None, :], log_posteriors[..., None, :, :]
    with np.errstate(invalid="ignore"):
        ratios = np.where(log_p == -np.inf, 0.0, log_p - log_q)  # where P_k = 0 the term is 0
        pairs = np.einsum("...pk,...pqk->...pq", np.exp(log_posteriors), ratios)
    return np.asarray(np.where((ratios == np.inf).any(axis=-1), np.inf, pairs))


def angle_to(theta_hat: ArrayLike, theta: ArrayLike) -> float:
    """Angle between two reward directions (rad), 0 to pi.

    Args:
        theta_hat: (F,) estimate.
        theta: (F,) truth.

    Raises:
        ArgumentError: lengths differ, or a vector is zero.
    """
    first = _unit("theta_hat", vector("theta_hat", theta_hat))
    second = _unit("theta", vector("theta", theta, length=len(first)))
    # arccos of a dot product loses half the digits near 0 and pi.
    return float(2 * np.arctan2(np.linalg.norm(first - second), np.linalg.norm(first + second)))


def _unit(name: str, values: FloatArray) -> FloatArray:
    largest = np.abs(values).max()
    if largest == 0:
        raise ArgumentError(f"{name} is the zero vector; a direction is needed.")
    return np.asarray(values / largest / np.linalg.norm(values / largest))


def _distribution(marginal: ArrayLike) -> FloatArray:
    probabilities = vector("marginal", marginal)
    total = float(probabilities.sum())
    if probabilities.min() < 0 or abs(total - 1) > 1e-6:
        raise ArgumentError(f"marginal sums to {total:g}; non-negative probabilities that sum to one are needed.")
    return probabilities


def _row(k: int, count: int) -> int:
    if isinstance(k, bool) or not isinstance(k, (int, np.integer)) or not 0 <= k < count:
        raise ArgumentError(f"k is {k!r}; a row between 0 and {count - 1} is needed.")
    return int(k)
