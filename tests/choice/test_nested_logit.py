"""Nested logit against its formula written out, and in the limits in which it is another model."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pipeline.arrays import FloatArray
from pipeline.choice import Boltzmann, log_likelihood
from pipeline.choice.nested_logit import Nests, nested_log_likelihood, nests_of
from pipeline.errors import ArgumentError

RNG = np.random.default_rng(41)
ALTERNATIVES = np.concatenate([RNG.normal(0, 0.02, (6, 2)), RNG.normal([1, 0], 0.02, (3, 2)), [[0.0, 2.0]]])
SHOWN = np.array([[0.01, 0.0], [1.02, 0.0], [5.0, 5.0]])  # in the first nest, in the second, in none
THETAS, BETAS = np.array([[1.0, 0.0], [-0.6, 0.8], [0.0, -1.0]]), np.array([0.1, 1.0, 8.0])


def written_out(shown: FloatArray, nest_of: list[int], own: int, omega: FloatArray, scale: float) -> float:
    """The formula for one demonstration, with plain sums."""
    utilities = [float(omega @ row) for row in ALTERNATIVES] + [float(omega @ shown)]
    nests = [*nest_of, own]
    top = max(utilities)
    sums = {
        m: sum(math.exp((v - top) / scale) for v, n in zip(utilities, nests, strict=True) if n == m) for m in set(nests)
    }
    return (
        (utilities[-1] - top) / scale - math.log(sums[own])
        + scale * math.log(sums[own]) - math.log(sum(s**scale for s in sums.values()))
    )  # fmt: skip


@pytest.mark.parametrize("scale", [0.2, 0.5, 1.0])
def test_it_is_the_formula(scale: float) -> None:
    nests = nests_of(ALTERNATIVES, 0.3)
    assert nests.index.tolist() == [0] * 6 + [1] * 3 + [2]
    found = nested_log_likelihood(SHOWN, ALTERNATIVES, nests, THETAS, BETAS, scale)
    for i, own in enumerate((0, 1, 3)):
        for k, theta in enumerate(THETAS):
            for b, beta in enumerate(BETAS):
                expected = written_out(SHOWN[i], nests.index.tolist(), own, beta * theta, scale)
                assert found[i, k, b] == pytest.approx(expected, abs=1e-11)


def test_with_a_dissimilarity_of_one_it_is_boltzmann() -> None:
    rows, shown = RNG.normal(size=(200, 3)), RNG.normal(size=(5, 3))
    thetas = RNG.normal(size=(4, 3))
    nested = nested_log_likelihood(shown, rows, nests_of(rows, 0.5), thetas, [0.3, 3.0], 1.0)
    np.testing.assert_allclose(nested, log_likelihood(Boltzmann(), shown, rows, thetas, [0.3, 3.0]), atol=1e-10)


def test_exact_copies_of_an_alternative_hardly_count_when_the_dissimilarity_is_small() -> None:
    rows, shown = np.array([[0.0], [1.0]]), np.array([[2.0]])
    copied = np.concatenate([rows, np.zeros((500, 1))])
    small = [
        nested_log_likelihood(shown, these, nests_of(these, 0.1), [[1.0]], [0.5], 0.01) for these in (rows, copied)
    ]
    assert small[1][0, 0, 0] == pytest.approx(small[0][0, 0, 0], abs=0.02)  # l log 501 = .06 times the nest's share
    plain = [log_likelihood(Boltzmann(), shown, these, [[1.0]], [0.5]) for these in (rows, copied)]
    assert plain[0][0, 0, 0] - plain[1][0, 0, 0] > 2


def test_no_two_of_a_nest_are_farther_apart_than_its_diameter_and_the_order_of_rows_changes_nothing() -> None:
    rows = RNG.random((150, 3))
    nests = nests_of(rows, 0.25)
    for nest in range(nests.count):
        members = rows[nests.index == nest]
        assert np.sqrt(((members[:, None] - members) ** 2).sum(axis=2)).max() <= 0.25 + 1e-12
    order = RNG.permutation(150)
    moved = nests_of(rows[order], 0.25)
    assert {frozenset(np.flatnonzero(nests.index == m).tolist()) for m in range(nests.count)} == {
        frozenset(order[moved.index == m].tolist()) for m in range(moved.count)
    }
    assert nests_of(rows[:1], 0.25).index.tolist() == [0]


def test_great_utilities_do_not_overflow() -> None:
    rows = RNG.normal(size=(50, 2)) * 10
    found = nested_log_likelihood(rows[:3] * 2, rows, nests_of(rows, 0.5), [[1.0, 0.0], [-1.0, 0.0]], [1e4], 0.01)
    assert np.isfinite(found).all()
    assert (found <= 0).all()


def test_arguments() -> None:
    with pytest.raises(ArgumentError, match="dissimilarity"):
        nested_log_likelihood(SHOWN, ALTERNATIVES, nests_of(ALTERNATIVES, 0.3), THETAS, BETAS, 0.0)
    with pytest.raises(ArgumentError, match="nests are of 2"):
        nested_log_likelihood(SHOWN, ALTERNATIVES, Nests(np.zeros(2, dtype=np.intp), 0.1), THETAS, BETAS)
    with pytest.raises(ArgumentError, match="diameter"):
        nests_of(ALTERNATIVES, 0.0)
