"""Pearson's and Wellek's tests against exact fractions, a published example and simulation."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chisquare

from pipeline.errors import ArgumentError
from pipeline.studies.goodness_of_fit import chi_square_test, wellek_minimum_epsilon, wellek_test
from tests.oracles.slow_statistics import wellek

# the example in the documentation of EQUIVNONINF::gofsimpt (version 1.0.2): one hundred throws of a die
DIE = [17, 16, 25, 9, 16, 17]
SIXTHS = [1 / 6] * 6


def test_published_example_of_wellek() -> None:
    result = wellek_test(DIE, SIXTHS, epsilon=0.15, alpha=0.05)
    published = wellek(0.05, 100, 6, 0.15, DIE, SIXTHS)
    assert result.squared_distance == pytest.approx(published["squared_distance"], rel=1e-12)
    assert result.standard_error == pytest.approx(published["standard_error"], rel=1e-12)
    assert result.critical_value == pytest.approx(published["critical_value"], rel=1e-12)
    exact = sum((Fraction(count, 100) - Fraction(1, 6)) ** 2 for count in DIE)
    assert result.squared_distance == pytest.approx(float(exact), rel=1e-14)
    assert float(exact) == pytest.approx(0.0129333, abs=5e-8)
    assert result.critical_value == pytest.approx(0.0073679, abs=5e-8)
    assert not result.equivalent  # this die cannot be called fair to within 0.15


@given(
    st.lists(st.integers(0, 40), min_size=2, max_size=6).filter(lambda x: sum(x) > 0),
    st.lists(st.floats(0.05, 1.0), min_size=6, max_size=6),
    st.sampled_from([0.01, 0.05, 0.2]),
)
def test_minimum_epsilon_is_the_boundary_of_the_test(counts: list[int], weights: list[float], alpha: float) -> None:
    p = np.array(weights[: len(counts)]) / sum(weights[: len(counts)])
    epsilon = wellek_minimum_epsilon(counts, p, alpha)
    assert wellek_test(counts, p, epsilon * (1 + 1e-6) + 1e-9, alpha).equivalent
    if epsilon > 1e-6:
        assert not wellek_test(counts, p, epsilon * (1 - 1e-6), alpha).equivalent


def test_two_categories_in_closed_form() -> None:
    # with two categories ||d||^2 = 2 delta^2 and v^2 = 16 delta^2 q (1 - q)
    q, p, n, z = 0.4, 0.5, 50, 1.6448536269514722
    expected = np.sqrt(2 * (q - p) ** 2 + z * 4 * abs(q - p) * np.sqrt(q * (1 - q) / n))
    assert wellek_minimum_epsilon([20, 30], [p, 1 - p]) == pytest.approx(expected, rel=1e-12)


def test_level_of_the_equivalence_test() -> None:
    # at a true distance of exactly epsilon, equivalence is declared at rate alpha in large samples
    p, p0 = np.array([0.5, 0.3, 0.2]), np.array([0.4, 0.3, 0.3])
    epsilon = float(np.linalg.norm(p - p0))
    draws = np.random.default_rng(0).multinomial(4000, p, size=4000)
    rate = np.mean([wellek_test(x, p0, epsilon, 0.1).equivalent for x in draws])
    assert rate == pytest.approx(0.1, abs=4 * np.sqrt(0.1 * 0.9 / 4000) + 0.005)


def test_chi_square_agrees_with_scipy() -> None:
    p = np.array([0.1, 0.2, 0.3, 0.4])
    ours, theirs = chi_square_test([12, 5, 9, 14], p), chisquare([12, 5, 9, 14], 40 * p)
    assert ours.statistic == pytest.approx(theirs.statistic, rel=1e-13)
    assert ours.p_value == pytest.approx(theirs.pvalue, rel=1e-12)
    assert ours.degrees_of_freedom == 3


@pytest.mark.parametrize(
    ("counts", "probabilities", "message"),
    [
        ([1, 2, 3], [0.5, 0.5], "counts has 3 categories and probabilities 2"),
        ([1, -2], [0.5, 0.5], "counts is"),
        ([1.5, 2], [0.5, 0.5], "whole numbers"),
        ([0, 0], [0.5, 0.5], "not all of them 0"),
        ([1, float("nan")], [0.5, 0.5], "counts is"),
        ([1, 2], [0.5, 0.6], "sum 1"),
        ([1, 2], [float("nan"), 0.5], "probabilities is"),
        ([5], [1.0], "at least two categories"),
        ([[1, 2]], [[0.5, 0.5]], "at least two categories"),
    ],
)
def test_refusals(counts: list[float], probabilities: list[float], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        wellek_minimum_epsilon(counts, probabilities)
    with pytest.raises(ArgumentError, match=message):
        chi_square_test(counts, probabilities)


def test_refusals_of_one_test_alone() -> None:
    with pytest.raises(ArgumentError, match=r"alpha is 0\.7"):
        wellek_minimum_epsilon([1, 2], [0.5, 0.5], alpha=0.7)
    with pytest.raises(ArgumentError, match="epsilon is 0"):
        wellek_test([1, 2], [0.5, 0.5], epsilon=0.0)
    with pytest.raises(ArgumentError, match="every category to be possible"):
        chi_square_test([1, 2], [0.0, 1.0])
    assert wellek_minimum_epsilon([0, 2], [0.0, 1.0]) == 0.0
