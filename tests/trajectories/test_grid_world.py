"""Grid-world paths against combinatorics, symmetry and slow loops."""

from __future__ import annotations

from itertools import pairwise
from math import comb

import numpy as np
import pytest

from pipeline.errors import ArgumentError
from pipeline.trajectories.grid_world import link_incidence, mean_distances, mean_positions, shortest_paths
from tests.oracles.slow_grid_world import all_paths, mean_distance


@pytest.mark.parametrize("size", [2, 3, 4, 5])
def test_all_paths_in_order(size: int) -> None:
    assert [tuple(map(tuple, path)) for path in shortest_paths(size).tolist()] == all_paths(size)


def test_ten_by_ten() -> None:
    paths = shortest_paths(10)
    assert paths.shape == (48_620, 19, 2)
    assert len(paths) == comb(18, 9)
    steps = np.diff(paths, axis=1)
    assert (steps.sum(axis=2) == 1).all()
    assert (steps >= 0).all()
    assert (paths[:, 0] == 0).all()
    assert (paths[:, -1] == 9).all()
    assert len(np.unique(paths.reshape(len(paths), -1), axis=0)) == 48_620


def test_distances_agree_with_loops() -> None:
    paths, centres = shortest_paths(5), [(1, 3), (3, 1), (0, 0)]
    expected = [[mean_distance(path, centre) for centre in centres] for path in all_paths(5)]
    assert mean_distances(paths, centres) == pytest.approx(np.array(expected), rel=1e-14)


def test_equally_far_paths_have_identical_features() -> None:
    # both objects lie on x + y = 9, so folding a path's second half over that line keeps its distances and leaves two
    # paths of nine steps from one corner to one end; exchanging their tails where they meet keeps the distances too.
    # What is left are the pairs that do not cross, of which there are as many as the tenth Catalan number.
    features = mean_distances(shortest_paths(10), [(2, 7), (7, 2)])
    assert len(np.unique(features, axis=0)) == 16_796 == comb(20, 10) // 11
    rounded = np.unique(np.round(features, 9), axis=0)
    assert len(rounded) == 16_796  # no ties were missed by rounding errors


def test_mirrored_objects_mirror_the_features() -> None:
    paths = shortest_paths(6)
    features = mean_distances(paths, [(1, 4), (4, 1)])
    mirrored = mean_distances(paths[:, :, ::-1], [(1, 4), (4, 1)])
    assert (mirrored == features[:, ::-1]).all()
    assert (np.sort(features[:, 0]) == np.sort(features[:, 1])).all()


def test_mean_positions() -> None:
    paths = shortest_paths(4)
    means = mean_positions(paths)
    assert means[0] == pytest.approx([(0 + 1 + 2 + 3 * 4) / 7, (0 * 4 + 1 + 2 + 3) / 7])
    assert means.sum(axis=1) == pytest.approx(np.full(20, 3.0), rel=1e-14)


def test_links() -> None:
    paths = shortest_paths(4)
    incidence = link_incidence(paths).toarray()
    assert incidence.shape == (20, 2 * 4 * 3)  # every link of the grid is on some shortest path
    assert (incidence.sum(axis=1) == 6).all()
    links = sorted({link for path in all_paths(4) for link in pairwise(path)})
    expected = [[link in set(pairwise(path)) for link in links] for path in all_paths(4)]
    assert (incidence == np.array(expected)).all()


def test_refusals() -> None:
    with pytest.raises(ArgumentError, match="size is 1"):
        shortest_paths(1)
    with pytest.raises(ArgumentError, match="size is 13"):
        shortest_paths(13)
    with pytest.raises(ArgumentError, match="whole coordinates"):
        mean_distances(shortest_paths(3), [(0.5, 1.0)])
