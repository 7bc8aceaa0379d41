"""The leave-one-out likelihood of a bandwidth on some of the rows, each against all of the others."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pipeline.arrays import FloatArray, IndexArray
from pipeline.choice.kernel.pairwise_likelihood import PairScore
from pipeline.choice.kernel.row_sample import Reference, ScoredRows
from pipeline.choice.kernel.sampled_sums import Plan, SampledSums
from pipeline.choice.kernel.unique_rows import DistinctRows
from pipeline.errors import BandwidthError

LIMIT = 5000  # up to so many distinct rows, all are scored

_STEP = 0.5 * math.log(2)  # of log sigma, between the bandwidths that are tried first
_NODES = np.array([0.15, 0.05, -0.05, -0.15])  # of log sigma, between which the score is a cubic
_CUBIC = np.linalg.inv(np.vander(_NODES, increasing=True))
_INNER = 0.12  # from their middle, a maximum is as good as that of the score
_MARGIN = 0.05  # a sketch reaches so much farther down, for the next four
_FARTHEST = 0.3  # the longest step
_MOVES = 20


@dataclass(frozen=True)
class Estimate:
    """What the sample says of all rows.

    Attributes:
        sigma: the bandwidth of the largest score.
        log_likelihood: of all rows.
        log_likelihood_error: its standard error.
        sigma_error: standard error of sigma as the maximum: that of the mean slope, divided by the curvature.
    """

    sigma: float
    log_likelihood: float
    log_likelihood_error: float
    sigma_error: float


class SampledScore:
    """sum_i log [ sum_j exp(-d_ij^2 / 2 sigma^2) / (n_i (sigma sqrt(2 pi))^F) ], estimated from some of the rows i.

    j runs over all n_i rows that are not identical to row i. Which rows i are scored, and how they stand for all, is in
    `row_sample`; how their kernel sums are computed, and how well, in `sampled_sums`.

    Args:
        rows: the set.
    """

    def __init__(self, rows: Reference) -> None:
        self._set, self._dimensions = rows, len(rows.lower)
        self._rows = ScoredRows.of(rows.drawn, rows.total)
        self._sums = SampledSums(rows, self._rows)

    @property
    def rows_scored(self) -> int:
        """How many rows are scored, identical ones each."""
        return int(self._rows.often.sum())

    def first_plan(self) -> Plan | None:
        """The sketch that `maximum` begins with, if any."""
        return self._sums.plan(*self._first_bandwidths())

    def maximum(self) -> Estimate:
        """The sigma of the largest score.

        A part of the set by itself has its maximum at a wider bandwidth: its likelihood falls short of that of the whole
        set, the more the narrower the kernel. All steps of sqrt(2) from there down to the least possible maximum are
        scored on a quarter of the rows, and more upwards while the score grows. The parabola through the best step and its
        neighbours says about where four bandwidths are scored on all, whose cubic has the maximum.

        Raises:
            BandwidthError: the score has no maximum between its bounds.
        """
        grid, nodes = self._first_bandwidths()
        self._sums.prepare(grid, nodes)
        return self._refined(self._best_step(grid))

    def _first_bandwidths(self) -> tuple[list[float], FloatArray]:
        """The log bandwidths that are tried first, in descending steps, and four about where the maximum may be."""
        wider = math.log(self._maximum_of_some())
        lower = 0.5 * math.log(0.5 * self._rows.mean_nearest / self._dimensions)
        count = max(math.ceil((wider + _STEP - lower) / _STEP), 2) + 1
        # the maximum of smooth features narrows with the (F + 4)th root of their number
        smooth = wider - math.log(self._set.distinct / len(self._set.drawn.first)) / (self._dimensions + 4)
        return [wider + _STEP * (1 - number) for number in range(count)], smooth + _NODES - _MARGIN

    def _maximum_of_some(self) -> float:
        """The maximum of some distinct rows by themselves."""
        drawn = self._set.drawn
        some = DistinctRows(drawn.first, drawn.first_counts, np.arange(len(drawn.first)))
        score = PairScore(some, np.arange(len(some.rows)), self._dimensions)
        lower, upper = score.stationary_range()
        return score.maximum(lower, upper) or upper

    def _best_step(self, grid: list[float]) -> float:
        """About the log bandwidth of the largest score on a quarter of the rows: the peak of the parabola through three."""
        scores = self._quarter_means(grid)
        widest = math.log(2 * math.dist(self._set.lower, self._set.upper))
        while scores[0] == max(scores) and grid[0] < widest:
            grid.insert(0, grid[0] + _STEP)
            scores.insert(0, *self._quarter_means(grid[:1]))
        best = min(max(int(np.argmax(scores)), 1), len(grid) - 2)
        above, here, below = scores[best - 1 : best + 2]
        bend = above - 2 * here + below
        return grid[best] - (0.5 * _STEP * (above - below) / bend if bend < 0 else 0.0)

    def _refined(self, log_sigma: float) -> Estimate:
        """The maximum of the cubic through four scores on all scored rows; others are tried until it is among them."""
        for _ in range(_MOVES):
            self._sums.prepare([], log_sigma + _NODES - _MARGIN)
            cubics = np.einsum("kn,ns->ks", _CUBIC, self._scores(log_sigma + _NODES))
            move = self._to_maximum(cubics)
            if abs(move) <= _INNER:
                return self._estimate(log_sigma, move, cubics)
            log_sigma += max(-_FARTHEST, min(_FARTHEST, move))
        raise BandwidthError(
            f"no maximum of the bandwidth's likelihood was found near {math.exp(log_sigma):g}; "
            "give the bandwidth as a number.",
            estimate=math.exp(log_sigma),
        )

    def _to_maximum(self, cubics: FloatArray) -> float:
        """How far the maximum of the mean of the rows' cubics (4, S) is from their middle; 1 uphill if it has none."""
        slope, bend, twist = map(self._rows.average, cubics[1:])
        if bend < 0 and bend**2 > 3 * slope * twist:
            return slope / (math.sqrt(bend**2 - 3 * slope * twist) - bend)
        return math.copysign(1.0, slope)

    def _estimate(self, log_sigma: float, move: float, cubics: FloatArray) -> Estimate:
        constant, linear, square, cube = cubics
        sigma = math.exp(log_sigma + move)
        here = constant + move * (linear + move * (square + move * cube))
        slopes = linear + move * (2 * square + 3 * move * cube)
        curvature = 2 * self._rows.average(square) + 6 * move * self._rows.average(cube)
        return Estimate(
            sigma,
            self._set.total * self._rows.average(here),
            self._set.total * self._rows.standard_error(here),
            sigma * self._rows.standard_error(slopes) / -curvature,
        )

    def _quarter_means(self, log_sigmas: list[float]) -> list[float]:
        scores = self._scores(log_sigmas, self._rows.quarter)
        return [float(np.average(values, weights=self._rows.quarter_weights)) for values in scores]

    def _scores(self, log_sigmas: ArrayLike, some: IndexArray | slice = slice(None)) -> FloatArray:
        """(K, S) log likelihood of each distinct row that is scored, for descending bandwidths."""
        norms = self._dimensions * (np.asarray(log_sigmas)[:, None] + 0.5 * math.log(2 * math.pi))
        log_sums = self._sums.log_sums(np.exp(log_sigmas), some)
        return np.asarray(log_sums - np.log(self._set.total - self._rows.own[some]) - norms)
