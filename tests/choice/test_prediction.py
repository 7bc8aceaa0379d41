from __future__ import annotations

import numpy as np
import pytest

from pipeline.choice import LESS, Boltzmann, infer, predict
from pipeline.choice.prediction import (
    effective_alternatives,
    most_probable,
    predicted_interval,
    predictive,
    predictive_check,
)
from pipeline.choice.weights import Choices, sample_weights
from pipeline.choice.weights.held_out import leave_one_out
from pipeline.errors import ArgumentError

RNG = np.random.default_rng(2)
ROWS = RNG.random((50, 3))
THETAS, BETAS = RNG.normal(size=(4, 3)), np.array([0.5, 3.0])


@pytest.mark.parametrize("model", [Boltzmann(), LESS(0.2)], ids=lambda model: model.name)
def test_a_grid_is_a_set_of_draws(model) -> None:
    posterior = infer(model, [3, 4], ROWS, THETAS, BETAS)
    omegas = (THETAS[:, None] * BETAS[:, None]).reshape(-1, 3)
    found = predictive(ROWS, model.log_weights(ROWS), omegas, np.exp(posterior.log_probability).ravel())
    np.testing.assert_allclose(found, predict(posterior, model, ROWS), rtol=1e-12)
    assert found.sum() == pytest.approx(1)


def test_several_posteriors_at_once_and_large_weights() -> None:
    omegas = RNG.normal(size=(5, 3)) * 1e3
    weights = RNG.random((2, 5))
    both = predictive(ROWS, np.zeros(50), omegas, weights)
    for row, weight in zip(both, weights, strict=True):
        np.testing.assert_allclose(row, predictive(ROWS, np.zeros(50), omegas, weight))


def test_tubes_are_pointwise_quantiles() -> None:
    positions = RNG.normal(size=(2000, 4, 3)) + np.arange(4)[:, None]
    tube = predicted_interval(positions, np.full(2000, 1 / 2000), 0.9)
    assert tube.median.shape == (4, 3)
    np.testing.assert_allclose(tube.upper - tube.lower, 2 * 1.645, atol=0.3)
    np.testing.assert_array_equal(tube.lower < tube.median, True)
    one = predicted_interval(positions, np.eye(2000)[7], 0.9)
    np.testing.assert_allclose(one.median, positions[7])


def test_the_most_probable_stand_for_their_neighbourhoods() -> None:
    """A hundred near-copies share probability 0.6: together they come first, though each has little."""
    rows = np.vstack([np.full((100, 2), 0.2) + RNG.normal(size=(100, 2)) * 1e-3, [[0.8, 0.8]], [[0.5, 0.0]]])
    p = np.append(np.full(100, 0.006), [0.3, 0.1])
    found = most_probable(rows, p, 5, radius=0.05)
    assert found.rows[0] < 100
    np.testing.assert_array_equal(found.rows[1:], [100, 101])
    np.testing.assert_allclose(found.probability, [0.6, 0.3, 0.1])
    np.testing.assert_array_equal(most_probable(rows, p, 2, radius=0.0).rows, [100, 101])


def test_checks_are_uniform_where_the_prediction_is_right() -> None:
    rows = RNG.random((4000, 2))
    p = np.exp(-3 * rows[:, 0])
    p /= p.sum()
    check = predictive_check(rows, p, rows[RNG.choice(4000, 1000, p=p)])
    assert np.all(np.abs(check.beyond(0.1) / 1000 - 0.1) < 0.03)
    np.testing.assert_allclose(check.place.mean(axis=0), 0.5, atol=0.03)


def test_checks_find_people_beyond_what_was_predicted() -> None:
    check = predictive_check(ROWS, np.full(50, 0.02), [[2.0, 0.5, 0.5], [-1.0, 0.5, 0.5]])
    np.testing.assert_allclose(check.p_value[:, 0], 0, atol=1e-12)
    np.testing.assert_array_equal(check.beyond(), [2, 0, 0])
    np.testing.assert_allclose(check.place[:, 0], [1, 0], atol=1e-12)


def test_taking_one_out_is_what_inference_without_it_gives() -> None:
    rows = [3, 8, 20, 41, 5]
    choices = Choices.of_rows(LESS(0.2), rows, ROWS)
    draws = sample_weights(np.random.default_rng(0), choices, count=40_000)
    values = choices.log_likelihood(draws.omega)
    found = leave_one_out(draws, values)
    for index in range(len(rows)):
        without = sample_weights(
            np.random.default_rng(1), choices.subset([i for i in range(5) if i != index]), count=40_000
        )
        expected = np.log(without.weight @ np.exp(choices.log_likelihood(without.omega)[:, index]))
        assert found.score.log_predictive[index] == pytest.approx(expected, abs=0.01)
        np.testing.assert_allclose(np.exp(found.log_weight[index]) @ draws.omega, without.mean, atol=0.15)
    assert np.all(found.pareto_k < 0.7)


def test_effective_alternatives() -> None:
    assert effective_alternatives([0.25] * 4) == pytest.approx(4)
    assert effective_alternatives([1.0, 0.0]) == pytest.approx(1)


def test_refusals() -> None:
    with pytest.raises(ArgumentError, match="weights must be"):
        predictive(ROWS, np.zeros(50), THETAS, [1.0])
    with pytest.raises(ArgumentError, match="level"):
        predicted_interval(ROWS, np.full(50, 0.02), 1.0)
    with pytest.raises(ArgumentError, match="count"):
        most_probable(ROWS, np.full(50, 0.02), 0, 0.1)
    with pytest.raises(ArgumentError, match="two or more"):
        leave_one_out(
            sample_weights(np.random.default_rng(0), Choices.of_rows(Boltzmann(), [1], ROWS)), np.zeros((2, 1))
        )
