"""The share of time within a radius, against looking at many moments and by hand."""

import numpy as np
import pytest

from pipeline.errors import ArgumentError
from pipeline.trajectories.measures import share_within
from tests.oracles.slow_motion import share_near


def test_against_many_moments() -> None:
    offsets = np.random.default_rng(2).normal(size=(6, 5, 3))
    offsets[0, 2] = offsets[0, 1]  # rests for a step
    found = share_within(offsets, 1.3)
    assert 0 < found.min() < found.max() < 1
    np.testing.assert_allclose(found, [share_near(list(rows), 1.3) for rows in offsets], atol=1e-4)


def test_by_hand() -> None:
    through = np.array([[[-2.0, 0], [2, 0]]])  # through the centre of a circle of radius 1: half of the way
    assert share_within(through, 1.0).tolist() == [0.5]
    assert share_within(through + np.array([0, 1.5]), 1.0).tolist() == [0.0]
    assert share_within(0 * through, 1.0).tolist() == [1.0]
    assert share_within(0 * through + 3, 1.0).tolist() == [0.0]


@pytest.mark.parametrize("radius", [0.0, -1.0, np.inf, np.nan])
def test_a_radius_is_positive(radius: float) -> None:
    with pytest.raises(ArgumentError, match="radius_m is"):
        share_within(np.zeros((1, 2, 3)), radius)


def test_a_path_has_two_waypoints() -> None:
    with pytest.raises(ArgumentError, match="at least 2 waypoints"):
        share_within(np.zeros((1, 1, 3)), 1.0)
