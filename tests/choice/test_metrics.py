from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import rel_entr

from pipeline.choice import angle_to, entropy, kl_aggregate, true_match, true_posterior
from pipeline.choice.metrics import divergences
from pipeline.errors import ArgumentError
from tests.oracles.slow_robustness import kl_aggregate as slow_kl_aggregate


def test_true_posterior_and_match() -> None:
    marginal = [0.1, 0.6, 0.3]
    assert [true_posterior(marginal, k) for k in range(3)] == marginal
    assert [true_match(marginal, k) for k in range(3)] == [0, 1, 0]


def test_a_tie_counts_as_a_fair_draw() -> None:
    """Three hypotheses that differ in rounding only share the match; the fourth has none."""
    marginal = np.array([0.3, 0.3 * (1 + 1e-14), 0.3, 0.1])
    assert [true_match(marginal, k) for k in range(4)] == [1 / 3, 1 / 3, 1 / 3, 0]


def test_entropy() -> None:
    assert entropy([0.25] * 4) == pytest.approx(math.log(4), rel=1e-15)
    assert entropy([0.0, 1.0]) == 0


def test_kl_aggregate_is_the_sum_over_ordered_pairs() -> None:
    posteriors = np.random.default_rng(0).dirichlet(np.ones(5), size=7)
    expected = math.fsum(rel_entr(p, q).sum() for p in posteriors for q in posteriors)
    assert kl_aggregate(np.log(posteriors)) == pytest.approx(expected, rel=1e-12)
    assert kl_aggregate(np.log(posteriors[[0, 0, 0]])) == 0


def test_kl_aggregate_beyond_what_probabilities_can_hold() -> None:
    """P = (1, e^-1000), Q = (e^-1000, 1): 1000 each way, though e^-1000 is 0 in double precision."""
    assert kl_aggregate([[0.0, -1000.0], [-1000.0, 0.0]]) == 2000


def test_kl_aggregate_is_infinite_only_where_a_probability_is_zero() -> None:
    assert kl_aggregate([[0.0, -math.inf], [math.log(0.5)] * 2]) == math.inf
    assert kl_aggregate([[0.0, -math.inf], [0.0, -math.inf]]) == 0


def test_divergences_of_many_sets_of_posteriors_at_once() -> None:
    p = np.random.default_rng(1).dirichlet(np.ones(7), (2, 5))
    pairs = divergences(np.log(p))
    assert pairs.shape == (2, 5, 5)
    for of_set, posteriors in zip(pairs, p, strict=True):
        assert of_set.sum() == pytest.approx(slow_kl_aggregate(posteriors.tolist()), rel=1e-12)
        assert of_set[1, 3] == pytest.approx(rel_entr(posteriors[1], posteriors[3]).sum(), rel=1e-12)
    impossible = np.array([[0.0, -1000.0], [0.0, -math.inf]])
    np.testing.assert_array_equal(divergences(impossible), [[0.0, math.inf], [0.0, 0.0]])


def test_angles() -> None:
    assert angle_to([1, 0], [0, 2]) == pytest.approx(math.pi / 2, rel=1e-15)
    assert angle_to([3, 3], [1, 1]) == 0
    assert angle_to([1, 0], [-5, 0]) == pytest.approx(math.pi, rel=1e-15)
    assert angle_to([1, 0], [1, 1e-9]) == pytest.approx(1e-9, rel=1e-6)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: true_posterior([0.5, 0.6], 0), "marginal sums to 1.1"),
        (lambda: true_posterior([1.5, -0.5], 0), "marginal sums to 1"),
        (lambda: true_posterior([math.nan, 1.0], 0), "marginal contains nan"),
        (lambda: true_match([0.5, 0.5], 2), "k is 2; a row between 0 and 1"),
        (lambda: true_match([0.5, 0.5], -1), "k is -1"),
        (lambda: true_match([0.5, 0.5], True), "k is True"),
        (lambda: entropy([]), "marginal has shape"),
        (lambda: kl_aggregate([0.0]), r"log_posteriors has shape \(1,\)"),
        (lambda: kl_aggregate([[0.5, 0.5]]), "do not sum to one"),
        (lambda: kl_aggregate([[math.nan, 0.0]]), "do not sum to one"),
        (lambda: angle_to([0.0, 0.0], [1.0, 0.0]), "theta_hat is the zero vector"),
        (lambda: angle_to([1.0, 0.0], [1.0]), "theta has 1 entries where 2"),
    ],
)
def test_refusals(call, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        call()
