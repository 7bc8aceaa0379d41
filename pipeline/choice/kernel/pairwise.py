"""Kernel sums over pairs of rows, tile by tile: over all pairs, or over those that are near enough to count."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from pipeline.arrays import BoolArray, FloatArray, IndexArray
from pipeline.choice.logspace import log_sum_exp

# A tile of 256 x 256 kernel values (0.5 MB) stays in the cache.
_TILE = 256
_MANY = 32  # from this many tiles on, two threads share the pairs

# All rows that are left out of a kernel sum add up to at most this much, relative to its largest term.
NEGLIGIBLE = 1e-8

POINTS = 4  # points in one tile: few, as they may lie far apart
LEAF = 128  # the most rows in a leaf of the k-d tree
_RUN = 16  # the most consecutive leaves that are summed at once
_PIECE = 128  # the most leaves, consecutive or not, that are summed at once
_BRANCH = 64  # consecutive leaves whose common box is looked at before theirs
_FRESH = 16  # each squaring of a kernel value doubles its relative error: call exp again after this many


def log_sums_within(rows: FloatArray, counts: FloatArray, sigma: float) -> FloatArray:
    """(G,) log kernel sums at distinct rows (G, F) that occur `counts` (G,) times each."""
    tiles = [slice(start, start + _TILE) for start in range(0, len(rows), _TILE)]
    pairs = [(tile, tiles[:index]) for index, tile in enumerate(tiles)]
    # the number of shares depends on the rows and never on the cores, so that the bits are the same everywhere
    shares = [pairs] if len(pairs) < _MANY else [pairs[::2], pairs[1::2]]
    if len(shares) == 1:
        return _log_sums(_pair_sums(rows, counts, sigma, pairs), counts)
    with ThreadPoolExecutor(len(shares)) as pool:
        parts = list(pool.map(lambda share: _pair_sums(rows, counts, sigma, share), shares))
    return _log_sums(np.sum(parts, axis=0), counts)


def log_sums_at(points: FloatArray, rows: FloatArray, counts: FloatArray, sigma: float) -> FloatArray:
    """(M,) log kernel sums over rows (G, F) at any points (M, F), however far: no sum underflows."""
    log_counts = np.log(counts)
    log_sums = np.full(len(points), -np.inf)
    width = 16 * _TILE
    height = max(width * _TILE // max(min(len(rows), width), 1), 1)
    for first_point in range(0, len(points), height):
        for first_row in range(0, len(rows), width):
            targets, sources = slice(first_point, first_point + height), slice(first_row, first_row + width)
            terms = exponents(points[targets], rows[sources], sigma) + log_counts[sources]
            log_sums[targets] = np.logaddexp(log_sums[targets], log_sum_exp(terms, axis=1))
    return log_sums


def exponents(x: FloatArray, y: FloatArray, sigma: float) -> FloatArray:
    """(M, G) -|x_i - y_j|^2 / (2 sigma^2); a common offset of x and y costs no digits."""
    with np.errstate(over="ignore"):  # beyond the largest double the exponent is -inf, the kernel 0
        return np.asarray(cdist(x, y, "sqeuclidean") * (-0.5 / sigma**2))


def is_halved(sigmas: FloatArray) -> BoolArray:
    """(K,) which of the descending bandwidths is the one before divided by sqrt(2)."""
    return np.append(False, np.isclose(sigmas[:-1] / sigmas[1:], math.sqrt(2), rtol=1e-12, atol=0))


def kernels(excess: FloatArray, precisions: FloatArray, halved: BoolArray) -> Iterator[FloatArray]:
    """Kernel values exp(-excess / (2 sigma^2)) for each of K descending bandwidths.

    A step of sqrt(2) down in sigma squares the kernel, which is much cheaper than exp.

    Args:
        excess: (...) squared distances, or these minus that of the nearest row.
        precisions: (K,) 1 / (2 sigma^2).
        halved: (K,) the result of `is_halved`.

    Yields:
        (...) the values for one bandwidth; each overwrites the one before.
    """
    kernel = np.empty_like(excess)
    for step, precision in enumerate(precisions):
        if step % _FRESH and halved[step]:
            np.multiply(kernel, kernel, out=kernel)
        else:
            with np.errstate(over="ignore"):  # beyond the largest double the kernel is 0
                np.multiply(excess, -precision, out=kernel)
            np.exp(kernel, out=kernel)
        yield kernel


def cut_off(total: float, sigma: float, negligible: float = NEGLIGIBLE) -> float:
    """The distance r beyond which `total` rows together add less: total exp(-r^2 / 2 sigma^2) = negligible."""
    return sigma * math.sqrt(2 * math.log(total / negligible))


def _pair_sums(
    rows: FloatArray, counts: FloatArray, sigma: float, pairs: Iterable[tuple[slice, Iterable[slice]]]
) -> FloatArray:
    """(G,) kernel sums over all other rows, of each tile with itself and its partners.

    Each pair of tiles is given once, and serves both of them as the kernel is symmetric.
    """
    sums = np.zeros(len(rows))
    for tile, partners in pairs:
        for partner in partners:
            kernel = exponents(rows[tile], rows[partner], sigma)
            np.exp(kernel, out=kernel)
            sums[tile] += np.einsum("ij,j->i", kernel, counts[partner])
            sums[partner] += np.einsum("ij,i->j", kernel, counts[tile])
        kernel = np.exp(exponents(rows[tile], rows[tile], sigma))
        np.fill_diagonal(kernel, 0.0)
        sums[tile] += np.einsum("ij,j->i", kernel, counts[tile])
    return sums


def _log_sums(sums_of_others: FloatArray, counts: FloatArray) -> FloatArray:
    """log(counts + sums over the others); log1p keeps sums that are below the rounding of `counts`."""
    return np.asarray(np.log(counts) + np.log1p(sums_of_others / counts))


class Neighbours:
    """Kernel sums over the rows near enough to count.

    The tiles are the leaves of a k-d tree, and tiles beyond the cut-off are left out. What is missing in a sum is less
    than 1e-8 of its largest term, which bounds the error of its log.

    Args:
        rows: (G, F) distinct rows.
        counts: (G,) how often each occurs.
    """

    def __init__(self, rows: FloatArray, counts: FloatArray) -> None:
        self._tree = cKDTree(rows, leafsize=LEAF)
        self._order: IndexArray = np.asarray(self._tree.indices)
        self._rows, self._counts = rows[self._order], counts[self._order]
        self._total = float(counts.sum())
        self._starts = np.array([*_leaf_starts(self._tree.tree), len(rows)])
        self._lower = np.minimum.reduceat(self._rows, self._starts[:-1])
        self._upper = np.maximum.reduceat(self._rows, self._starts[:-1])
        branches = np.arange(0, len(self._lower), _BRANCH)
        self._branch_lower = np.minimum.reduceat(self._lower, branches)
        self._branch_upper = np.maximum.reduceat(self._upper, branches)

    def log_sums_within(self, sigma: float) -> FloatArray:
        """(G,) log kernel sums at the rows themselves."""
        reach = cut_off(self._total, sigma) ** 2
        tiles = (
            (slice(*self._starts[tile : tile + 2]), self._runs(self._lower[tile], self._upper[tile], reach, tile))
            for tile in range(len(self._lower))
        )
        log_sums = np.empty(len(self._rows))
        log_sums[self._order] = _log_sums(_pair_sums(self._rows, self._counts, sigma, tiles), self._counts)
        return log_sums

    def nearest(self, points: FloatArray, others: bool = False) -> FloatArray:
        """(M,) squared distance to the nearest row; with `others`, where points are rows, to the nearest other row."""
        distances = np.asarray(self._tree.query(points, k=[2 if others else 1])[0])[:, 0]
        return np.asarray(distances**2)

    def log_sums_at(self, points: FloatArray, sigma: float) -> FloatArray:
        """(M,) log kernel sums at any points (M, F), however far."""
        log_sums = np.empty(len(points))
        order = np.asarray(cKDTree(points).indices)
        nearest = self.nearest(points)
        precision = 0.5 / sigma**2
        for start in range(0, len(points), POINTS):
            tile = order[start : start + POINTS]
            reach = float(nearest[tile].max()) + cut_off(self._total, sigma) ** 2
            sums = np.zeros(len(tile))
            for rows, counts in self._within(points[tile], reach):
                # relative to the nearest row, whose term is then 1: no sum underflows, however far all rows are
                excess = cdist(points[tile], rows, "sqeuclidean") - nearest[tile, None]
                with np.errstate(over="ignore"):  # beyond the largest double the kernel is 0
                    excess *= -precision
                sums += np.einsum("ij,j->i", np.exp(excess, out=excess), counts)
            with np.errstate(over="ignore"):
                log_sums[tile] = np.log(sums) - nearest[tile] * precision
        return log_sums

    def log_sums_of_others(self, points: FloatArray, sigmas: FloatArray, negligible: float) -> FloatArray:
        """(K, M) log kernel sums at points that are rows, over all other rows, for descending bandwidths in one pass.

        The terms left out of a sum add up to less than `negligible` times its largest term.
        """
        nearest = self.nearest(points, others=True)
        halves = [slice(len(points) // 2), slice(len(points) // 2, None)]
        with ThreadPoolExecutor(len(halves)) as pool:
            parts = pool.map(lambda half: self._sums_of_others(points[half], nearest[half], sigmas, negligible), halves)
            sums = np.concatenate(list(parts), axis=1)
        return np.asarray(np.log(sums) - nearest * (0.5 / sigmas[:, None] ** 2))

    def _sums_of_others(
        self, points: FloatArray, nearest: FloatArray, sigmas: FloatArray, negligible: float
    ) -> FloatArray:
        """(K, M) the same sums, relative to the term of the nearest other row."""
        reaches = nearest + cut_off(self._total, sigmas[0], negligible) ** 2
        precisions = 0.5 / sigmas**2
        halved = is_halved(sigmas)
        sums = np.zeros((len(sigmas), len(points)))
        for number, reach in enumerate(reaches):
            for rows, counts in self._within(points[[number]], reach):
                excess = cdist(points[[number]], rows, "sqeuclidean")[0]
                excess[excess == 0] = np.inf
                excess -= nearest[number]
                for step, kernel in enumerate(kernels(excess, precisions, halved)):
                    sums[step, number] += np.einsum("j,j->", kernel, counts)
        return sums

    def _within(self, points: FloatArray, reach: float) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Rows and counts of the leaves within `reach` (a squared distance) of the points' box, piece by piece."""
        lower, upper = points.min(axis=0), points.max(axis=0)
        branches = np.flatnonzero(_near(lower, upper, self._branch_lower, self._branch_upper, reach))
        leaves = (branches[:, None] * _BRANCH + np.arange(_BRANCH)).ravel()
        leaves = leaves[: np.searchsorted(leaves, len(self._lower))]
        leaves = leaves[_near(lower, upper, self._lower[leaves], self._upper[leaves], reach)]
        starts, ends = self._starts[leaves].tolist(), self._starts[leaves + 1].tolist()
        for first in range(0, len(starts), _PIECE):
            part = slice(first, first + _PIECE)
            rows = [self._rows[start:end] for start, end in zip(starts[part], ends[part], strict=True)]
            counts = [self._counts[start:end] for start, end in zip(starts[part], ends[part], strict=True)]
            yield np.concatenate(rows), np.concatenate(counts)

    def _runs(self, lower: FloatArray, upper: FloatArray, reach: float, count: int) -> Iterator[slice]:
        """Slices of rows of those of the first `count` leaves that lie within `reach` (a squared distance) of a box.

        Consecutive leaves share a slice.
        """
        near = np.flatnonzero(_near(lower, upper, self._lower[:count], self._upper[:count], reach))
        for run in np.split(near, np.flatnonzero(np.diff(near) != 1) + 1):
            for first in range(0, len(run), _RUN):
                part = run[first : first + _RUN]
                yield slice(self._starts[part[0]], self._starts[part[-1] + 1])


def _near(lower: FloatArray, upper: FloatArray, lowers: FloatArray, uppers: FloatArray, reach: float) -> BoolArray:
    """(T,) which of T boxes lie within `reach` (a squared distance) of a box."""
    gaps = np.maximum(0.0, np.maximum(lower - uppers, lowers - upper))
    # slightly more than the reach, as the distances of boxes are rounded
    return np.asarray(np.einsum("tf,tf->t", gaps, gaps) <= reach * (1 + 1e-12))


def _leaf_starts(node: Any) -> Iterator[int]:
    if node.lesser is None:
        yield node.start_idx
    else:
        yield from _leaf_starts(node.lesser)
        yield from _leaf_starts(node.greater)
