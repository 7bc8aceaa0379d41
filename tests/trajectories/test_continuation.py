from __future__ import annotations

import numpy as np
import pytest

from pipeline.errors import ArgumentError
from pipeline.trajectories.continuation import nearest, prefix_log_kernel, spliced, straight_on

RNG = np.random.default_rng(2)
PATHS = np.cumsum(RNG.normal(size=(5, 11, 2)), axis=1)
SEEN = np.cumsum(RNG.normal(size=(4, 2)), axis=0)


def test_spliced_trajectories_share_the_beginning_and_keep_their_ends() -> None:
    together = spliced(SEEN, PATHS)
    np.testing.assert_array_equal(together[:, :4], np.broadcast_to(SEEN, (5, 4, 2)))
    np.testing.assert_array_equal(together[:, -1], PATHS[:, -1])


def test_an_alternative_that_began_so_goes_on_as_it_was() -> None:
    np.testing.assert_allclose(spliced(PATHS[2, :4], PATHS)[2], PATHS[2])


def test_splices_leave_and_arrive_with_the_alternatives_velocity() -> None:
    """The added distance is flat at both ends: its first and last steps are of second order."""
    fine = np.zeros((1, 1001, 1))
    added = spliced(np.ones((1, 1)), fine)[0, :, 0]
    assert abs(added[1] - added[0]) < 1e-5
    assert abs(added[-1] - added[-2]) < 1e-5
    assert np.all(np.diff(added) <= 0)


def test_straight_on() -> None:
    path = straight_on(np.array([[0.0], [1.0]]), np.array([5.0]), 6)
    np.testing.assert_allclose(path[:, 0], [0, 1, 2, 3, 4, 5])


def test_nearest_beginning() -> None:
    others = np.zeros((3, 6, 1))
    others[:, :, 0] = [[0], [1], [2]]
    assert nearest(np.full((3, 1), 1.2), others) == 1
    np.testing.assert_allclose(prefix_log_kernel(np.full((3, 1), 1.0), others, 0.5), [-2, 0, -2])


@pytest.mark.parametrize("seen", [np.zeros((11, 2)), np.zeros((0, 2)), np.zeros((3, 1)), np.zeros(2)])
def test_shapes_that_do_not_fit(seen) -> None:
    with pytest.raises(ArgumentError, match="observed has shape"):
        spliced(seen, PATHS)
    with pytest.raises(ArgumentError, match="observed has shape"):
        straight_on(seen, np.zeros(2), 11)


def test_widths_are_positive() -> None:
    with pytest.raises(ArgumentError, match="width"):
        prefix_log_kernel(SEEN, PATHS, 0.0)
