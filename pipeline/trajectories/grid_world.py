"""Shortest paths through a square grid: all of them, their features, and the links they share.

Cells are (x, y) with whole coordinates from 0; a path goes from (0, 0) to (size - 1, size - 1) by steps right or up.
"""

from __future__ import annotations

from itertools import chain, combinations
from math import comb, isqrt

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from pipeline.arrays import FloatArray, IntArray
from pipeline.errors import ArgumentError

MAX_SIZE = 12  # 705,432 paths; size 13 has 2.7 million, too many for the memory of most machines

Cells = IntArray


def shortest_paths(size: int) -> Cells:
    """All comb(2 size - 2, size - 1) shortest paths from one corner of a size x size grid to the opposite one.

    Args:
        size: cells along each side, 2 to 12.

    Returns:
        (N, 2 size - 1, 2) cells x, y of each path. `itertools.combinations` lists which steps go right, and the paths
        are in that order: the first path starts with all its steps to the right.

    Raises:
        ArgumentError: the size is out of range.
    """
    if not 2 <= size <= MAX_SIZE:
        raise ArgumentError(f"size is {size}; it must be a whole number from 2 to {MAX_SIZE}.")
    steps, right = 2 * size - 2, size - 1
    count = comb(steps, right)
    chosen = np.fromiter(
        chain.from_iterable(combinations(range(steps), right)), dtype=np.int64, count=count * right
    ).reshape(count, right)
    goes_right = np.zeros((count, steps), dtype=np.int64)
    np.put_along_axis(goes_right, chosen, 1, axis=1)
    paths = np.zeros((count, steps + 1, 2), dtype=np.int64)
    np.cumsum(goes_right, axis=1, out=paths[:, 1:, 0])
    paths[:, :, 1] = np.arange(steps + 1) - paths[:, :, 0]
    return paths


def mean_distances(paths: Cells, objects: ArrayLike) -> FloatArray:
    """Mean Euclidean distance of each path's cells to each object, in cells.

    Every distance is a whole number times sqrt(m), with m free of squares, and these roots are linearly independent
    over the rationals. The whole numbers are summed first, for each m, so that paths with equal mean distances have
    features that are equal to the last bit.

    Args:
        paths: (N, T, 2) cells.
        objects: (F, 2) cells with whole coordinates.

    Returns:
        (N, F) mean distances.

    Raises:
        ArgumentError: the coordinates of an object are not whole numbers.
    """
    centres = np.asarray(objects)
    if centres.ndim != 2 or centres.shape[1] != 2 or not np.issubdtype(centres.dtype, np.integer):
        raise ArgumentError(f"objects is {centres.tolist()}; give one pair of whole coordinates per object.")
    return np.column_stack([_mean_distance(paths, centre) for centre in centres])


def mean_positions(paths: Cells) -> FloatArray:
    """(N, 2) mean x and mean y of each path's cells. They sum to size - 1: a step is either right or up."""
    means: FloatArray = paths.mean(axis=1)
    return means


def link_incidence(paths: Cells) -> sparse.csr_array:
    """(N, E) 1 where a path takes a link between neighbouring cells, else 0; the E links are in lexicographic order.

    This matrix is what the path-size model (`pipeline.choice.PathSize`) compares.
    """
    side = int(paths.max()) + 1
    cell = paths[:, :, 0] * side + paths[:, :, 1]
    links, index = np.unique(cell[:, :-1] * side * side + cell[:, 1:], return_inverse=True)
    count, steps = cell.shape[0], cell.shape[1] - 1
    starts = np.arange(0, count * steps + 1, steps)
    return sparse.csr_array((np.ones(count * steps), index.ravel(), starts), shape=(count, links.size))


def _mean_distance(paths: Cells, centre: IntArray) -> FloatArray:
    squared = ((paths - centre) ** 2).sum(axis=2)
    values, index = np.unique(squared, return_inverse=True)
    factors, radicands = np.array([_simplest_root(int(value)) for value in values]).T
    total: FloatArray = np.zeros(len(paths))
    for radicand in np.unique(radicands):
        whole = np.where(radicands == radicand, factors, 0)[index.reshape(squared.shape)].sum(axis=1)
        total += whole * np.sqrt(float(radicand))
    total /= paths.shape[1]
    return total


def _simplest_root(value: int) -> tuple[int, int]:
    """(k, m) with sqrt(value) = k sqrt(m) and m free of squares; (0, 1) for zero."""
    if value == 0:
        return 0, 1
    k = max(k for k in range(1, isqrt(value) + 1) if value % (k * k) == 0)
    return k, value // (k * k)
