from __future__ import annotations

import math

import numpy as np
import pytest

from pipeline.choice import LESS, Boltzmann, compare_held_out, held_out_from, held_out_score, log_likelihood, theta_grid
from pipeline.errors import ArgumentError
from tests.oracles import slow_choice

RNG = np.random.default_rng(4)
ALTERNATIVES, OUTSIDE = RNG.normal(size=(30, 2)), RNG.normal(size=(5, 2))
THETAS, BETAS = theta_grid([[0, 1], [-1, 0, 1]]), [0.3, 3.0]


def test_equals_the_slow_loop() -> None:
    log_prior = RNG.normal(size=(len(THETAS), 2))
    score = held_out_score(LESS(0.5), OUTSIDE, ALTERNATIVES, THETAS, BETAS, log_prior)
    likelihoods = log_likelihood(LESS(0.5), OUTSIDE, ALTERNATIVES, THETAS, BETAS)
    expected = slow_choice.held_out(likelihoods, log_prior)
    np.testing.assert_allclose(score.log_predictive, expected, rtol=1e-12)
    assert score.total == pytest.approx(math.fsum(expected), rel=1e-12)
    assert score.mean == pytest.approx(math.fsum(expected) / 5, rel=1e-12)
    variance = math.fsum((value - score.mean) ** 2 for value in expected) / 4
    assert score.standard_error == pytest.approx(math.sqrt(variance / 5), rel=1e-10)


def test_one_hypothesis_leaves_nothing_to_learn() -> None:
    score = held_out_score(Boltzmann(), [1, 2], ALTERNATIVES, [[1.0, 0.0]], [2.0])
    np.testing.assert_allclose(
        score.log_predictive, log_likelihood(Boltzmann(), [1, 2], ALTERNATIVES, [[1.0, 0.0]], [2.0])[:, 0, 0]
    )


def test_a_huge_likelihood_does_not_drown_the_others() -> None:
    """The first demonstration's 1e17 would swallow the 1.5 of the second in a sum."""
    values = np.array([[[-1e17], [-1e17]], [[0.0], [-1.5]], [[-0.5], [-1.0]]])
    score = held_out_from(values)
    assert score.log_predictive[0] == -1e17
    assert score.log_predictive[2] == pytest.approx(slow_choice.held_out(values[1:], np.zeros((2, 1)))[1], rel=1e-12)


def test_paired_differences() -> None:
    a = held_out_score(LESS(0.5), OUTSIDE, ALTERNATIVES, THETAS, BETAS)
    b = held_out_score(Boltzmann(), OUTSIDE, ALTERNATIVES, THETAS, BETAS)
    difference = compare_held_out(a, b)
    np.testing.assert_array_equal(difference.log_predictive, a.log_predictive - b.log_predictive)
    assert difference.mean == pytest.approx(a.mean - b.mean, rel=1e-10)
    assert difference.standard_error < a.standard_error + b.standard_error
    assert compare_held_out(a, a).standard_error == 0


def test_refusals() -> None:
    with pytest.raises(ArgumentError, match="two or more"):
        held_out_score(Boltzmann(), [1], ALTERNATIVES, THETAS)
    with pytest.raises(ArgumentError, match="needs the same ones"):
        compare_held_out(held_out_from(np.zeros((2, 1, 1))), held_out_from(np.zeros((3, 1, 1))))
