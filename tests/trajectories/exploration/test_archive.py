import numpy as np
import pytest

from pipeline.errors import ArgumentError
from pipeline.trajectories.exploration.archive import Archive, Grid, spread

WIDTH = 0.25


def members(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.standard_normal((count, 3, 2)), rng.normal(0, 0.6, (count, 3))


def one_by_one(features: np.ndarray) -> dict[tuple[int, ...], tuple[int, int]]:
    """The obvious archive: cell -> (row of the elite, visits)."""
    cells: dict[tuple[int, ...], tuple[int, int]] = {}
    distance = [float(((f / WIDTH - np.floor(f / WIDTH) - 0.5) ** 2).sum()) for f in features]
    for row, f in enumerate(features):
        cell = tuple(np.floor(f / WIDTH).astype(int).tolist())
        held, visits = cells.get(cell, (row, 0))
        cells[cell] = (row if distance[row] < distance[held] else held, visits + 1)
    return cells


def state(archive: Archive) -> list[np.ndarray]:
    order = np.lexsort(archive.features.T)
    return [archive.z[order], archive.features[order], archive.visits[order]]


def same(a: Archive, b: Archive) -> None:
    for ours, theirs in zip(state(a), state(b), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def filled(z: np.ndarray, features: np.ndarray, batch: int) -> Archive:
    archive = Archive(Grid(WIDTH), (3, 2), 3)
    for first in range(0, len(z), batch):
        archive.add(z[first : first + batch], features[first : first + batch])
    return archive


def test_it_is_the_obvious_archive() -> None:
    z, features = members(3000)
    archive = filled(z, features, 170)
    expected = one_by_one(features)
    assert len(archive) == len(expected)
    rows = [row for row, _ in expected.values()]
    order = np.lexsort(features[rows].T)
    ours = state(archive)
    np.testing.assert_array_equal(ours[1], features[rows][order])
    np.testing.assert_array_equal(ours[0], z[rows][order])
    np.testing.assert_array_equal(ours[2], np.array([visits for _, visits in expected.values()])[order])


def test_batches_and_order_change_nothing() -> None:
    z, features = members(2000)
    shuffled = np.random.default_rng(3).permutation(2000)
    same(filled(z, features, 2000), filled(z[shuffled], features[shuffled], 33))


def test_merging_is_adding_everything_in_any_order() -> None:
    parts = [members(700, seed) for seed in range(3)]
    archives = [filled(z, features, 100) for z, features in parts]
    whole = filled(*(np.concatenate(x) for x in zip(*parts, strict=True)), 50)  # type: ignore[arg-type]
    merged = archives[0].merged(*archives[1:])
    same(merged, whole)
    other = archives[2].merged(archives[0], archives[1])
    for name in ("z", "features", "visits"):
        np.testing.assert_array_equal(getattr(merged, name), getattr(other, name))


def test_ties_go_to_the_lesser_features_whatever_came_first() -> None:
    features = np.array([[0.1, 0.125, 0.125], [0.15, 0.125, 0.125]])
    z = np.arange(12.0).reshape(2, 3, 2)
    for order in ([0, 1], [1, 0]):
        archive = filled(z[order], features[order], 1)
        np.testing.assert_array_equal(archive.features, features[:1])


def test_add_says_how_many_cells_are_new() -> None:
    z, features = members(500)
    archive = Archive(Grid(WIDTH), (3, 2), 3)
    assert archive.add(z, features) == len(archive)
    assert archive.add(z, features) == 0
    assert archive.add(z[:0], features[:0]) == 0


def test_spread_points_are_further_apart_than_random_ones() -> None:
    features = members(1000)[1]

    def closest(points: np.ndarray) -> float:
        distance = ((points[:, None] - points) ** 2).sum(axis=2)
        return float(distance[~np.eye(len(points), dtype=bool)].min())

    assert closest(spread(features, 20)) > 10 * closest(features[:20])
    assert len(spread(np.zeros((5, 2)), 3)) == 1


def test_refusals() -> None:
    with pytest.raises(ArgumentError, match="takes up to 6"):
        Grid(0.1).locate(np.zeros((1, 7)))
    with pytest.raises(ArgumentError, match="can be numbered"):
        Grid(1e-6).locate(np.full((1, 3), 9.0))
