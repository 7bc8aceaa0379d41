"""KLAggregate and the posteriors it compares, as the paper writes them: loops, no log space, one number at a time."""

from __future__ import annotations

from math import exp, log


def marginals(demonstrations, alternatives, thetas, betas, bandwidth=None):
    """P(theta | demonstrations), beta summed out; LESS if a bandwidth is given, else Boltzmann."""
    joint = []
    for theta in thetas:
        total = 0.0
        for beta in betas:
            likelihood = 1.0
            for demonstration in demonstrations:
                options = [list(demonstration)] + [list(phi) for phi in alternatives]
                weights = [1.0 if bandwidth is None else 1 / _crowding(phi, options, bandwidth) for phi in options]
                exponentials = [
                    w * exp(beta * sum(t * f for t, f in zip(theta, phi, strict=True)))
                    for w, phi in zip(weights, options, strict=True)
                ]
                likelihood *= exponentials[0] / sum(exponentials)
            total += likelihood
        joint.append(total)
    return [value / sum(joint) for value in joint]


def kl_aggregate(posteriors):
    """- sum_P sum_Q sum_k P_k log (Q_k / P_k)."""
    return -sum(p_k * log(q_k / p_k) for p in posteriors for q in posteriors for p_k, q_k in zip(p, q, strict=True))


def _crowding(phi, options, bandwidth):
    return sum(
        exp(-sum((a - b) ** 2 for a, b in zip(phi, other, strict=True)) / (2 * bandwidth**2)) for other in options
    )
