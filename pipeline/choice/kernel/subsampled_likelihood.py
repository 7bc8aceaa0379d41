"""The leave-one-out likelihood of a bandwidth on a sample of the rows, each against all other rows."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pipeline.arrays import FloatArray, IndexArray
from pipeline.choice.kernel.pairwise_likelihood import PairScore
from pipeline.choice.kernel.row_sample import RowSource, ScoredRows
from pipeline.choice.kernel.sampled_sums import Plan, SampledSums
from pipeline.choice.kernel.unique_rows import DistinctRows
from pipeline.errors import BandwidthError

LIMIT = 5000  # up to this many distinct rows, all rows are scored

# All of these are differences of log sigma.
_STEP = 0.5 * math.log(2)  # between the bandwidths that are tried first
_NODES = np.array([0.15, 0.05, -0.05, -0.15])  # of four bandwidths to their middle; the score is a cubic through them
_CUBIC = np.linalg.inv(np.vander(_NODES, increasing=True))
_INNER = 0.12  # up to here from the middle, the maximum of the cubic is as good as that of the score
_MARGIN = 0.05  # a sketch serves bandwidths this much narrower than needed, in case the middle moves
_FARTHEST = 0.3  # the most that the middle moves at once
_MOVES = 20  # the most moves


@dataclass(frozen=True)
class Estimate:
    """The best bandwidth for all rows, estimated from the sample.

    Attributes:
        sigma: the bandwidth of the largest score.
        log_likelihood: estimated log likelihood of all rows at `sigma`.
        log_likelihood_error: standard error of `log_likelihood`.
        sigma_error: standard error of `sigma`: that of the mean slope at the maximum, divided by the curvature.
    """

    sigma: float
    log_likelihood: float
    log_likelihood_error: float
    sigma_error: float


class SampledScore:
    """sum_i log [ sum_j exp(-d_ij^2 / 2 sigma^2) / (n_i (sigma sqrt(2 pi))^F) ], estimated from a sample of the rows i.

    j runs over all n_i rows that are not identical to row i. `row_sample` says which rows i are scored and how they
    represent all rows; `sampled_sums` says how their kernel sums are computed and how accurate they are.

    Args:
        rows: the set.
    """

    def __init__(self, rows: RowSource) -> None:
        self._set, self._dimensions = rows, len(rows.lower)
        self._rows = ScoredRows.of(rows.drawn, rows.total)
        self._sums = SampledSums(rows, self._rows)

    @property
    def rows_scored(self) -> int:
        """Number of rows that are scored, where each of several identical rows counts."""
        return int(self._rows.draws.sum())

    def first_plan(self) -> Plan | None:
        """The sketch that `maximum` begins with, if any."""
        return self._sums.plan(*self._first_bandwidths())

    def maximum(self) -> Estimate:
        """The sigma of the largest score.

        The search starts at the best bandwidth of a small part of the set by itself, which is wider than that of the
        whole set, as a part is less dense. All steps of sqrt(2) from there down to the smallest possible maximum are
        scored on a quarter of the sample, and more upwards while the score grows. The maximum of the parabola through
        the best step and its two neighbours is the middle of four bandwidths, which are scored on the whole sample. The
        maximum of the cubic through these four is the result.

        Raises:
            BandwidthError: the score has no maximum between its bounds.
        """
        steps, nodes = self._first_bandwidths()
        self._sums.prepare(steps, nodes)
        return self._refined(self._best_step(steps))

    def _first_bandwidths(self) -> tuple[list[float], FloatArray]:
        """The log bandwidths that are tried first, in descending steps, and four around a guess of the maximum."""
        wider = math.log(self._maximum_of_start_rows())
        lower = 0.5 * math.log(0.5 * self._rows.mean_nearest / self._dimensions)
        count = max(math.ceil((wider + _STEP - lower) / _STEP), 2) + 1
        # if the features are distributed smoothly, the best bandwidth narrows with the (F + 4)th root of their number
        guess = wider - math.log(self._set.distinct / len(self._set.drawn.start_rows)) / (self._dimensions + 4)
        return [wider + _STEP * (1 - number) for number in range(count)], guess + _NODES - _MARGIN

    def _maximum_of_start_rows(self) -> float:
        """The best bandwidth for a small part of the set by itself."""
        drawn = self._set.drawn
        positions = np.arange(len(drawn.start_rows))
        groups = DistinctRows(drawn.start_rows, drawn.start_counts, positions)
        score = PairScore(groups, positions, self._dimensions)
        lower, upper = score.stationary_range()
        return score.maximum(lower, upper) or upper

    def _best_step(self, steps: list[float]) -> float:
        """The log bandwidth of about the largest score on a quarter of the sample.

        It is the peak of the parabola through the best step and its two neighbours.
        """
        scores = self._quarter_means(steps)
        widest = math.log(2 * math.dist(self._set.lower, self._set.upper))
        while scores[0] == max(scores) and steps[0] < widest:
            steps.insert(0, steps[0] + _STEP)
            scores.insert(0, *self._quarter_means(steps[:1]))
        best = min(max(int(np.argmax(scores)), 1), len(steps) - 2)
        above, middle, below = scores[best - 1 : best + 2]
        bend = above - 2 * middle + below
        return steps[best] - (0.5 * _STEP * (above - below) / bend if bend < 0 else 0.0)

    def _refined(self, log_sigma: float) -> Estimate:
        """The maximum of the cubic through four scores on the whole sample, moved until the maximum is among them."""
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
        """Distance from the middle to the maximum of the mean of the rows' cubics (4, S); 1 uphill if there is none."""
        slope, bend, twist = map(self._rows.average, cubics[1:])
        if bend < 0 and bend**2 > 3 * slope * twist:
            return slope / (math.sqrt(bend**2 - 3 * slope * twist) - bend)
        return math.copysign(1.0, slope)

    def _estimate(self, log_sigma: float, move: float, cubics: FloatArray) -> Estimate:
        constant, linear, square, cube = cubics
        sigma = math.exp(log_sigma + move)
        scores = constant + move * (linear + move * (square + move * cube))
        slopes = linear + move * (2 * square + 3 * move * cube)
        curvature = 2 * self._rows.average(square) + 6 * move * self._rows.average(cube)
        return Estimate(
            sigma,
            self._set.total * self._rows.average(scores),
            self._set.total * self._rows.standard_error(scores),
            sigma * self._rows.standard_error(slopes) / -curvature,
        )

    def _quarter_means(self, log_sigmas: list[float]) -> list[float]:
        scores = self._scores(log_sigmas, self._rows.quarter)
        return [float(np.average(values, weights=self._rows.quarter_weights)) for values in scores]

    def _scores(self, log_sigmas: ArrayLike, positions: IndexArray | slice = slice(None)) -> FloatArray:
        """(K, S) log likelihood of each of these scored rows, for K descending bandwidths."""
        norms = self._dimensions * (np.asarray(log_sigmas)[:, None] + 0.5 * math.log(2 * math.pi))
        log_sums = self._sums.log_sums(np.exp(log_sigmas), positions)
        return np.asarray(log_sums - np.log(self._set.total - self._rows.occurrences[positions]) - norms)
