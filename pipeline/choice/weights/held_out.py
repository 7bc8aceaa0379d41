"""Held-out scores from one posterior: each demonstration is taken out by reweighting the draws."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pipeline.arrays import FloatArray
from pipeline.choice.held_out import HeldOutScore
from pipeline.choice.logspace import log_sum_exp
from pipeline.choice.weights.draws import WeightDraws
from pipeline.choice.weights.pareto import pareto_smoothed
from pipeline.errors import ArgumentError


@dataclass(frozen=True, eq=False)
class LeaveOneOut:
    """What is known without each of n demonstrations.

    Attributes:
        score: log predictive probability of each given the others.
        log_weight: (n, S) normalised log weights of the draws without each.
        pareto_k: (n,) above 0.7 taking this one out changes the posterior too much for reweighting.
    """

    score: HeldOutScore
    log_weight: FloatArray
    pareto_k: FloatArray


def leave_one_out(draws: WeightDraws, log_likelihood: ArrayLike) -> LeaveOneOut:
    """Take each demonstration out of the posterior by importance weights 1 / p(d | omega), Pareto smoothed.

    Args:
        draws: the posterior given all demonstrations.
        log_likelihood: (S, n) of each demonstration at each draw, from `Choices.log_likelihood(draws.omega)`.

    Raises:
        ArgumentError: shapes do not fit, or there are fewer than two demonstrations.

    Source: Vehtari, Gelman and Gabry (2017), Practical Bayesian model evaluation using leave-one-out
    cross-validation and WAIC, arXiv 1507.04544.
    """
    values = np.asarray(log_likelihood, dtype=np.float64)
    if values.ndim != 2 or len(values) != len(draws.omega) or values.shape[1] < 2:
        raise ArgumentError(
            f"log_likelihood has shape {values.shape}; one row for each of the {len(draws.omega)} draws and a "
            "column for each of two or "
            "more demonstrations are needed."
        )
    parts = [pareto_smoothed(draws.log_weight - column) for column in values.T]
    log_weight = np.stack([weights for weights, _ in parts])
    score = log_sum_exp(log_weight + values.T, axis=1)
    return LeaveOneOut(HeldOutScore(score), log_weight, np.array([k for _, k in parts]))
