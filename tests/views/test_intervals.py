"""Intervals and comparisons behind the figures, against their definitions."""

from __future__ import annotations

import doctest

import numpy as np
import polars as pl
import pytest
from scipy.stats import binom, binomtest

from pipeline.errors import ArgumentError
from pipeline.views import intervals
from pipeline.views.findings import findings
from pipeline.views.intervals import (
    binomial_interval,
    near_or_far,
    with_mean_intervals,
    with_share_intervals,
)


def test_the_examples_in_the_docstrings() -> None:
    assert doctest.testmod(intervals) == doctest.TestResults(0, 4)


@pytest.mark.parametrize(("count", "n"), [(15, 37), (1, 10), (9, 10), (200, 1200)])
def test_the_ends_leave_half_the_rest_on_each_side(count: int, n: int) -> None:
    low, high = binomial_interval(count, n, 0.9)
    assert binom.sf(count - 1, n, low) == pytest.approx(0.05)
    assert binom.cdf(count, n, high) == pytest.approx(0.05)


def test_the_interval_is_that_of_scipy() -> None:
    for n in (1, 7, 40):
        for count in range(n + 1):
            exact = binomtest(count, n).proportion_ci(0.95, method="exact")
            assert binomial_interval(count, n) == pytest.approx((exact.low, exact.high), abs=1e-12)


@pytest.mark.parametrize(("count", "n", "level"), [(1, 0, 0.95), (5, 4, 0.95), (-1, 4, 0.95), (1, 4, 1.0), (1, 4, 0.0)])
def test_what_is_no_share_is_refused(count: int, n: int, level: float) -> None:
    with pytest.raises(ArgumentError):
        binomial_interval(count, n, level)


def test_a_share_within_a_group_is_of_those_who_chose_it() -> None:
    rows = [("groups", "a", 3), ("groups", "b", 1), ("within", "a", 1), ("within", "a", 2), ("within", "c", 0)]
    table = pl.DataFrame(rows, schema=["comparison", "group", "count"], orient="row").with_columns(model=pl.lit("less"))
    out = with_share_intervals(table)
    assert out["n"].to_list() == [4, 4, 3, 3, 0]
    assert (out["low"][2], out["high"][2]) == pytest.approx(binomial_interval(1, 3))
    assert out["low"][4] is None


def test_a_mean_has_its_normal_interval() -> None:
    out = with_mean_intervals(pl.DataFrame({"true_posterior": [0.5], "standard_error": [0.1]}))
    assert out["low"][0] == pytest.approx(0.5 - 0.195996398)
    assert out["high"][0] == pytest.approx(0.5 + 0.195996398)


def test_every_theta_has_words_of_its_own() -> None:
    thetas = np.array([[a, b] for a in (-1.0, 0.0, 1.0) for b in (-1.0, 0.0, 1.0) if a or b])
    words = near_or_far(thetas)
    assert len(set(words)) == 8
    assert words[0] == ("near A", "near B")


def hypotheses(supported: bool, p: float | None) -> pl.DataFrame:
    row = {
        "hypothesis": "H3", "sampling_model": "less", "expected": "less", "other": "boltzmann",
        "posterior_expected": 0.6, "posterior_other": 0.4, "posterior_p_value": 1e-9, "match_expected": 0.7,
        "match_other": 0.4, "match_p_value": p,
        "supported": supported,
    }  # fmt: skip
    return pl.DataFrame([row])


def fits(p_boltzmann: float, p_less: float, epsilon_less: float) -> pl.DataFrame:
    rows = [("groups", "boltzmann", 6.27, 1, p_boltzmann, 0.39), ("groups", "less", 0.72, 1, p_less, epsilon_less)]
    columns = ["comparison", "model", "chi_square", "degrees_of_freedom", "p_value", "minimum_epsilon"]
    return pl.DataFrame(rows, schema=columns, orient="row")


@pytest.mark.parametrize(
    ("p_boltzmann", "p_less", "epsilon", "h1", "h2"),
    [
        (0.0123, 0.3967, 0.22, "supported", "no difference found; the tighter bound"),
        (0.2, 0.3967, 0.4, "not supported", "no difference found; the looser bound"),
        (0.0123, 0.01, 0.22, "supported", "they differ"),
    ],
)
def test_what_is_said_of_each_hypothesis(p_boltzmann: float, p_less: float, epsilon: float, h1: str, h2: str) -> None:
    found = findings(fits(p_boltzmann, p_less, epsilon), hypotheses(True, 0.02))
    assert found["hypothesis"].to_list() == ["H1", "H2", "H3"]
    assert found["outcome"].to_list() == [h1, h2, "supported"]
    assert found["numbers"][2] == "TruePosterior 0.60 against 0.40, p < 0.001; TrueMatch 0.70 against 0.40, p = 0.020"


def test_an_undefined_p_value_is_said() -> None:
    found = findings(fits(0.01, 0.4, 0.2), hypotheses(False, None))
    assert found["outcome"][2] == "not supported"
    assert found["numbers"][2].endswith("p undefined")
