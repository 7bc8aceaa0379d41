"""Draws from the posterior over omega, by importance sampling from Student t's around the modes.

Under each scale of the prior the posterior has one mode. The proposal is a mixture of one t around each, in proportion
to Laplace's evidence, drawn from a shifted lattice; the weights are Pareto smoothed. Chosen by measurement
(`benchmarks/weights.py`): the draws are independent, need no warm-up, and bring the evidence with them.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pipeline.choice.logspace import log_sum_exp
from pipeline.choice.validation import FloatArray
from pipeline.choice.weights.choices import Choices
from pipeline.choice.weights.draws import WeightDraws
from pipeline.choice.weights.laplace import Modes, find_modes, lattice, student_draws, student_log_density
from pipeline.choice.weights.pareto import pareto_smoothed
from pipeline.choice.weights.prior import DEFAULT, WeightPrior
from pipeline.errors import ArgumentError

DRAWS = 4096
_LEAST_SHARE = 0.02  # of the draws around each mode, however little evidence it has: Laplace may be wrong about that


def sample_weights(
    rng: np.random.Generator, choices: Choices, prior: WeightPrior = DEFAULT, count: int = DRAWS
) -> WeightDraws:
    """The posterior over omega given all demonstrations together.

    p(omega | demonstrations) is proportional to p(omega) prod_d p(d | omega); each demonstration has its own joined set.

    >>> from pipeline.choice import Boltzmann
    >>> choices = Choices.of_rows(Boltzmann(), [2, 2, 2], [[0.0], [0.5], [1.0]])
    >>> draws = sample_weights(np.random.default_rng(0), choices)
    >>> bool(draws.positive[0] > 0.9)
    True

    Args:
        rng: random stream; the same stream gives the same draws.
        choices: the demonstrations with their choice sets.
        prior: of omega.
        count: number of draws, at least 100.

    Returns:
        Weighted draws; `pareto_k` and `effective` say how far to trust them.

    Raises:
        ArgumentError: `count` is too small.
        WorkbenchError: no mode was found.
    """
    if count < 100:
        raise ArgumentError(f"count is {count}; 100 draws or more are needed.")
    modes = modes_by_scale(choices, prior)
    share = np.exp(modes.log_evidence - log_sum_exp(modes.log_evidence))
    share = np.maximum(share, _LEAST_SHARE)
    counts = np.maximum(np.round(count * share / share.sum()).astype(np.intp), 1)
    omega = np.concatenate(
        [
            student_draws(lattice(rng, size, choices.features + 1), mean, curvature)
            for size, mean, curvature in zip(counts, modes.omega, modes.curvature, strict=True)
        ]
    )
    log_ratio = choices.total(omega) + prior.log_density(omega) - _log_proposal(modes, counts, omega)
    log_weight, pareto_k = pareto_smoothed(log_ratio)
    return WeightDraws(omega, log_weight, pareto_k, float(log_sum_exp(log_ratio)) - math.log(len(omega)))


def modes_by_scale(choices: Choices, prior: WeightPrior) -> Modes:
    """The mode under each scale of the prior."""
    tau = np.array(prior.scales)
    return find_modes(choices, np.zeros((len(tau), choices.features)), tau)


def _log_proposal(modes: Modes, counts: NDArray[np.intp], omega: FloatArray) -> FloatArray:
    """(S,) log density of the mixture; every draw counts as drawn from the mixture as a whole."""
    log_share = np.log(counts / counts.sum())
    parts = [
        student_log_density(omega, mean, curvature) + log_part
        for mean, curvature, log_part in zip(modes.omega, modes.curvature, log_share, strict=True)
    ]
    return log_sum_exp(np.stack(parts, axis=1), axis=1)
