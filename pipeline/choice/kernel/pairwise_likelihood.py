"""The log likelihood of a kernel bandwidth over pairs of rows, and its maximum."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from scipy.spatial.distance import cdist

from pipeline.arrays import FloatArray, IndexArray
from pipeline.choice.kernel.pairwise import is_halved, kernels
from pipeline.choice.kernel.unique_rows import DistinctRows
from pipeline.errors import BandwidthError

# The excess of a pair that is left out. It is finite, because its kernel is 0 and 0 * inf would be NaN. For every sigma
# down to _SMALLEST (both in units of the largest distance) excess / (2 sigma^2) is finite and the kernel is 0.
_LEFT_OUT = 1e180
_SMALLEST = 1e-60

_KEPT_ROWS = 3000  # up to this many rows all pairs are kept in memory (72 MB); above, they are formed block by block
_BLOCK_PAIRS = 4_000_000


class PairScore:
    """sum_i c_i log [ sum_j c_j exp(-d_ij^2 / 2 sigma^2) / (n_i (sigma sqrt(2 pi))^D) ] as a function of sigma.

    i and j run over distinct rows with counts c; j only over the n_i rows whose label differs from that of i. Without
    labels j runs over all rows, i included, and n_i is 1: the formula as the paper prints it.

    Args:
        groups: distinct rows (G, F), at least two.
        labels: (G,) a label per distinct row, or None.
        dimensions: D of the normaliser.

    Raises:
        BandwidthError: the rows are so close that their squared distances vanish.
    """

    def __init__(self, groups: DistinctRows, labels: IndexArray | None, dimensions: int) -> None:
        self._rows, self._counts, self._labels = groups.rows, groups.counts, labels
        self._dimensions = dimensions
        self._nearest = np.empty(len(groups.rows))
        self._farthest = np.empty(len(groups.rows))
        for block in self._block_slices():
            squared = cdist(self._rows[block], self._rows, "sqeuclidean")
            self._farthest[block] = squared.max(axis=1)
            if labels is not None:
                squared[labels[block, None] == labels] = np.inf
            self._nearest[block] = squared.min(axis=1)
        largest = self._farthest.max()
        if largest == 0 or (not self._nearest.any() and labels is not None):
            raise BandwidthError("features differ by less than 1e-160, whose squares vanish; scale the features up.")
        self._unit = math.sqrt(largest)
        self._nearest /= largest
        self._farthest /= largest
        self._kept = self._excess(slice(None)) if len(self._rows) <= _KEPT_ROWS else None
        total = self._counts.sum()
        scorers = np.ones_like(self._counts)
        if labels is not None:
            scorers = total - np.bincount(labels, weights=self._counts)[labels]
        self._constant = -float(self._counts @ np.log(scorers)) - total * dimensions * (
            0.5 * math.log(2 * math.pi) + math.log(self._unit)
        )

    def stationary_range(self) -> tuple[float, float]:
        """Bounds between which every stationary point lies.

        The slope vanishes where D sigma^2 is the mean over i of a weighted mean over j of d_ij^2, which lies between
        the squared distances of the nearest and the farthest row. A factor of sqrt(2) on either side puts every
        maximum inside the bounds.
        """
        weights = self._counts / (self._counts.sum() * self._dimensions)
        lower = math.sqrt(0.5 * float(np.sum(weights * self._nearest)))
        upper = math.sqrt(2.0 * float(np.sum(weights * self._farthest)))
        return lower * self._unit, upper * self._unit

    def distance_range(self) -> tuple[float, float]:
        """The smallest and the largest distance between rows that score each other."""
        return math.sqrt(self._nearest.min()) * self._unit, self._unit

    def log_likelihood(self, sigma: float) -> float:
        """The log likelihood of the bandwidth `sigma`."""
        return float(self._log_likelihoods(np.array([sigma / self._unit]))[0])

    def maximum(self, lower: float, upper: float) -> float | None:
        """The sigma in [lower, upper] of the largest score, found on a grid and refined on the slope.

        Returns None where the score is largest at the lower bound.

        Raises:
            BandwidthError: the largest score is at the upper bound, or the refinement found no zero slope.
        """
        low, high = max(lower / self._unit, _SMALLEST), upper / self._unit
        steps = max(math.ceil(2 * math.log2(high / low)), 1)
        grid = low * np.sqrt(2.0) ** np.arange(steps, -1, -1)
        best = int(np.argmax(self._log_likelihoods(grid)))
        if best == len(grid) - 1:
            return None
        if best == 0:
            raise BandwidthError(
                f"the likelihood of the bandwidth still grows at its upper bound {upper:g}; "
                "give the bandwidth as a number.",
                estimate=upper,
            )
        return self._refined(math.log(grid[best + 1]), math.log(grid[best - 1])) * self._unit

    def _refined(self, low: float, high: float) -> float:
        """The zero of the slope between two log sigmas around a maximum."""
        from scipy.optimize import brentq  # its import takes longer than most stages need for theirs

        for _ in range(20):
            if self._slope(low) > 0 > self._slope(high):
                return math.exp(brentq(self._slope, low, high, xtol=1e-11))
            # There is more than one maximum between them: look at a finer grid around the best.
            closer = np.linspace(high, low, 9)
            best = min(max(int(np.argmax(self._log_likelihoods(np.exp(closer)))), 1), 7)
            low, high = closer[best + 1], closer[best - 1]
        estimate = math.exp(0.5 * (low + high)) * self._unit
        raise BandwidthError(
            f"no maximum of the bandwidth's likelihood was found near {estimate:g}; give the bandwidth as a number.",
            estimate=estimate,
        )

    def _log_likelihoods(self, sigmas: FloatArray) -> FloatArray:
        """Scores at descending `sigmas` (units of the largest distance), in one pass over the pairs."""
        scores = -self._counts.sum() * self._dimensions * np.log(sigmas) + self._constant
        scores -= 0.5 * float(np.sum(self._counts * self._nearest)) / sigmas**2
        precisions, halved = np.array([0.5 / sigma**2 for sigma in sigmas]), is_halved(sigmas)
        for block, excess in self._excesses():
            for step, kernel in enumerate(kernels(excess, precisions, halved)):
                sums = np.einsum("ij,j->i", kernel, self._counts)
                scores[step] += float(np.sum(self._counts[block] * np.log(sums)))
        return np.asarray(scores)

    def _slope(self, log_sigma: float) -> float:
        """Derivative of the score by log sigma."""
        sigma = math.exp(log_sigma)
        mean_squares = float(np.sum(self._counts * self._nearest))
        for block, excess in self._excesses():
            kernel = np.exp(excess * (-0.5 / sigma**2))
            kernel *= self._counts
            means = np.einsum("ij,ij->i", kernel, excess) / kernel.sum(axis=1)
            mean_squares += float(np.sum(self._counts[block] * means))
        return mean_squares / sigma**2 - float(self._counts.sum()) * self._dimensions

    def _excesses(self) -> Iterator[tuple[slice, FloatArray]]:
        if self._kept is not None:
            yield slice(None), self._kept
            return
        for block in self._block_slices():
            yield block, self._excess(block)

    def _excess(self, block: slice) -> FloatArray:
        """Squared distances minus that of the nearest row, so that the largest kernel value of a row is 1, never 0."""
        squared = cdist(self._rows[block], self._rows, "sqeuclidean")
        squared /= self._unit**2
        squared -= self._nearest[block, None]
        if self._labels is not None:
            squared[self._labels[block, None] == self._labels] = _LEFT_OUT
        return squared

    def _block_slices(self) -> Iterator[slice]:
        step = max(_BLOCK_PAIRS // len(self._rows), 1)
        for start in range(0, len(self._rows), step):
            yield slice(start, start + step)
