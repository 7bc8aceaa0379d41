"""The correction that a statistician would try first: Boltzmann with importance weights for the sampler's density."""

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
    """Log likelihood of demonstrations under Boltzmann whose alternatives have weights of their own.

    log p(d | theta, beta) = beta theta . phi_d - log sum_j w_j exp(beta theta . phi_j), up to a constant.

    With w_j = 1 / q_j the sum is an importance estimate of the integral over *all* trajectories. Apart from the sample,
    a demonstration is no draw and has no part in the sum; nothing then keeps its probability below one, and a
    demonstration better than all that was drawn speaks for the theta that says so without bound. Joined, as in every
    choice set of the other models, it is one more alternative; its density under the sampler is not known, so it gets
    the mean weight of the sample.

    Args:
        demonstrations: (n, F) scaled features.
        alternatives: (N, F) scaled features of what was drawn.
        log_weights: (N,) log w_j, up to a constant; -log q_j for importance weights.
        thetas: (K, F).
        betas: (B,).
        joined: whether each demonstration joins the sum.

    Returns:
        (n, K, B).
    """
    sums = log_sum_exp((np.einsum("kf,nf->kn", thetas, alternatives)[:, None] * betas[:, None]) + log_weights, axis=2)
    rewards = np.einsum("kf,nf->nk", thetas, demonstrations)[..., None] * betas
    if not joined:
        return np.asarray(rewards - sums)
    own = rewards + log_sum_exp(log_weights) - np.log(len(alternatives))
    return np.asarray(own - np.logaddexp(sums, own))


def effective_sample_size(log_weights: FloatArray) -> float:
    """(sum_j w_j)^2 / sum_j w_j^2, between 1 and N: how many equal weights would carry as much (Kish)."""
    return float(np.exp(2 * log_sum_exp(log_weights) - log_sum_exp(2 * log_weights)))


def weighted_score(problem: Problem, *, weighted: bool, joined: bool) -> Score:
    """Log likelihoods under Boltzmann, of samplings whose density is known.

    Args:
        problem: the hypotheses.
        weighted: by one over the density, or all alike.
        joined: see `weighted_log_likelihood`.
    """

    def score(demonstrations: FloatArray, sets: ChoiceSets, anchor: str) -> FloatArray:
        log_proposal = sets.log_proposals[anchor]
        log_weights = -log_proposal if weighted else np.zeros(len(log_proposal))
        return weighted_log_likelihood(
            demonstrations, sets.features[anchor], log_weights, problem.thetas, problem.betas, joined=joined
        )

    return score
