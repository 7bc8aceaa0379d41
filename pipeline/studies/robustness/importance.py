"""Boltzmann with importance weights for the sampler's density: the usual correction for uneven samples."""

from __future__ import annotations

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.choice.logspace import log_sum_exp
from pipeline.studies.robustness.problem import ChoiceSets, Problem, Score


def weighted_log_likelihood(
    demonstrations: FloatArray,
    alternatives: FloatArray,
    log_weights: FloatArray,
    thetas: FloatArray,
    betas: FloatArray,
    *,
    joined: bool,
) -> FloatArray:
    """Log likelihood of demonstrations under Boltzmann with a weight for each alternative.

    log p(d | theta, beta) = beta theta . phi_d - log sum_j w_j exp(beta theta . phi_j), up to a constant.

    With w_j = 1 / q_j the sum is an importance estimate of the integral over *all* trajectories. If the demonstration
    does not join the sum, nothing keeps its probability below one: a demonstration that is better than all alternatives
    under some theta is evidence for that theta without bound. If it joins, as in the choice sets of the other models,
    it is one more alternative. Its density under the sampler is not known, so it gets the mean weight of the sample.

    Args:
        demonstrations: (n, F) scaled features.
        alternatives: (N, F) scaled features of the alternatives.
        log_weights: (N,) log w_j, up to a constant; -log q_j for importance weights.
        thetas: (K, F) reward weights.
        betas: (B,) inverse temperatures.
        joined: whether each demonstration joins the sum.

    Returns:
        (n, K, B) log likelihoods.
    """
    sums = log_sum_exp((np.einsum("kf,nf->kn", thetas, alternatives)[:, None] * betas[:, None]) + log_weights, axis=2)
    rewards = np.einsum("kf,nf->nk", thetas, demonstrations)[..., None] * betas
    if not joined:
        return np.asarray(rewards - sums)
    joining = rewards + log_sum_exp(log_weights) - np.log(len(alternatives))
    return np.asarray(joining - np.logaddexp(sums, joining))


def effective_sample_size(log_weights: FloatArray) -> float:
    """Kish's effective sample size, (sum_j w_j)^2 / sum_j w_j^2, between 1 and N."""
    return float(np.exp(2 * log_sum_exp(log_weights) - log_sum_exp(2 * log_weights)))


def weighted_score(problem: Problem, *, weighted: bool, joined: bool) -> Score:
    """Log likelihoods under Boltzmann, for samplings whose density is known.

    Args:
        problem: the hypotheses.
        weighted: whether alternatives are weighted by one over the sampler's density, or all equally.
        joined: whether each demonstration joins the sum; see `weighted_log_likelihood`.
    """

    def score(demonstrations: FloatArray, sets: ChoiceSets, anchor: str) -> FloatArray:
        log_proposal = sets.log_proposals[anchor]
        log_weights = -log_proposal if weighted else np.zeros(len(log_proposal))
        return weighted_log_likelihood(
            demonstrations, sets.features[anchor], log_weights, problem.thetas, problem.betas, joined=joined
        )

    return score
