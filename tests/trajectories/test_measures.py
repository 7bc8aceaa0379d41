import math

import numpy as np
import pytest

from pipeline.errors import ArgumentError
from pipeline.trajectories.measures import (
    path_lengths,
    squared_steps,
    summed_closeness,
    summed_height,
    summed_tilt,
)


def test_squared_steps_of_an_even_path():
    # T-1 equal steps over a distance d sum to d^2 / (T-1)
    path = np.linspace([0.0, 1.0], [3.0, 5.0], 11)[None]
    assert squared_steps(path)[0] == pytest.approx(25 / 10, rel=1e-14)
    assert squared_steps(np.concatenate([path, 2 * path])) == pytest.approx([2.5, 10], rel=1e-14)


def test_a_jump_of_a_turn_counts_as_one():
    assert squared_steps(np.array([[[0.0], [2 * math.pi]]]))[0] == pytest.approx(4 * math.pi**2)


def test_path_length_of_a_square():
    square = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [0, 0, 0]], dtype=float)
    assert path_lengths(square[None]).tolist() == [8.0]


def test_the_first_waypoint_is_not_summed():
    assert summed_height(np.array([[100.0, 1.0, 2.0], [100.0, -1.0, 0.5]])).tolist() == [3.0, -0.5]
    positions = np.array([[[0.0, 0.0], [9.0, 9.0]]])
    assert summed_closeness(positions, np.zeros(2), 0.4).tolist() == [0.0]
    assert summed_tilt(np.array([[[1.0, 0, 0], [0, 0, 1.0]]])).tolist() == [0.0]


def test_closeness_is_horizontal_and_ends_at_the_radius():
    positions = np.array([[[9, 9, 9], [1.3, 2.4, 7], [1.0, 2.0, -7], [1.3, 2.4 + 1e-9, 0], [8, 8, 0]]], dtype=float)
    got = summed_closeness(positions, np.array([1.0, 2.0]), 0.5)
    # distances from waypoint 1 on: 0.5, 0, just over 0.5, far
    assert got[0] == pytest.approx(0.5, abs=1e-15)
    assert summed_closeness(positions, np.array([1.0, 2.0]), 0.6)[0] == pytest.approx(0.6 + 0.1 + 0.1, abs=2e-9)


def test_a_centre_that_moves_along_is_as_good_as_standing_still():
    positions = np.random.default_rng(0).normal(size=(3, 5, 3))
    centre = np.tile([0.2, 0.1, 5.0], (3, 5, 1))
    drift = np.random.default_rng(1).normal(size=(3, 5, 3))
    still = summed_closeness(positions, centre, 2.0)
    np.testing.assert_allclose(summed_closeness(positions + drift, centre + drift, 2.0), still, rtol=1e-13)
    assert (summed_closeness(positions, centre[0, 0], 2.0) == still).all()


def test_tilt_of_known_angles():
    axes = np.array([[[0, 0, 1], [0, 0, 2], [3, 0, 3], [0, -1, 0], [0, 0, -1]]], dtype=float)
    assert summed_tilt(axes)[0] == pytest.approx(math.pi * (1 / 4 + 1 / 2 + 1), rel=1e-15)


def test_one_waypoint_sums_to_nothing():
    one = np.ones((2, 1, 3))
    for got in (squared_steps(one), path_lengths(one), summed_tilt(one), summed_closeness(one, one[0, 0], 1.0)):
        assert got.tolist() == [0.0, 0.0]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: squared_steps(np.zeros((4, 3))), r"waypoints have shape \(4, 3\); they must be \(N, T, D\)"),
        (lambda: summed_height(np.zeros((4, 0))), r"heights have shape \(4, 0\)"),
        (lambda: summed_closeness(np.zeros((4, 2, 4)), np.zeros(2), 1.0), "positions have 4 coordinates"),
        (lambda: summed_closeness(np.zeros((4, 2, 3)), np.zeros((4, 2)), 1.0), r"centre has shape \(4, 2\)"),
        (lambda: summed_closeness(np.zeros((4, 2, 3)), np.zeros(2), 0.0), r"radius_m is 0\.0"),
        (lambda: summed_closeness(np.zeros((4, 2, 3)), np.zeros(2), math.nan), "radius_m is nan"),
        (lambda: summed_tilt(np.zeros((4, 2, 2))), "axes have 2 coordinates"),
    ],
)
def test_arguments(call, message):
    with pytest.raises(ArgumentError, match=message):
        call()
