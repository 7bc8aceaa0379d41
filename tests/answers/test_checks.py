from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

from pipeline.answers.checks import (
    contradicted,
    departure,
    edge_probability,
    end_gap,
    grid_edge_probability,
    outside_share,
    surprise,
)
from pipeline.choice.prediction import PredictiveCheck
from pipeline.choice.weights import WeightDraws
from pipeline.errors import ArgumentError

RNG = np.random.default_rng(0)


def draws(mean, spread: float = 1.0) -> WeightDraws:
    omega = spread * np.random.default_rng(0).normal(size=(4000, len(mean))) + np.array(mean)
    return WeightDraws(omega, np.full(4000, -np.log(4000)), 0.1, 0.0)


def test_departure_grows_with_the_angle_and_is_one_where_a_stated_sign_flips() -> None:
    answer = draws([-8.0, 0.5, 0.0])
    levels = [departure(answer, [draws([-8.0, offset, 0.0])]) for offset in (0.5, 1.5, 4.0)]
    assert levels[0] < 0.05 < levels[1] < levels[2] <= 1
    assert departure(answer, [draws([-8.0, 0.5, 0.0]), draws([4.0, 0.5, 0.0])]) == 1
    assert contradicted(answer, draws([4.0, 0.0, 0.0]))
    assert not contradicted(answer, draws([-4.0, -9.0, 0.0]))  # the second sign was not stated
    with pytest.raises(ArgumentError, match="nothing was checked"):
        departure(answer, [])


def test_shares_outside() -> None:
    rows = RNG.random((2000, 2))
    assert outside_share(RNG.random((500, 2)) * 0.8 + 0.1, rows) < 0.04
    assert outside_share([rows[3] + 1e-3, [1.4, 0.5], [0.5, -0.3], rows[8] - 1e-3], rows) == 0.5
    with pytest.raises(ArgumentError, match="two or more"):
        outside_share([[0.0]], [[0.0]])


def test_surprise_is_a_binomial_tail_for_the_worst_feature() -> None:
    p = np.full((20, 2), 0.5)
    assert surprise(PredictiveCheck(p / 2, p)) == 1
    p[:6, 1] = 0.01
    expected = 2 * binom.sf(5, 20, 0.05)
    assert surprise(PredictiveCheck(p / 2, p)) == pytest.approx(expected)


def test_edges() -> None:
    assert edge_probability(draws([300.0, 0.0, 0.0])) > 0.9
    assert edge_probability(draws([2.0, 0.0, 0.0])) < 0.05
    assert grid_edge_probability(np.array([0.1, 0.6, 0.3])) == pytest.approx(0.4)
    with pytest.raises(ArgumentError):
        grid_edge_probability(np.array([0.5, 0.5]))


def test_end_gap() -> None:
    alternatives = np.zeros((3, 5, 3))
    alternatives[:, :, 0] = np.linspace(0, 4, 5)
    people = np.repeat(alternatives[:1], 3, axis=0)
    assert end_gap(people, alternatives) == 0
    people[1:, -1] += [0.0, 1.0, 0.0]
    people[2, 0] += [0.0, 0.0, 2.0]
    assert end_gap(people, alternatives) == pytest.approx(0.25)
    with pytest.raises(ArgumentError, match="end where they start"):
        end_gap(people, np.zeros((1, 5, 3)))
