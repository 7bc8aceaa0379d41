"""The fast leave-one-out bandwidth against the one that looks at every pair."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.choice import select_bandwidth
from pipeline.errors import BandwidthError
from pipeline.studies.kernel_bandwidth import leave_one_out_bandwidth
from pipeline.trajectories.gridworld import mean_distances, shortest_paths


def clustered(n: int) -> np.ndarray:
    rng = np.random.default_rng(0)
    far = np.array([[40.0, -3.0, 0.0]])  # out of every kernel's reach
    return np.concatenate([rng.normal(size=(n, 3)), 0.02 * rng.normal(size=(n, 3)) + [3.0, 0.0, 1.0], far])


def on_a_grid(size: int) -> np.ndarray:
    features = mean_distances(shortest_paths(size), [(2, 6), (6, 2)])
    return features / np.ptp(features, axis=0)


@pytest.mark.parametrize("features", [clustered(1200), on_a_grid(9)], ids=["clusters", "grid world"])
def test_same_as_all_pairs(features: np.ndarray) -> None:
    assert len(np.unique(features, axis=0)) > 2000
    expected = select_bandwidth(features).value
    assert leave_one_out_bandwidth(features) == pytest.approx(expected, rel=1e-5)


def test_few_rows_are_handed_on() -> None:
    features = on_a_grid(5)
    assert leave_one_out_bandwidth(features) == select_bandwidth(features).value


def test_order_and_repeats_of_the_choice_set() -> None:
    features = clustered(1100)
    shuffled = np.random.default_rng(1).permutation(features)
    assert leave_one_out_bandwidth(shuffled) == leave_one_out_bandwidth(features)


def test_refusal() -> None:
    with pytest.raises(BandwidthError, match="one distinct row"):
        leave_one_out_bandwidth(np.ones((5, 2)))
