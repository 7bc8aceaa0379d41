"""Random walks in a network with a cycle."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.errors import ArgumentError
from pipeline.trajectories.network_walks import END, Network
from tests.oracles.all_paths import all_paths

STEPS = [(0, 1), (0, 2), (1, 2), (1, 3), (2, 1), (2, 3), (2, 4), (3, 4), (3, 5)]
SOURCES, TARGETS = np.array(STEPS).T
NETWORK = Network(SOURCES, TARGETS)
COST = np.array([1.0, 2.0, 0.5, 1.0, 1.0, 0.3, 2.0, 0.0, 0.0])


def test_densities_of_all_paths_add_up_to_one() -> None:
    log_p = NETWORK.log_step_probabilities(COST, 4, 1.5)
    total = sum(np.exp(log_p[list(path)].sum()) for path in all_paths(STEPS, 0, 4, 80))
    assert total == pytest.approx(1, abs=1e-12)


def test_drawn_paths_lead_to_the_destination_as_often_as_their_density_says() -> None:
    log_p = NETWORK.log_step_probabilities(COST, 4, 0.7)
    walks = NETWORK.walk(log_p, np.zeros(20_000, dtype=np.intp), 4, np.random.default_rng(1))
    rows, counts = np.unique(walks.steps, axis=0, return_counts=True)
    for row, count in zip(rows, counts, strict=True):
        path = row[row != END]
        assert SOURCES[path[0]] == 0
        assert TARGETS[path[-1]] == 4
        np.testing.assert_array_equal(TARGETS[path[:-1]], SOURCES[path[1:]])
        density = np.exp(log_p[path].sum())
        assert abs(count / 20_000 - density) < 5 * np.sqrt(density / 20_000)
    steps, density = walks.steps[0], walks.log_density[0]
    assert density == pytest.approx(log_p[steps[steps != END]].sum())


def test_paths_from_several_origins_begin_where_they_should() -> None:
    log_p = NETWORK.log_step_probabilities(COST, 4, 0.7)
    origins = np.array([2, 0, 1, 3, 0])
    walks = NETWORK.walk(log_p, origins, 4, np.random.default_rng(2))
    np.testing.assert_array_equal(SOURCES[walks.steps[:, 0]], origins)


def test_least_costs_are_those_of_enumerated_paths() -> None:
    least = NETWORK.least_costs(COST, 5)
    for state in range(4):
        assert least[state] == pytest.approx(min(COST[list(path)].sum() for path in all_paths(STEPS, state, 5, 6)))
    assert np.isinf(least[4])


def test_no_way_is_an_error_and_so_are_steps_out_of_order() -> None:
    log_p = NETWORK.log_step_probabilities(COST, 4, 1.0)
    with pytest.raises(ArgumentError, match="from state 5 does not reach"):
        NETWORK.walk(log_p, np.array([0, 5]), 4, np.random.default_rng(0))
    with pytest.raises(ArgumentError, match="sort"):
        Network(SOURCES[::-1], TARGETS)
