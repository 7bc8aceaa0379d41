"""The leave-one-out likelihood of a bandwidth on some of the rows, each against all of the others."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.random import PCG64, Generator
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from pipeline.choice import engines
from pipeline.choice.checks import FloatArray
from pipeline.choice.pair_score import PairScore
from pipeline.choice.pairs import Neighbours
from pipeline.choice.sketch import DIMENSIONS, Grid, Sketch
from pipeline.choice.ties import DistinctRows
from pipeline.errors import BandwidthError

LIMIT = 5000  # up to so many distinct rows, all are scored

_SEED = 0
_DRAWN = 50_000  # rows whose nearest neighbour is looked up
_STRATUM = 2000  # of them, the most isolated ones are scored all, and about as many of the others
_FIRST = 2000  # distinct rows whose own likelihood says where to start
_RELATIVE_ERROR = 1e-6  # of a row's kernel sum
_STEP = 0.05  # of log sigma, for derivatives by it; their error moves the maximum by about _STEP^2 / 6
_NEWTON = 0.04  # a last step of Newton's method in log sigma, whose error is of the order of its square
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

    j runs over all n_i rows that are not identical to row i. The rows i are drawn in two phases: 50,000 of all (or all),
    the first of a permutation of the rows in lexicographic order from PCG64(0); of these the 2000 most isolated, whose
    scores differ most, the most repeated, and every k-th of the others in order of their isolation, each of which stands for k. The same
    rows are drawn for every order of the set. Wide bandwidths share the sketch of the set; narrow ones, and rows too
    isolated for it, are summed over neighbours.

    Args:
        groups: distinct rows (G, F).
    """

    def __init__(self, groups: DistinctRows) -> None:
        self._groups = groups
        self._total, self._dimensions = len(groups.index), groups.rows.shape[1]
        self._neighbours = Neighbours(groups.rows, groups.counts)
        generator = Generator(PCG64(_SEED))
        self._first = np.sort(generator.permutation(len(groups.rows))[:_FIRST])
        self._draw(generator.permutation(self._total)[:_DRAWN])
        self._sketch: Sketch | None = None
        self._narrowest = math.inf

    def _draw(self, drawn: NDArray[np.intp]) -> None:
        self._drawn = len(drawn)
        owners = np.searchsorted(np.cumsum(self._groups.counts), drawn, side="right")
        candidates, often = np.unique(owners, return_counts=True)
        nearest = self._neighbours.nearest(self._groups.rows[candidates], others=True)
        if not nearest.any():
            raise BandwidthError("features differ by less than 1e-160, whose squares vanish; scale the features up.")
        self._mean_nearest = float(np.average(nearest, weights=often))
        # all of the most isolated, and of those so often repeated that one of them outweighs a 2000th of what was drawn
        certain = often * _STRATUM > len(drawn)
        certain[np.argsort(-nearest, kind="stable")[:_STRATUM]] = True
        others = np.flatnonzero(~certain)
        others = others[np.argsort(-nearest[others], kind="stable")]
        every = max(math.ceil(len(others) / _STRATUM), 1)
        kept = np.concatenate([np.flatnonzero(certain), others[every // 2 :: every]])
        self._certain = int(certain.sum())
        self._often = often[kept].astype(np.float64)
        self._stands_for = np.ones(len(kept))
        if len(others):
            self._stands_for[self._certain :] = often[others].sum() / self._often[self._certain :].sum()
        self._points, self._own = self._groups.rows[candidates[kept]], self._groups.counts[candidates[kept]]

    @property
    def rows_scored(self) -> int:
        """How many rows are scored, identical ones each."""
        return int(self._often.sum())

    def maximum(self) -> Estimate:
        """The sigma of the largest score.

        A part of the set by itself has its maximum at a wider bandwidth: its likelihood falls short of that of the whole
        set, the more the narrower the kernel. All steps of sqrt(2) from there down to the least possible maximum are
        scored on a quarter of the rows, and more upwards while the score grows; the best step is refined on that quarter,
        and then on all by Newton's method.

        Raises:
            BandwidthError: the score has no maximum between its bounds.
        """
        step, quarter = 0.5 * math.log(2), slice(None, None, 4)
        upper = math.log(self._wider()) + step
        lower = 0.5 * math.log(0.5 * self._mean_nearest / self._dimensions)
        grid = [upper - step * number for number in range(max(math.ceil((upper - lower) / step), 2) + 1)]
        self._prepare(np.exp(grid))
        scores = [self._mean(log_sigma, quarter) for log_sigma in grid]
        widest = math.log(2 * math.dist(self._groups.rows.min(axis=0), self._groups.rows.max(axis=0)))
        while scores[0] == max(scores) and grid[0] < widest:
            grid.insert(0, grid[0] + step)
            scores.insert(0, self._mean(grid[0], quarter))
        best = grid[int(np.argmax(scores))]
        found = minimize_scalar(
            lambda log_sigma: -self._mean(log_sigma, quarter),
            bounds=(best - step, best + step), method="bounded", options={"xatol": 0.01},
        )  # fmt: skip
        return self._refined(float(found.x))

    def _refined(self, log_sigma: float) -> Estimate:
        for _ in range(_MOVES):
            below, here, above = (self._scores(log_sigma + step) for step in (-_STEP, 0.0, _STEP))
            slopes = (above - below) / (2 * _STEP)
            slope, curvature = self._average(slopes), self._average(above - 2 * here + below) / _STEP**2
            if not curvature < 0:
                break
            move = -slope / curvature
            if abs(move) <= _NEWTON:
                sigma = math.exp(log_sigma + move)
                return Estimate(
                    sigma,
                    self._total * (self._average(here) + 0.5 * slope * move),
                    self._total * self._standard_error(here),
                    sigma * self._standard_error(slopes) / -curvature,
                )
            log_sigma += max(-_FARTHEST, min(_FARTHEST, move))
        raise BandwidthError(
            f"no maximum of the bandwidth's likelihood was found near {math.exp(log_sigma):g}; "
            "give the bandwidth as a number.",
            estimate=math.exp(log_sigma),
        )

    def _wider(self) -> float:
        """The maximum of some distinct rows by themselves."""
        groups = self._groups
        some = DistinctRows(groups.rows[self._first], groups.counts[self._first], np.arange(len(self._first)))
        score = PairScore(some, np.arange(len(some.rows)), self._dimensions)
        lower, upper = score.stationary_range()
        return score.maximum(lower, upper) or upper

    def _prepare(self, sigmas: FloatArray) -> None:
        """The sketch that serves those of the descending `sigmas` for which it is predicted to save time."""
        if self._dimensions > DIMENSIONS:
            return
        rows, count = self._groups.rows, len(self._groups.rows)
        box = rows.min(axis=0), rows.max(axis=0)
        by_neighbours = [engines.neighbours(rows, self._total, len(self._points), sigma).seconds for sigma in sigmas]
        best = sum(by_neighbours), math.inf
        for number, narrowest in enumerate(sigmas, start=1):
            grid = Grid.covering(*box, narrowest, sigmas[0], self._total)
            if engines.transform_bytes(grid, count) > engines.MEMORY_BYTES:
                break
            transforms = [
                engines.transform_seconds(grid.cropped(sigma, self._total), len(self._points))
                for sigma in sigmas[:number]
            ]
            seconds = engines.transform_seconds(grid, count) + sum(transforms) + sum(by_neighbours[number:])
            best = min(best, (seconds, float(narrowest)))
        self._narrowest = best[1]
        if self._narrowest < math.inf:
            grid = Grid.covering(*box, self._narrowest, sigmas[0], self._total)
            self._sketch = Sketch.of(rows, grid, self._groups.counts)

    def _mean(self, log_sigma: float, some: slice = slice(None)) -> float:
        return self._average(self._scores(log_sigma, some), some)

    def _average(self, values: FloatArray, some: slice = slice(None)) -> float:
        return float(np.average(values, weights=(self._often * self._stands_for)[some]))

    def _standard_error(self, values: FloatArray) -> float:
        """Of the mean: that of drawing without replacement from all rows, and that from those not isolated."""
        drawn = self._average((values - self._average(values)) ** 2) * (1 / self._drawn - 1 / self._total)
        others, often = values[self._certain :], self._often[self._certain :]
        if len(others) < 2:
            return math.sqrt(drawn)
        stands_for = float(self._stands_for[-1])
        share = stands_for * often.sum() / float(self._often @ self._stands_for)
        deviations = often * (others - np.average(others, weights=often)) / often.mean()
        spread = float(deviations @ deviations) / (len(others) - 1)
        return math.sqrt(drawn + share**2 * spread / len(others) * max(1 - 1 / stands_for, 0.0))

    def _scores(self, log_sigma: float, some: slice = slice(None)) -> FloatArray:
        """(S,) log likelihood of each distinct row that is scored."""
        norm = self._dimensions * (log_sigma + 0.5 * math.log(2 * math.pi))
        return np.asarray(self._log_sums(math.exp(log_sigma), some) - np.log(self._total - self._own[some]) - norm)

    def _log_sums(self, sigma: float, some: slice) -> FloatArray:
        """(S,) log kernel sums over the other rows."""
        points = self._points[some]
        if self._sketch is None or sigma < self._narrowest:
            return self._neighbours.log_sums_at(points, sigma, others=True)
        sums, error = self._sketch.sums(points, sigma)
        sums -= self._own[some]
        wrong = sums * _RELATIVE_ERROR < error
        log_sums = np.log(np.where(wrong, 1.0, sums))
        if wrong.any():
            log_sums[wrong] = self._neighbours.log_sums_at(points[wrong], sigma, others=True)
        return np.asarray(log_sums)
