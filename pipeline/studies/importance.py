"""The correction that a statistician would try first: Boltzmann with importance weights for the sampler's density."""

from __future__ import annotations

import numpy as np

from pipeline.choice.logspace import log_sum_exp
from pipeline.studies.choice_sets import Array, ChoiceSets, Problem, Score


def weighted_log_likelihood(
    demonstrations: Array, alternatives: Array, log_proposal: Array, thetas: Array, betas: Array
) -> Array:
    """Log likelihood of demonstrations under Boltzmann over *all* trajectories, from a weighted sample of them.

    log p(d | theta, beta) = beta theta . phi_d - log [ 1/N sum_j exp(beta theta . phi_j) / q_j ], an importance
    estimate of the integral over trajectories. The demonstration has no density under the sampler, so it is not one
    of the draws and, unlike in a finite choice set, has no part in the sum. Defined up to a constant.

    Args:
        demonstrations: (n, F) scaled features.
        alternatives: (N, F) scaled features of what was drawn.
        log_proposal: (N,) log q_j, up to a constant.
        thetas: (K, F).
        betas: (B,).

    Returns:
        (n, K, B).
    """
    log_w = -log_proposal - np.log(len(alternatives))
    rewards = np.einsum("kf,nf->kn", thetas, alternatives)
    log_integral = log_sum_exp(rewards[:, None] * betas[:, None] + log_w, axis=2)
    return np.asarray(np.einsum("kf,nf->nk", thetas, demonstrations)[..., None] * betas - log_integral)


def effective_sample_size(log_weights: Array) -> float:
    """(sum_j w_j)^2 / sum_j w_j^2, between 1 and N: how many equal weights would carry as much (Kish)."""
    return float(np.exp(2 * log_sum_exp(log_weights) - log_sum_exp(2 * log_weights)))


def weighted_score(problem: Problem) -> Score:
    """Log likelihoods under importance-weighted Boltzmann, of samplings whose density is known."""

    def score(demonstrations: Array, sets: ChoiceSets, anchor: str) -> Array:
        return weighted_log_likelihood(
            demonstrations, sets.features[anchor], sets.log_proposals[anchor], problem.thetas, problem.betas
        )

    return score
