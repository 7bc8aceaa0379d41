"""Draws from the posterior over omega, by importance sampling from Student t's around the modes.

Under each scale of the prior the posterior has one mode. The proposal is a mixture of one t around each, in proportion
to Laplace's evidence, drawn from a shifted lattice; the weights are Pareto smoothed. Where too few draws count or their
tail is long, up to three rounds more are drawn around those that do. Chosen by measurement (`benchmarks/weights.py`):
the draws are independent, need no warm-up, and bring the evidence with them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import FloatArray, IndexArray
from pipeline.choice.logspace import log_sum_exp
from pipeline.choice.weights.choices import Likelihood
from pipeline.choice.weights.draws import WeightDraws
from pipeline.choice.weights.laplace import Modes, find_modes, lattice, student_draws, student_log_density
from pipeline.choice.weights.pareto import effective_draws, largest_good_shape, pareto_smoothed
from pipeline.choice.weights.prior import DEFAULT, WeightPrior
from pipeline.errors import ArgumentError

DRAWS = 4096
_ENOUGH = 0.3  # of the draws effective; with fewer, or a long tail, further rounds are drawn where the weights are
_ROUNDS = 3
_CENTRES = 40  # of a further round
_LEAST_SHARE = 0.1  # of the draws around each mode, however little evidence it has: Laplace may be wrong about that


def sample_weights(
    rng: np.random.Generator, choices: Likelihood, prior: WeightPrior = DEFAULT, count: int = DRAWS
) -> WeightDraws:
    """The posterior over omega given all demonstrations together.

    p(omega | demonstrations) is proportional to p(omega) prod_d p(d | omega); each demonstration has its own joined
    set.

    >>> from pipeline.choice import Boltzmann
    >>> from pipeline.choice.weights import Choices
    >>> choices = Choices.of_rows(Boltzmann(), [2, 2, 2], [[0.0], [0.5], [1.0]])
    >>> draws = sample_weights(np.random.default_rng(0), choices)
    >>> bool(draws.positive[0] > 0.9)
    True

    Args:
        rng: random stream; the same stream gives the same draws.
        choices: the demonstrations with their choice sets.
        prior: of omega.
        count: number of draws of a round, at least 100.

    Returns:
        Weighted draws; `pareto_k` and `effective` say how far to trust them.

    Raises:
        ArgumentError: `count` is too small.
        WorkbenchError: no mode was found.
    """
    if count < 100:
        raise ArgumentError(f"count is {count}; 100 draws or more are needed.")
    proposal = _around_modes(choices, prior, count)
    omega = proposal.draw(rng)
    log_joint = choices.total(omega) + prior.log_density(omega)
    for round_number in range(_ROUNDS + 1):
        # every draw counts as drawn from the mixture of all rounds
        log_ratio = log_joint - proposal.log_density(omega)
        log_weight, pareto_k = pareto_smoothed(log_ratio)
        good = pareto_k <= largest_good_shape(len(omega)) and effective_draws(log_weight) >= _ENOUGH * len(omega)
        if good or round_number == _ROUNDS:
            break
        further = _around_draws(rng, omega, log_weight, prior, count)
        added = further.draw(rng)
        proposal = proposal + further
        omega = np.concatenate([omega, added])
        log_joint = np.concatenate([log_joint, choices.total(added) + prior.log_density(added)])
    return WeightDraws(omega, log_weight, pareto_k, float(log_sum_exp(log_ratio)) - math.log(len(omega)))


def modes_by_scale(choices: Likelihood, prior: WeightPrior) -> Modes:
    """The mode under each scale of the prior."""
    tau = np.array(prior.scales)
    return find_modes(choices, np.zeros((len(tau), choices.features)), tau)


@dataclass(frozen=True, eq=False)
class _Mixture:
    """Student t's, and how many draws each gives.

    Attributes:
        mean: (C, F).
        curvature: (C, F, F).
        count: (C,).
    """

    mean: FloatArray
    curvature: FloatArray
    count: IndexArray

    def __add__(self, other: _Mixture) -> _Mixture:
        return _Mixture(
            np.concatenate([self.mean, other.mean]),
            np.concatenate([self.curvature, other.curvature]),
            np.concatenate([self.count, other.count]),
        )

    def draw(self, rng: np.random.Generator) -> FloatArray:
        """Its draws, in the order of the components."""
        size = self.mean.shape[1]
        points = np.concatenate([lattice(rng, int(count), size + 1) for count in self.count])
        return student_draws(
            points, np.repeat(self.mean, self.count, axis=0), np.repeat(self.curvature, self.count, axis=0)
        )

    def log_density(self, omega: FloatArray) -> FloatArray:
        """(S,) log density at the points (S, F)."""
        log_share = np.log(self.count / self.count.sum())
        total = np.full(len(omega), -np.inf)
        for mean, curvature, log_part in zip(self.mean, self.curvature, log_share, strict=True):
            np.logaddexp(total, student_log_density(omega, mean, curvature) + log_part, out=total)
        return total


def _around_modes(choices: Likelihood, prior: WeightPrior, count: int) -> _Mixture:
    """A t around the mode under each scale, in proportion to Laplace's evidence."""
    modes = modes_by_scale(choices, prior)
    share = np.exp(modes.log_evidence - log_sum_exp(modes.log_evidence))
    return _Mixture(modes.omega, modes.curvature, _whole(count, np.maximum(share, _LEAST_SHARE)))


def _around_draws(
    rng: np.random.Generator, omega: FloatArray, log_weight: FloatArray, prior: WeightPrior, count: int
) -> _Mixture:
    """Narrower t's around some of the draws, for a posterior that is no ellipsoid: at the rim of a set it is a cone.

    Source: Cornuet, Marin, Mira and Robert (2012), Adaptive multiple importance sampling, arXiv 0907.1254.
    """
    size = omega.shape[1]
    relative = prior.log_components(omega) - prior.log_density(omega)[:, None]
    by_scale = np.exp(log_weight[:, None] + relative) / len(prior.scales)
    parts = []
    for column, total in zip(by_scale.T, by_scale.sum(axis=0), strict=True):
        centres = round(_CENTRES * total)
        if not centres:
            continue
        share = column / total
        mean = share @ omega
        spread = np.einsum("s,sf,sg->fg", share, omega - mean, omega - mean)
        width = centres ** (-1 / (size + 4))  # of a kernel density estimate
        places = (rng.random() + np.arange(centres)) / centres
        rows = np.minimum(np.searchsorted(np.cumsum(share), places), len(omega) - 1)
        floor = 1e-12 * np.trace(spread) * np.eye(size)
        curvature = np.linalg.inv(width**2 * spread + floor)
        counts = _whole(round(count * total), np.ones(centres))
        parts.append(_Mixture(omega[rows], np.repeat(curvature[None], centres, axis=0), counts))
    return sum(parts[1:], start=parts[0])


def _whole(count: int, share: FloatArray) -> IndexArray:
    """About `count` draws in proportion to `share`, one at least each."""
    return np.asarray(np.maximum(np.round(count * share / share.sum()).astype(np.intp), 1))
