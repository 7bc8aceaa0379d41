"""Boltzmann over all paths, against enumeration, finite differences and the published network."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.choice.recursive_logit import Paths, RecursiveLogit
from pipeline.errors import ArgumentError
from tests.oracles.all_paths import all_paths

# States 0..3 are roads with a cycle 1 -> 2 -> 1; 4 and 5 are destinations.
STEPS = [(0, 1), (0, 2), (1, 2), (1, 3), (2, 1), (2, 3), (2, 4), (3, 4), (3, 5)]
FEATURES = np.random.default_rng(3).uniform(0.5, 1.5, (len(STEPS), 2))
WEIGHTS = np.array([-0.9, -0.7])
SOURCES, TARGETS = np.array(STEPS).T


def taken(*paths: tuple[int, ...]) -> Paths:
    """These paths, given by the numbers of their steps."""
    return Paths(
        np.array([STEPS[path[0]][0] for path in paths]),
        np.array([STEPS[path[-1]][1] for path in paths]),
        np.array([FEATURES[list(path)].sum(axis=0) for path in paths]),
    )


@pytest.fixture
def some() -> Paths:
    return taken((0, 3, 7), (1, 6), (0, 2, 4, 3, 8), (1, 5, 8), (1, 4, 3, 7))


def model(paths: Paths) -> RecursiveLogit:
    return RecursiveLogit(SOURCES, TARGETS, FEATURES, paths)


def test_probabilities_are_those_of_enumerated_paths_with_the_cycle_gone_round_up_to_thirty_times(some: Paths) -> None:
    log_sums = {
        end: np.log(sum(np.exp(FEATURES[list(path)].sum(axis=0) @ WEIGHTS) for path in all_paths(STEPS, 0, end, 60)))
        for end in (4, 5)
    }
    expected = [
        total @ WEIGHTS - log_sums[int(end)] for total, end in zip(some.features, some.destinations, strict=True)
    ]
    np.testing.assert_allclose(model(some).log_likelihoods(WEIGHTS), expected, atol=1e-12)


def test_derivatives_are_those_of_small_differences(some: Paths) -> None:
    logit = model(some)
    _, gradients = logit.scores(WEIGHTS)
    for index, step in enumerate(1e-6 * np.eye(2)):
        slope = (logit.log_likelihoods(WEIGHTS + step) - logit.log_likelihoods(WEIGHTS - step)) / 2e-6
        np.testing.assert_allclose(gradients[:, index], slope, atol=1e-8)
    often = np.array([3.0, 0.0, 1.0, 2.0, 1.0])
    value, gradient = logit.gradient(WEIGHTS, often)
    assert value == pytest.approx(often @ logit.log_likelihoods(WEIGHTS))
    np.testing.assert_allclose(gradient, often @ gradients, atol=1e-12)


def test_estimate_has_no_slope_and_counting_is_the_same_as_repeating(some: Paths) -> None:
    often = np.array([3.0, 2.0, 1.0, 1.0, 1.0])
    counted = model(some).estimate([-2.0, -2.0], often)
    rows = np.repeat(np.arange(5), often.astype(int))
    repeated = model(Paths(some.origins[rows], some.destinations[rows], some.features[rows]))
    np.testing.assert_allclose(repeated.estimate([-2.0, -2.0]).weights, counted.weights, atol=1e-4)
    np.testing.assert_allclose(repeated.scores(counted.weights)[1].sum(axis=0), 0, atol=1e-4)


def test_weights_at_which_the_sum_over_paths_is_infinite_are_refused(some: Paths) -> None:
    with pytest.raises(ArgumentError, match="infinite"):
        model(some).log_likelihoods([0.5, 0.5])


def test_hostile_networks_are_refused(some: Paths) -> None:
    with pytest.raises(ArgumentError, match="can be left"):
        model(replace(some, destinations=np.array([1, 1, 1, 1, 1])))
    with pytest.raises(ArgumentError, match="twice"):
        RecursiveLogit([*SOURCES, 0], [*TARGETS, 1], [*FEATURES, [1.0, 1.0]], some)
    with pytest.raises(ArgumentError, match="one entry"):
        RecursiveLogit(SOURCES[1:], TARGETS, FEATURES, some)
    with pytest.raises(ArgumentError, match="weights"):
        model(some).log_likelihoods([-1.0])
