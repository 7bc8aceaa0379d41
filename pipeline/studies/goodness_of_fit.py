"""Whether observed choices follow a model's probabilities: Pearson's test of fit and Wellek's test of equivalence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import ArrayLike

from pipeline.arrays import FloatArray
from pipeline.errors import ArgumentError

_SUM_TOLERANCE = 1e-9  # how far the sum of probabilities may be from one


@dataclass(frozen=True)
class ChiSquareTest:
    """Pearson's test of fit.

    Attributes:
        statistic: sum_j (x_j - n p_j)^2 / (n p_j).
        degrees_of_freedom: number of categories minus one.
        p_value: probability of a larger statistic if the choices follow the probabilities.
    """

    statistic: float
    degrees_of_freedom: int
    p_value: float


@dataclass(frozen=True)
class EquivalenceTest:
    """Wellek's test of equivalence with a fully specified multinomial distribution.

    Attributes:
        squared_distance: ||p_hat - p_0||^2.
        standard_error: estimated standard error v / sqrt(n) of the squared distance.
        critical_value: eps^2 - z_{1-alpha} v / sqrt(n).
        equivalent: whether squared_distance < critical_value, so that a distance of eps or more is rejected.
    """

    squared_distance: float
    standard_error: float
    critical_value: float
    equivalent: bool


def chi_square_test(counts: ArrayLike, probabilities: ArrayLike) -> ChiSquareTest:
    """Pearson's chi-square test of observed counts against fully specified probabilities.

    Args:
        counts: (k,) how often each of k >= 2 categories was observed.
        probabilities: (k,) the model's probabilities, all positive, with sum one.

    Raises:
        ArgumentError: counts or probabilities are not as described, or a probability is zero.
    """
    from scipy.stats import chi2

    x, p = _checked(counts, probabilities)
    if not (p > 0).all():
        raise ArgumentError("probabilities holds a zero; Pearson's test needs every category to be possible.")
    expected = x.sum() * p
    statistic = float(((x - expected) ** 2 / expected).sum())
    return ChiSquareTest(statistic, x.size - 1, float(chi2.sf(statistic, x.size - 1)))


def wellek_test(counts: ArrayLike, probabilities: ArrayLike, epsilon: float, alpha: float = 0.05) -> EquivalenceTest:
    """Wellek's asymptotic test that a multinomial distribution is equivalent to a given one.

    The null hypothesis is ||p - p_0|| >= epsilon (Euclidean distance). With d = p_hat - p_0 and
    v^2 = 4 [sum_j d_j^2 p_hat_j - (sum_j d_j p_hat_j)^2], equivalence is declared when
    ||d||^2 < epsilon^2 - z_{1-alpha} v / sqrt(n).

    Args:
        counts: (k,) how often each of k >= 2 categories was observed; n is their sum.
        probabilities: (k,) the probabilities p_0, with sum one.
        epsilon: distance, positive, from which on two distributions count as different.
        alpha: level of the test, in (0, 0.5].

    Raises:
        ArgumentError: an argument is not as described.

    Source: S. Wellek, Testing Statistical Hypotheses of Equivalence and Noninferiority, 2nd ed. (2010), section 9.1,
    equations 9.2 to 9.5, and the function `gofsimpt` of the R package EQUIVNONINF.
    """
    if not (np.isfinite(epsilon) and epsilon > 0):
        raise ArgumentError(f"epsilon is {epsilon}; it must be a positive distance.")
    squared_distance, standard_error, quantile = _wellek(counts, probabilities, alpha)
    critical_value = epsilon**2 - quantile * standard_error
    return EquivalenceTest(squared_distance, standard_error, critical_value, squared_distance < critical_value)


def wellek_minimum_epsilon(counts: ArrayLike, probabilities: ArrayLike, alpha: float = 0.05) -> float:
    """The smallest distance for which `wellek_test` would declare equivalence at level alpha.

    It is sqrt(||d||^2 + z_{1-alpha} v / sqrt(n)); for every larger epsilon, equivalence is declared. It is also the
    upper confidence limit of the distance at confidence 1 - alpha.

    Args:
        counts: (k,) how often each of k >= 2 categories was observed.
        probabilities: (k,) the probabilities p_0, with sum one.
        alpha: level of the test, in (0, 0.5].

    Raises:
        ArgumentError: an argument is not as described.
    """
    squared_distance, standard_error, quantile = _wellek(counts, probabilities, alpha)
    return sqrt(squared_distance + quantile * standard_error)


def _wellek(counts: ArrayLike, probabilities: ArrayLike, alpha: float) -> tuple[float, float, float]:
    """||d||^2, its standard error v / sqrt(n), and the quantile z_{1-alpha}."""
    from scipy.special import ndtri

    if not 0 < alpha <= 0.5:
        raise ArgumentError(f"alpha is {alpha}; it must be above 0 and at most 0.5.")
    x, p = _checked(counts, probabilities)
    observed = x / x.sum()
    d = observed - p
    # v^2 / 4 is the variance of d_J, where J is drawn from the observed shares; in this form it is never negative
    mean = float(d @ observed)
    variance = 4.0 * float((d - mean) ** 2 @ observed)
    return float(d @ d), sqrt(variance / float(x.sum())), float(ndtri(1.0 - alpha))


def _checked(counts: ArrayLike, probabilities: ArrayLike) -> tuple[FloatArray, FloatArray]:
    x, p = np.asarray(counts, dtype=np.float64), np.asarray(probabilities, dtype=np.float64)
    _require_vector("counts", x.shape)
    _require_vector("probabilities", p.shape)
    if x.shape != p.shape:
        raise ArgumentError(f"counts has {x.size} categories and probabilities {p.size}; give one per category.")
    if not (np.isfinite(x).all() and (x >= 0).all() and (x == np.floor(x)).all() and x.sum() > 0):
        raise ArgumentError(f"counts is {x.tolist()}; it must be whole numbers from 0, not all of them 0.")
    if not (np.isfinite(p).all() and (p >= 0).all() and abs(float(p.sum()) - 1.0) <= _SUM_TOLERANCE):
        raise ArgumentError(f"probabilities is {p.tolist()}; it must be numbers from 0 to 1 with sum 1.")
    return x, p


def _require_vector(name: str, shape: Sequence[int]) -> None:
    if len(shape) != 1 or shape[0] < 2:
        raise ArgumentError(f"{name} has the shape {tuple(shape)}; it must be a vector of at least two categories.")
