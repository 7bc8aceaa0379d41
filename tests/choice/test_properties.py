"""What must hold for every choice set, whatever its numbers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pipeline.choice import (
    LESS,
    AttributeRule,
    Boltzmann,
    infer,
    log_density,
    log_likelihood,
    log_probabilities,
    predict,
)  # fmt: skip

# Multiples of 1/64: sums and differences of features are exact, and ties are common.
EXACT = st.integers(-256, 256).map(lambda value: value / 64)
SETS = st.integers(1, 25).flatmap(lambda count: arrays(float, (count, 2), elements=EXACT))
THETA = arrays(float, 2, elements=EXACT)
BETA = st.floats(1e-3, 1e3)
SIGMA = st.floats(1e-3, 1e3)
MODEL = st.one_of(st.just(Boltzmann()), st.just(AttributeRule()), SIGMA.map(LESS))


@given(SETS, THETA, BETA, MODEL)
def test_probabilities_sum_to_one(rows, theta, beta, model) -> None:
    assert np.exp(log_probabilities(model, rows, theta, beta)).sum() == pytest.approx(1, abs=1e-12)
    posterior = infer(model, rows[:1] + 1 / 64, rows, [theta, -theta], [beta, 2 * beta])
    assert posterior.marginal_theta.sum() == pytest.approx(1, abs=1e-12)
    assert predict(posterior, model, rows).sum() == pytest.approx(1, abs=1e-12)


@given(SETS, THETA, BETA, MODEL, st.integers(-(2**20), 2**20))
def test_a_constant_added_to_every_reward_changes_nothing(rows, theta, beta, model, shift) -> None:
    before = log_likelihood(model, rows[:1] + 1 / 64, rows, [theta], [beta])
    after = log_likelihood(model, rows[:1] + 1 / 64 + shift, rows + shift, [theta], [beta])
    np.testing.assert_array_equal(after, before)


@given(SETS, THETA, BETA, MODEL, st.randoms(use_true_random=False))
def test_the_order_of_alternatives_does_not_matter(rows, theta, beta, model, random) -> None:
    order = np.array(random.sample(range(len(rows)), len(rows)))
    before, after = (log_probabilities(model, set_, theta, beta) for set_ in (rows, rows[order]))
    np.testing.assert_allclose(after, before[order], rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(model.log_weights(rows[order]), model.log_weights(rows)[order])
    outside = rows[:1] + 1 / 64
    np.testing.assert_allclose(
        infer(model, outside, rows[order], [theta, -theta], [beta]).log_probability,
        infer(model, outside, rows, [theta, -theta], [beta]).log_probability,
        rtol=1e-10, atol=1e-10,
    )  # fmt: skip


@given(st.integers(3, 40), st.floats(0.2, 5.0), THETA, BETA)
def test_a_constant_density_is_boltzmann(count, sigma, theta, beta) -> None:
    """Equally spaced on a circle of similarity, every alternative is as crowded as every other."""
    angle = 2 * np.pi * np.arange(count) / count
    circle, rows = np.column_stack([np.cos(angle), np.sin(angle)]), np.column_stack([angle, angle**2])
    choice = (
        LESS(sigma).log_weights(rows, similarity=circle),
        log_probabilities(LESS(sigma), rows, theta, beta, similarity=circle),
    )
    assert np.ptp(choice[0]) < 1e-12
    np.testing.assert_allclose(choice[1], log_probabilities(Boltzmann(), rows, theta, beta), rtol=1e-12, atol=1e-11)


@given(SETS, THETA, BETA)
def test_a_duplicate_out_of_reach_leaves_the_pair_its_total(rows, theta, beta) -> None:
    """The lone alternative is 1000 away: its kernel value at the others is exactly zero."""
    lone = np.array([[1000.0, 0.0]])
    theta = theta * [0.001, 1.0]  # rewards of the lone one comparable to the others'
    once, twice = np.vstack([rows, lone]), np.vstack([rows, lone, lone])
    less = [np.exp(log_probabilities(LESS(1.0), set_, theta, beta)) for set_ in (once, twice)]
    assert less[1][-2:].sum() == pytest.approx(less[0][-1], rel=1e-11, abs=1e-300)
    p, pair = (np.exp(log_probabilities(Boltzmann(), set_, theta, beta)) for set_ in (once, twice))
    assert pair[-2:].sum() == pytest.approx(2 * p[-1] / (1 + p[-1]), rel=1e-11, abs=1e-300)
    assert pair[-2:].sum() >= p[-1] * (1 - 1e-14)


@given(SETS)
def test_a_vanishing_bandwidth_is_the_attribute_rule_and_boltzmann_without_ties(rows) -> None:
    np.testing.assert_allclose(LESS(1e-4).log_weights(rows), AttributeRule().log_weights(rows), rtol=1e-15, atol=0)
    distinct = np.unique(rows, axis=0)
    np.testing.assert_array_equal(LESS(1e-4).log_weights(distinct), Boltzmann().log_weights(distinct))


@given(SETS)
def test_a_huge_bandwidth_is_boltzmann(rows) -> None:
    """All kernel values are 1 to within d^2 / 2 sigma^2 < 1e-8: all are equally crowded."""
    assert np.ptp(LESS(1e5).log_weights(rows)) < 1e-8


@given(SETS, SIGMA, SIGMA)
def test_density_grows_with_the_bandwidth_and_stays_in_its_bounds(rows, sigma, other) -> None:
    narrow, wide = log_density(rows, min(sigma, other)), log_density(rows, max(sigma, other))
    assert np.all(narrow <= wide + 1e-12)
    assert np.all(narrow >= 0)
    assert np.all(wide <= np.log(len(rows)) + 1e-12)


@given(SETS, THETA, BETA, MODEL)
def test_beta_and_theta_enter_as_a_product(rows, theta, beta, model) -> None:
    np.testing.assert_allclose(
        log_probabilities(model, rows, theta, beta), log_probabilities(model, rows, beta * theta, 1.0),
        rtol=1e-11, atol=1e-11,
    )  # fmt: skip
