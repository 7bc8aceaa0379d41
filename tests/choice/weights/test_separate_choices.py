"""Demonstrations with alternatives of their own: sums over the sets, and one posterior where the sets are equal."""

import numpy as np
import pytest

from pipeline.choice import LESS
from pipeline.choice.weights import Choices, sample_weights
from pipeline.choice.weights.choices import SeparateChoices
from pipeline.errors import ArgumentError

RNG = np.random.default_rng(3)
ROWS, CHOSEN, OMEGA = RNG.random((40, 2)), RNG.random((3, 2)), RNG.normal(size=(5, 2))
TOGETHER = Choices.outside(LESS(0.2), CHOSEN, ROWS)
SEPARATE = SeparateChoices(tuple(TOGETHER.subset([n]) for n in range(3)))


def test_equal_sets_are_one_set() -> None:
    np.testing.assert_allclose(SEPARATE.log_likelihood(OMEGA), TOGETHER.log_likelihood(OMEGA), atol=1e-12)
    np.testing.assert_allclose(SEPARATE.total(OMEGA), TOGETHER.total(OMEGA), atol=1e-12)
    mine, theirs = SEPARATE.derivatives(OMEGA), TOGETHER.derivatives(OMEGA)
    for name in ("value", "gradient", "curvature"):
        np.testing.assert_allclose(getattr(mine, name), getattr(theirs, name), atol=1e-12)
    drawn = [sample_weights(np.random.default_rng(0), one, count=200) for one in (SEPARATE, TOGETHER)]
    np.testing.assert_allclose(drawn[0].omega, drawn[1].omega, atol=1e-6)


def test_a_part_is_of_its_own_set() -> None:
    others = Choices.outside(LESS(0.2), CHOSEN[1:2], ROWS + 1)
    both = SeparateChoices((TOGETHER.subset([0]), others))
    expected = TOGETHER.subset([0]).total(OMEGA) + others.total(OMEGA)
    np.testing.assert_allclose(both.total(OMEGA), expected, atol=1e-12)
    np.testing.assert_allclose(both.subset([1]).total(OMEGA), others.total(OMEGA), atol=1e-12)
    assert (both.count, both.features) == (2, 2)
    with pytest.raises(ArgumentError, match="one demonstration each"):
        SeparateChoices((TOGETHER,))
