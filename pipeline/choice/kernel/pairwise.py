"""Kernel sums over pairs of rows, tile by tile: all pairs, or all that are near enough to count."""

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
_MANY = 32  # tiles from which on two threads share the pairs

# All rows that are left out add at most this much to a kernel sum, relative to the largest term of the sum.
NEGLIGIBLE = 1e-8

POINTS = 4  # points of one tile: few, as they may lie far apart
LEAF = 128  # most rows of a leaf of the k-d tree
_RUN = 16  # leaves, next to each other, that are summed at once
_PIECE = 128  # leaves, anywhere, that are summed at once
_BRANCH = 64  # leaves, next to each other, that are first looked at as one
_FRESH = 16  # each squaring of a kernel value doubles its relative error: start again after so many


def log_sums_within(rows: FloatArray, counts: FloatArray, sigma: float) -> FloatArray:
    """(G,) at distinct rows (G, F) that occur `counts` times each."""
    tiles = [slice(start, start + _TILE) for start in range(0, len(rows), _TILE)]
    pairs = [(tile, tiles[:index]) for index, tile in enumerate(tiles)]
    # shares by the number of rows and not of cores, so that the bits are the same everywhere
    shares = [pairs] if len(pairs) < _MANY else [pairs[::2], pairs[1::2]]
    with ThreadPoolExecutor(len(shares)) as pool:
        parts = list(pool.map(lambda share: _pair_sums(rows, counts, sigma, share), shares))
    return _with_own(np.sum(parts, axis=0), counts)


def log_sums_at(points: FloatArray, rows: FloatArray, counts: FloatArray, sigma: float) -> FloatArray:
    """(M,) at any points, however far: the largest term is taken out of each tile's sum."""
    log_counts = np.log(counts)
    log_sums = np.full(len(points), -np.inf)
    width = 16 * _TILE
    height = max(width * _TILE // max(min(len(rows), width), 1), 1)
    for first in range(0, len(points), height):
        for start in range(0, len(rows), width):
            here, there = slice(first, first + height), slice(start, start + width)
            terms = exponents(points[here], rows[there], sigma) + log_counts[there]
            log_sums[here] = np.logaddexp(log_sums[here], log_sum_exp(terms, axis=1))
    return log_sums


def exponents(x: FloatArray, y: FloatArray, sigma: float) -> FloatArray:
    """-|x_i - y_j|^2 / (2 sigma^2); differences first, so that a common offset costs no digits."""
    with np.errstate(over="ignore"):  # beyond the largest double the exponent is -inf, the kernel 0
        return np.asarray(cdist(x, y, "sqeuclidean") * (-0.5 / sigma**2))


def cut_off(total: float, sigma: float, negligible: float = NEGLIGIBLE) -> float:
    """The distance r beyond which `total` rows together add less: total exp(-r^2 / 2 sigma^2) = negligible."""
    return sigma * math.sqrt(2 * math.log(total / negligible))


def _pair_sums(
    rows: FloatArray, counts: FloatArray, sigma: float, pairs: Iterable[tuple[slice, Iterable[slice]]]
) -> FloatArray:
    """(G,) each pair of tiles once, the kernel being symmetric: every tile with itself and those it is paired with."""
    others = np.zeros(len(rows))
    for here, partners in pairs:
        for there in partners:
            kernel = exponents(rows[here], rows[there], sigma)
            np.exp(kernel, out=kernel)
            others[here] += np.einsum("ij,j->i", kernel, counts[there])
            others[there] += np.einsum("ij,i->j", kernel, counts[here])
        kernel = np.exp(exponents(rows[here], rows[here], sigma))
        np.fill_diagonal(kernel, 0.0)
        others[here] += np.einsum("ij,j->i", kernel, counts[here])
    return others


def _with_own(others: FloatArray, counts: FloatArray) -> FloatArray:
    """Log sums with each row's own kernel; log1p keeps neighbours whose kernel is below the rounding of that."""
    return np.asarray(np.log(counts) + np.log1p(others / counts))


class Neighbours:
    """Kernel sums over the rows near enough to count.

    The rows are tiles, the leaves of a k-d tree; tiles beyond reach are left out whole. A sum is too small by less than
    1e-8 of its largest term, which bounds the error of its log.

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
        """(G,) at the rows themselves."""
        reach = cut_off(self._total, sigma) ** 2
        tiles = (
            (slice(*self._starts[tile : tile + 2]), self._runs(self._lower[tile], self._upper[tile], reach, tile))
            for tile in range(len(self._lower))
        )
        log_sums = np.empty(len(self._rows))
        others = _pair_sums(self._rows, self._counts, sigma, tiles)
        log_sums[self._order] = _with_own(others, self._counts)
        return log_sums

    def nearest(self, points: FloatArray, others: bool = False) -> FloatArray:
        """(M,) squared distance to the nearest row; with `others`, of points that are rows, to the nearest other."""
        distances = np.asarray(self._tree.query(points, k=[2 if others else 1])[0])[:, 0]
        return np.asarray(distances**2)

    def log_sums_at(self, points: FloatArray, sigma: float) -> FloatArray:
        """(M,) at any points, however far."""
        log_sums = np.empty(len(points))
        order = np.asarray(cKDTree(points).indices)
        nearest = self.nearest(points)
        precision = 0.5 / sigma**2
        for start in range(0, len(points), POINTS):
            here = order[start : start + POINTS]
            reach = float(nearest[here].max()) + cut_off(self._total, sigma) ** 2
            sums = np.zeros(len(here))
            for rows, counts in self._within(points[here], reach):
                # relative to the nearest row, whose term is then 1: no sum underflows, however far all rows are
                excess = cdist(points[here], rows, "sqeuclidean") - nearest[here, None]
                with np.errstate(over="ignore"):  # beyond the largest double the kernel is 0
                    excess *= -precision
                sums += np.einsum("ij,j->i", np.exp(excess, out=excess), counts)
            with np.errstate(over="ignore"):
                log_sums[here] = np.log(sums) - nearest[here] * precision
        return log_sums

    def log_sums_of_others(self, points: FloatArray, sigmas: FloatArray, negligible: float) -> FloatArray:
        """(K, M) at points that are rows, without the row that each is, for descending bandwidths in one pass.

        What is left out is less than `negligible` of the largest term of a sum.
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
        """(K, M) relative to the term of the nearest row."""
        reaches = nearest + cut_off(self._total, sigmas[0], negligible) ** 2
        precisions = 0.5 / sigmas**2
        halved = np.isclose(sigmas[:-1] / sigmas[1:], math.sqrt(2), rtol=1e-12, atol=0)
        sums = np.zeros((len(sigmas), len(points)))
        for number, reach in enumerate(reaches):
            for rows, counts in self._within(points[[number]], reach):
                excess = cdist(points[[number]], rows, "sqeuclidean")[0]
                excess[excess == 0] = np.inf
                excess -= nearest[number]
                kernel = np.empty_like(excess)
                for step, precision in enumerate(precisions):
                    # a step of sqrt(2) down in sigma squares the kernel: much cheaper than exp
                    if step % _FRESH and halved[step - 1]:
                        np.multiply(kernel, kernel, out=kernel)
                    else:
                        with np.errstate(over="ignore"):
                            np.multiply(excess, -precision, out=kernel)
                        np.exp(kernel, out=kernel)
                    sums[step, number] += np.einsum("j,j->", kernel, counts)
        return sums

    def _within(self, points: FloatArray, reach: float) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Rows and counts of the leaves within `reach`, a squared distance, of the box of the points, in pieces."""
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
        """Rows of those of the first leaves that lie within `reach`, a squared distance, of a box; next ones at once."""
        near = np.flatnonzero(_near(lower, upper, self._lower[:count], self._upper[:count], reach))
        for run in np.split(near, np.flatnonzero(np.diff(near) != 1) + 1):
            for first in range(0, len(run), _RUN):
                part = run[first : first + _RUN]
                yield slice(self._starts[part[0]], self._starts[part[-1] + 1])


def _near(lower: FloatArray, upper: FloatArray, lowers: FloatArray, uppers: FloatArray, reach: float) -> BoolArray:
    """(T,) which boxes lie within `reach`, a squared distance, of a box."""
    gaps = np.maximum(0.0, np.maximum(lower - uppers, lowers - upper))
    # a hair more, as the distances of boxes are rounded
    return np.asarray(np.einsum("tf,tf->t", gaps, gaps) <= reach * (1 + 1e-12))


def _leaf_starts(node: Any) -> Iterator[int]:
    if node.lesser is None:
        yield node.start_idx
    else:
        yield from _leaf_starts(node.lesser)
        yield from _leaf_starts(node.greater)
