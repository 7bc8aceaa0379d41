"""Choices from sets of different sizes."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.choice import Boltzmann, log_probabilities
from pipeline.choice.conditional_logit import ChoiceSets
from pipeline.errors import ArgumentError

RNG = np.random.default_rng(5)
FEATURES = RNG.normal(size=(90, 2))
STARTS = np.array([0, 2, 10, 20, 50, 60, 75])
CHOSEN = np.array([1, 3, 15, 21, 55, 70, 80])
SETS = ChoiceSets(FEATURES, STARTS, CHOSEN)
LOG_W = RNG.normal(size=90)


def test_each_set_has_the_probabilities_that_it_has_alone() -> None:
    weights = np.array([0.4, -0.3])
    together = SETS.log_probabilities(weights, np.zeros(90))
    for first, last in zip(STARTS, [*STARTS[1:], 90], strict=True):
        alone = log_probabilities(Boltzmann(), FEATURES[first:last], weights)
        np.testing.assert_allclose(together[first:last], alone, atol=1e-12)


def test_a_constant_per_set_changes_nothing() -> None:
    constant = np.repeat(RNG.normal(size=7) * 100, np.diff([*STARTS, 90]))
    np.testing.assert_allclose(SETS.estimate(LOG_W + constant), SETS.estimate(LOG_W), atol=1e-6)


def test_no_step_away_from_the_estimate_is_better_and_counts_repeat() -> None:
    often = np.array([1.0, 2.0, 0.0, 1.0, 3.0, 1.0, 1.0])
    best = SETS.estimate(LOG_W, often)
    at_best = often @ SETS.log_probabilities(best, LOG_W)[CHOSEN]
    for step in ([1e-3, 0.0], [-1e-3, 0.0], [0.0, 1e-3], [0.0, -1e-3]):
        assert often @ SETS.log_probabilities(best + step, LOG_W)[CHOSEN] < at_best


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(ArgumentError, match="from that set"):
        ChoiceSets(FEATURES, STARTS, CHOSEN[::-1].copy())
    with pytest.raises(ArgumentError, match="begin with 0"):
        ChoiceSets(FEATURES, STARTS + 1, CHOSEN)
    with pytest.raises(ArgumentError, match="log_w"):
        SETS.estimate(LOG_W[1:])
