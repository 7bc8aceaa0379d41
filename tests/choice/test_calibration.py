"""Does the posterior mean what it says? Choices are simulated from known hypotheses and inferred back."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

from pipeline.choice import LESS, Boltzmann, log_likelihood, log_probabilities, posterior_from, theta_grid

THETAS, BETAS = theta_grid([[0, 0.5, 1]] * 3), np.array([1.0, 3.0, 10.0])
RUNS, CHOICES = 600, 3


def truths_and_posteriors(model, inferred_by) -> tuple[np.ndarray, np.ndarray]:
    """RUNS hypotheses drawn from the prior, CHOICES choices each, and the posteriors (RUNS, K B)."""
    rng = np.random.default_rng(11)
    # A dense clump and a thin cloud: models that differ must show it.
    rows = np.vstack([rng.normal(0.3, 0.02, size=(60, 3)), rng.random(size=(60, 3))])
    log_p = np.array([[log_probabilities(model, rows, theta, beta) for beta in BETAS] for theta in THETAS])
    log_p = log_p.reshape(-1, len(rows))
    likelihood = log_likelihood(inferred_by, np.arange(len(rows)), rows, THETAS, BETAS)
    truths = rng.integers(len(log_p), size=RUNS)
    posteriors = []
    for truth in truths:
        chosen = rng.choice(len(rows), size=CHOICES, p=np.exp(log_p[truth]))
        posteriors.append(posterior_from(likelihood[chosen], THETAS, BETAS).log_probability.ravel())
    return truths, np.exp(posteriors)


def hits(level: float, truths: np.ndarray, posteriors: np.ndarray) -> int:
    """How often the credible set of the most probable hypotheses holds the truth.

    Its last hypothesis belongs to it by lot, with the probability that makes the set hold `level` exactly.
    """
    lots = np.random.default_rng(12).random(len(truths))
    count = 0
    for truth, posterior, lot in zip(truths, posteriors, lots, strict=True):
        order = np.argsort(-posterior, kind="stable")
        place = int(np.flatnonzero(order == truth)[0])
        count += posterior[order[:place]].sum() + lot * posterior[truth] < level
    return count


@pytest.mark.parametrize("level", [0.5, 0.8, 0.95])
@pytest.mark.parametrize("model", [Boltzmann(), LESS(0.1)], ids=lambda model: model.name)
def test_credible_sets_hold_the_truth_at_their_rate(model, level: float) -> None:
    """Within the central 99.9 % of the binomial distribution of the number of hits."""
    count = hits(level, *truths_and_posteriors(model, model))
    assert binom.ppf(0.0005, RUNS, level) <= count <= binom.ppf(0.9995, RUNS, level)


def test_the_wrong_model_is_found_out() -> None:
    """The same check fails for Boltzmann inference on LESS choices: it can tell."""
    count = hits(0.8, *truths_and_posteriors(LESS(0.1), Boltzmann()))
    assert count < binom.ppf(0.0005, RUNS, 0.8)
