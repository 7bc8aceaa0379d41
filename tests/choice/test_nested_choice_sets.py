"""Nested logit for choices from sets of their own: against the formula elsewhere, its limit, and known weights."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.choice.conditional_logit import ChoiceSets
from pipeline.choice.nested_choice_sets import LEAST_DISSIMILARITY, NestedChoiceSets
from pipeline.choice.nested_logit import Nests, nested_log_likelihood
from pipeline.errors import ArgumentError

RNG = np.random.default_rng(7)
SIZES = [5, 1, 8]
FEATURES = RNG.normal(size=(sum(SIZES), 2))
STARTS = np.append(0, np.cumsum(SIZES)[:-1])
CHOSEN = np.array([2, 5, 13])
NESTS = np.concatenate([np.array([7, 2, 2, 7, 0]), [3], np.array([1, 0, 1, 0, 0, 2, 2, 1])])
SETS = NestedChoiceSets(ChoiceSets(FEATURES, STARTS, CHOSEN), NESTS)
NONE = np.zeros(len(NESTS))
WEIGHTS = np.array([0.8, -1.3])


@pytest.mark.parametrize("scale", [0.2, 0.6, 1.0])
def test_it_is_nested_logit_of_one_demonstration_at_a_time(scale: float) -> None:
    found = SETS.log_probabilities(WEIGHTS, scale, NONE)
    for start, size, chosen, value in zip(STARTS, SIZES, CHOSEN, found, strict=True):
        rows = slice(start, start + size)
        phi, nests = FEATURES[rows], NESTS[rows]
        own = nests == NESTS[chosen]
        # the sum of the formula over plain lists
        v = np.exp(phi @ WEIGHTS / scale)
        sums = {m: v[nests == m].sum() for m in set(nests.tolist())}
        p = v[chosen - start] / v[own].sum() * v[own].sum() ** scale / sum(s**scale for s in sums.values())
        assert value == pytest.approx(np.log(p), abs=1e-12)
    assert found[1] == 0  # a set of one


def test_a_weight_of_log_k_is_k_copies_in_the_nest() -> None:
    copies = np.array([1, 3, 1, 2, 1, 1, 1, 4, 1, 1, 2, 1, 1, 1])
    rows = np.repeat(np.arange(len(NESTS)), copies)
    starts = np.searchsorted(rows, STARTS)
    many = NestedChoiceSets(ChoiceSets(FEATURES[rows], starts, np.searchsorted(rows, CHOSEN)), NESTS[rows])
    weighted = SETS.log_probabilities(WEIGHTS, 0.4, np.log(copies))
    plain = many.log_probabilities(WEIGHTS, 0.4, np.zeros(len(rows)))
    np.testing.assert_allclose(weighted - np.log(copies[CHOSEN]), plain, atol=1e-12)


def test_it_agrees_with_the_demonstration_that_joins_a_nest() -> None:
    rows, nests = np.array([[0.0], [0.1], [3.0]]), Nests(np.array([0, 0, 1]), 0.5)
    joined = nested_log_likelihood([[0.2]], rows, nests, [[1.0]], [2.0], 0.3)[0, 0, 0]
    sets = ChoiceSets(np.append(rows, [[0.2]], axis=0), np.array([0]), np.array([3]))
    found = NestedChoiceSets(sets, np.array([0, 0, 1, 0])).log_probabilities([2.0], 0.3, np.zeros(4))
    assert found[0] == pytest.approx(joined, abs=1e-12)


def test_with_a_dissimilarity_of_one_it_is_boltzmann() -> None:
    log_w = RNG.normal(size=len(NESTS))
    boltzmann = SETS.sets.log_probabilities(WEIGHTS, log_w)[CHOSEN]
    np.testing.assert_allclose(SETS.log_probabilities(WEIGHTS, 1.0, log_w), boltzmann, atol=1e-12)


def test_derivatives_are_small_differences() -> None:
    at, log_w = np.append(WEIGHTS, 0.55), RNG.normal(size=len(NESTS))
    _, slopes = SETS._parts(at, log_w)
    for index in range(3):
        step = np.zeros(3)
        step[index] = 1e-6
        difference = (SETS._parts(at + step, log_w)[0] - SETS._parts(at - step, log_w)[0]) / 2e-6
        np.testing.assert_allclose(slopes[:, index], difference, atol=1e-7)


def test_it_finds_the_weights_that_choices_were_drawn_with() -> None:
    count, size, scale = 4000, 9, 0.4
    features = RNG.normal(size=(count * size, 2))
    starts = np.arange(count) * size
    nests = np.tile([0, 0, 0, 0, 0, 1, 1, 2, 3], count)
    chosen = np.empty(count, dtype=np.intp)
    for index, start in enumerate(starts):
        every = np.arange(start, start + size)
        one = ChoiceSets(features[every], np.array([0]), np.array([0]))
        log_p = [
            NestedChoiceSets(ChoiceSets(one.features, one.starts, np.array([row])), nests[every]).log_probabilities(
                WEIGHTS, scale, np.zeros(size)
            )[0]
            for row in range(size)
        ]
        chosen[index] = start + RNG.choice(size, p=np.exp(log_p))
    sets = NestedChoiceSets(ChoiceSets(features, starts, chosen), nests)
    weights, found = sets.estimate(np.zeros(len(features)))
    np.testing.assert_allclose(weights, WEIGHTS, atol=0.1)
    assert found == pytest.approx(scale, abs=0.05)
    half = (np.arange(count) < count // 2).astype(float)
    first = NestedChoiceSets(
        ChoiceSets(features[: count // 2 * size], starts[: count // 2], chosen[: count // 2]),
        nests[: count // 2 * size],
    )
    left_out, _ = sets.estimate(np.zeros(len(features)), half, [*weights, found])
    np.testing.assert_allclose(left_out, first.estimate(np.zeros(len(first.nests)))[0], atol=1e-3)


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(ArgumentError, match="nests are of 2 alternatives; there are 14"):
        NestedChoiceSets(SETS.sets, np.array([0, 1]))
    for scale in (0.0, 1.5):
        with pytest.raises(ArgumentError, match="dissimilarity is"):
            SETS.log_probabilities(WEIGHTS, scale, NONE)
    assert 0 < LEAST_DISSIMILARITY < 1
