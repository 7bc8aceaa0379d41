from __future__ import annotations

import math

import numpy as np
import pytest

from pipeline.answers.motion_prediction import Forecast, score_forecasts
from pipeline.errors import ArgumentError

RNG = np.random.default_rng(2)
ACTUAL = RNG.normal(size=(6, 3))


def test_the_error_is_that_of_the_mean() -> None:
    forecast = Forecast(np.stack([ACTUAL + 0.3, ACTUAL - 0.3]), np.array([0.5, 0.5]), ACTUAL)
    assert forecast.error_m == pytest.approx(0, abs=1e-12)
    assert Forecast.single(ACTUAL + np.array([0.3, 0, 0.4]), ACTUAL).error_m == pytest.approx(0.5)


def test_the_log_score_is_a_density() -> None:
    """It integrates to one over space, and a mixture of two equal members is the same."""
    axis = np.sinh(np.linspace(-7, 7, 141)) * 0.2
    volume = np.cosh(np.linspace(-7, 7, 141)) * 0.2 * 0.1
    radial = [Forecast.single([[r, 0, 0]], [[0.0, 0, 0]]).log_score(0.2) for r in axis]
    assert np.sum(np.exp(radial) * 2 * np.pi * axis**2 * volume) == pytest.approx(1, abs=1e-3)
    one = Forecast.single(ACTUAL + np.array([0.1, 0, 0]), ACTUAL)
    two = Forecast(np.repeat(one.positions, 2, axis=0), np.array([0.3, 0.7]), ACTUAL)
    assert two.log_score(0.2) == pytest.approx(one.log_score(0.2))


def test_an_impossible_member_counts_for_nothing() -> None:
    forecast = Forecast(np.stack([ACTUAL, ACTUAL + 9]), np.array([1.0, 0.0]), ACTUAL)
    assert forecast.log_score(0.1) == pytest.approx(Forecast.single(ACTUAL, ACTUAL).log_score(0.1))


def test_the_width_is_chosen_on_the_others() -> None:
    """The first was hit exactly; alone it would choose the narrowest width, the others make it wide."""
    forecasts = [Forecast.single(ACTUAL + offset, ACTUAL) for offset in (0.0, 0.1, 0.1, 0.1)]
    score = score_forecasts(forecasts, (0.01, 0.1))
    assert score.log_score[0] == pytest.approx(forecasts[0].log_score(0.1))
    np.testing.assert_allclose(score.error_m, [0] + [0.1 * math.sqrt(3)] * 3)


def test_who_knows_the_uncertainty_scores_higher() -> None:
    """People go left or right: a prediction of both beats one of either, though its mean is as wrong."""
    sides = [np.array([0.2 * sign, 0, 0]) for sign in (1, -1, 1, -1, 1, -1)]
    both = [
        Forecast(np.stack([ACTUAL + sides[0], ACTUAL - sides[0]]), np.full(2, 0.5), ACTUAL + side) for side in sides
    ]
    one = [Forecast.single(ACTUAL, ACTUAL + side) for side in sides]
    assert np.all(score_forecasts(both).log_score > score_forecasts(one).log_score)


def test_refusals() -> None:
    with pytest.raises(ArgumentError, match="two or more"):
        score_forecasts([Forecast.single(ACTUAL, ACTUAL)])
    with pytest.raises(ArgumentError, match="are needed"):
        Forecast(ACTUAL, np.ones(6) / 6, ACTUAL)
