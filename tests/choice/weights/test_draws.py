from __future__ import annotations

import numpy as np
import pytest

from pipeline.choice.weights import WeightDraws, weighted_quantiles
from pipeline.errors import ArgumentError


def normal_draws(mean, count: int = 20_000) -> WeightDraws:
    omega = np.random.default_rng(0).normal(size=(count, len(mean))) + np.array(mean)
    return WeightDraws(omega, np.full(count, -np.log(count)), 0.1, 0.0)


def test_summaries_of_a_known_cloud() -> None:
    draws = normal_draws([-3.0, 0.0, 4.0])
    np.testing.assert_allclose(draws.mean, [-3, 0, 4], atol=0.03)
    np.testing.assert_allclose(draws.interval(0.9)[:, 1] - draws.interval(0.9)[:, 0], 2 * 1.645, atol=0.06)
    np.testing.assert_allclose(draws.positive, [0.00135, 0.5, 1 - 3e-5], atol=0.01)
    low, high = draws.beta_interval(0.8)
    assert low < 5 < high
    np.testing.assert_allclose(np.linalg.norm(draws.direction), 1)
    assert draws.effective == pytest.approx(20_000)


def test_a_cap_holds_its_level() -> None:
    draws = normal_draws([-3.0, 0.0, 4.0])
    radius = draws.cap(0.9)
    on_the_rim = np.cos(radius) * draws.direction + np.sin(radius) * np.array([0.0, 1.0, 0.0])
    assert draws.within(on_the_rim) == pytest.approx(0.9, abs=0.01)
    assert draws.within(draws.direction) == pytest.approx(0, abs=1e-3)
    assert draws.within(-draws.direction) == pytest.approx(1)


def test_equal_weight_draws_keep_the_distribution() -> None:
    omega = np.arange(4.0)[:, None]
    draws = WeightDraws(omega, np.log([0.1, 0.2, 0.3, 0.4]), 0.1, 0.0)
    values, counts = np.unique(draws.resampled(np.random.default_rng(1), 1000), return_counts=True)
    np.testing.assert_array_equal(values, [0, 1, 2, 3])
    np.testing.assert_allclose(counts, [100, 200, 300, 400], atol=1)


def test_given_more_is_known() -> None:
    draws = WeightDraws(np.arange(2.0)[:, None], np.log([0.5, 0.5]), 0.1, -1.0)
    then = draws.given(np.log([0.1, 0.3]))
    np.testing.assert_allclose(then.weight, [0.25, 0.75])
    assert then.log_evidence == pytest.approx(-1 + np.log(0.2))


def test_quantiles_of_equal_weights_are_hazens() -> None:
    values = np.random.default_rng(2).normal(size=(101, 2))
    levels = [0.1, 0.5, 0.9]
    expected = np.quantile(values, levels, axis=0, method="hazen")
    np.testing.assert_allclose(weighted_quantiles(values, np.ones(101), levels), expected)


@pytest.mark.parametrize(
    ("weights", "levels"), [([1.0], [0.5]), ([1.0, -1.0], [0.5]), ([0.0, 0.0], [0.5]), ([1.0, 1.0], [1.5])]
)
def test_quantiles_refuse(weights, levels) -> None:
    with pytest.raises(ArgumentError):
        weighted_quantiles([[0.0], [1.0]], weights, levels)


def test_weights_that_do_not_sum_to_one_are_refused() -> None:
    with pytest.raises(ArgumentError, match="sum to one"):
        WeightDraws(np.zeros((2, 1)), np.zeros(2), 0.0, 0.0)
