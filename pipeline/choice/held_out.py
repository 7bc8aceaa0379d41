"""How well a model predicts demonstrations it has not seen."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pipeline.arrays import FloatArray
from pipeline.choice.inference import checked_prior
from pipeline.choice.likelihood import log_likelihood
from pipeline.choice.logspace import log_sum_exp, peak
from pipeline.choice.models import Model
from pipeline.choice.validation import read_only
from pipeline.errors import ArgumentError


@dataclass(frozen=True)
class HeldOutScore:
    """Log predictive probability of each demonstration given the others, or a difference of two such scores.

    Attributes:
        log_predictive: (n,) in nats, n >= 2.
    """

    log_predictive: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "log_predictive", read_only(self.log_predictive))

    @property
    def total(self) -> float:
        """Sum over demonstrations."""
        return float(self.log_predictive.sum())

    @property
    def mean(self) -> float:
        """Mean over demonstrations."""
        return float(self.log_predictive.mean())

    @property
    def standard_error(self) -> float:
        """Standard error of the mean: the sample standard deviation over sqrt(n)."""
        return float(self.log_predictive.std(ddof=1)) / math.sqrt(len(self.log_predictive))


def held_out_score(
    model: Model,
    demonstrations: ArrayLike,
    alternatives: ArrayLike,
    thetas: ArrayLike,
    betas: ArrayLike = (1.0,),
    log_prior: ArrayLike | None = None,
    similarity: Any = None,
    demonstration_similarity: Any = None,
) -> HeldOutScore:
    """Leave-one-demonstration-out log predictive probability.

    log p(d_i | others) = log sum_{theta, beta} b(theta, beta | others) p(d_i | theta, beta)

    >>> from pipeline.choice import Boltzmann
    >>> score = held_out_score(Boltzmann(), [1, 1], [[0.0], [1.0]], thetas=[[-1.0], [1.0]])
    >>> round(score.mean, 4)
    -0.4996

    Args:
        model: the choice model.
        demonstrations: (n, F) scaled features of trajectories outside the set, or (n,) integer rows of it; n >= 2.
        alternatives: (N, F) scaled features of the choice set.
        thetas: (K, F) reward weights.
        betas: (B,) inverse temperatures.
        log_prior: (K, B), or (K,) the same for all betas; uniform if not given.
        similarity: (N, D) what the model compares instead of the features.
        demonstration_similarity: (n, D) the same for demonstrations outside the set.

    Returns:
        The score, with its mean, sum and standard error.

    Raises:
        ArgumentError: an argument is out of range, or there is only one demonstration.
        BandwidthError: the model's bandwidth cannot be selected.
    """
    likelihood = log_likelihood(
        model, demonstrations, alternatives, thetas, betas, similarity, demonstration_similarity
    )
    return held_out_from(likelihood, log_prior)


def held_out_from(log_likelihoods: ArrayLike, log_prior: ArrayLike | None = None) -> HeldOutScore:
    """The held-out score, from log likelihoods that were computed before.

    Args:
        log_likelihoods: (n, K, B) from `log_likelihood`, n >= 2.
        log_prior: (K, B), or (K,) the same for all betas; uniform if not given.

    Returns:
        The score.

    Raises:
        ArgumentError: shapes do not fit, or n < 2.
    """
    likelihoods = np.asarray(log_likelihoods, dtype=np.float64)
    if likelihoods.ndim != 3 or len(likelihoods) < 2 or np.isnan(likelihoods).any():
        raise ArgumentError(
            f"demonstrations: log likelihoods of shape {likelihoods.shape}; a held-out score needs two or more "
            "demonstrations, (n, K, B) without NaN."
        )
    relative = likelihoods - peak(likelihoods, axis=(1, 2))
    # The sum over the others is that before plus that after. Subtracting from the sum over all would cost digits.
    sum_before = np.zeros_like(likelihoods)
    np.cumsum(relative[:-1], axis=0, out=sum_before[1:])
    sum_after = np.zeros_like(likelihoods)
    sum_after[:-1] = np.cumsum(relative[:0:-1], axis=0)[::-1]
    log_others = checked_prior(log_prior, likelihoods.shape[1:]) + sum_before + sum_after
    return HeldOutScore(log_sum_exp(log_others + likelihoods, axis=(1, 2)) - log_sum_exp(log_others, axis=(1, 2)))


def compare_held_out(a: HeldOutScore, b: HeldOutScore) -> HeldOutScore:
    """Paired difference a - b, demonstration by demonstration: its mean and its standard error.

    Raises:
        ArgumentError: the two scores have different numbers of demonstrations.
    """
    if len(a.log_predictive) != len(b.log_predictive):
        raise ArgumentError(
            f"a has {len(a.log_predictive)} demonstrations and b has {len(b.log_predictive)}; "
            "a paired difference needs the same ones in both."
        )
    return HeldOutScore(a.log_predictive - b.log_predictive)
