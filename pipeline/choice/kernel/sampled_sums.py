"""Kernel sums at a sample of rows of a large set over all other rows, for many bandwidths.

Wide bandwidths share one sketch of the set, if that is predicted to be faster. Narrow ones, and rows too isolated for
a sketch, are summed over neighbours. Either way the relative error of a sum is bounded by 1e-3. The true error is far
smaller: with a bound of 1e-6 instead, a selected bandwidth changes by less than 1e-6 of itself.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import BoolArray, FloatArray, IndexArray
from pipeline.choice.kernel import cost_model
from pipeline.choice.kernel.fourier import DIMENSIONS, Grid, Sketch
from pipeline.choice.kernel.pairwise import LEAF, cut_off
from pipeline.choice.kernel.row_sample import RowSource, ScoredRows

SCORE_ERROR = 1e-3  # bound on the relative error of a kernel sum: at most a twentieth of the standard errors


@dataclass(frozen=True)
class Plan:
    """A sketch that is predicted to save time: its grid, and the narrowest bandwidth that it serves."""

    grid: Grid
    narrowest: float


class SampledSums:
    """Kernel sums at the scored rows of a set. `prepare` is told which bandwidths will be asked for.

    Args:
        rows: the set.
        scored: the rows of the set at which sums are computed.
    """

    def __init__(self, rows: RowSource, scored: ScoredRows) -> None:
        self._set, self._scored = rows, scored
        self._distances = cost_model.some_distances(rows.sample)
        self._sketch: Sketch | None = None
        self._narrowest = math.inf

    def prepare(self, steps: list[float], nodes: FloatArray) -> None:
        """Make the sketch that `plan` returns, if any."""
        plan = self.plan(steps, nodes)
        if plan is not None:
            self._narrowest, self._sketch = plan.narrowest, self._set.sketch(plan.grid)

    def plan(self, steps: list[float], nodes: FloatArray) -> Plan | None:
        """The sketch that is predicted to save most time. It serves all of `nodes` or none.

        Args:
            steps: log bandwidths to be scored on a quarter of the rows.
            nodes: descending log bandwidths to be scored on all scored rows.

        Returns:
            None if no sketch would save time, or if the present sketch serves all of these bandwidths.
        """
        log_sigmas = np.concatenate([steps, nodes])
        order = np.argsort(-log_sigmas)
        sigmas = np.exp(log_sigmas)[order]
        counts = [len(self._scored.quarter)] * len(steps) + [len(self._scored.points)] * len(nodes)
        point_counts = np.array(counts)[order]
        if len(self._set.lower) > DIMENSIONS or sigmas[-1] >= self._narrowest:
            return None
        highest, lowest = np.exp(nodes)[[0, -1]]
        best = self._neighbours_seconds(sigmas, point_counts), math.inf
        for number, narrowest in enumerate(sigmas, start=1):
            if lowest < narrowest <= highest:
                continue
            seconds = self._sketch_seconds(sigmas, point_counts, number)
            if seconds is None:
                break
            best = min(best, (seconds, float(narrowest)))
        return Plan(self._grid(best[1], sigmas[0]), best[1]) if best[1] < self._narrowest else None

    def log_sums(self, sigmas: FloatArray, positions: IndexArray | slice) -> FloatArray:
        """(K, S) log kernel sums over all other rows, for K descending sigmas at S of the scored rows."""
        points, occurrences = self._scored.points[positions], self._scored.occurrences[positions]
        log_sums = np.empty((len(sigmas), len(points)))
        wide = int(np.sum(sigmas >= self._narrowest))
        if wide < len(sigmas):
            log_sums[wide:] = self._set.log_sums_of_others(points, sigmas[wide:], SCORE_ERROR)
        if wide:
            log_sums[:wide], inaccurate = self._by_sketch(sigmas[:wide], points, occurrences)
            if inaccurate.any():
                repeated = self._set.log_sums_of_others(points[inaccurate], sigmas[:wide], SCORE_ERROR)
                log_sums[:wide, inaccurate] = repeated
        return log_sums

    def _by_sketch(
        self, sigmas: FloatArray, points: FloatArray, occurrences: FloatArray
    ) -> tuple[FloatArray, BoolArray]:
        """(K, S) log kernel sums over all other rows, and (S,) at which points one of them is too inaccurate."""
        sketch = self._sketch
        assert sketch is not None
        log_sums, inaccurate = np.empty((len(sigmas), len(points))), np.zeros(len(points), dtype=bool)
        two_fit = 2 * cost_model.transform_bytes(sketch.grid, len(points)) <= self._set.memory_bytes
        with ThreadPoolExecutor(2 if two_fit else 1) as pool:
            sums_and_errors = list(pool.map(lambda sigma: sketch.sums(points, sigma), sigmas))
        for number, (sums, error) in enumerate(sums_and_errors):
            sums -= occurrences
            small = sums * SCORE_ERROR < error
            log_sums[number] = np.log(np.where(small, 1.0, sums))
            inaccurate |= small
        return log_sums, inaccurate

    def _grid(self, narrowest: float, widest: float) -> Grid:
        lower, upper = self._set.lower.tolist(), self._set.upper.tolist()
        return Grid.covering(lower, upper, narrowest, widest, self._set.total, SCORE_ERROR)

    def _sketch_seconds(self, sigmas: FloatArray, point_counts: IndexArray, number: int) -> float | None:
        """Predicted seconds for all sums if a sketch serves the widest bandwidths and neighbours the others.

        Args:
            sigmas: (K,) descending bandwidths.
            point_counts: (K,) number of points for each bandwidth.
            number: how many of the bandwidths the sketch serves.

        Returns:
            None if the sketch needs too much memory.
        """
        count = -(-self._set.distinct // self._set.parts)
        grid = self._grid(sigmas[number - 1], sigmas[0])
        if cost_model.transform_bytes(grid, count) > self._set.memory_bytes:
            return None
        seconds = self._set.parts * cost_model.transform_seconds(grid, count)
        seconds += self._neighbours_seconds(sigmas[number:], point_counts[number:])
        served = zip(sigmas[:number], point_counts[:number], strict=True)
        return seconds + sum(cost_model.transform_seconds(grid.cropped(sigma), points) for sigma, points in served)

    def _neighbours_seconds(self, sigmas: FloatArray, points: IndexArray) -> float:
        """Seconds of one pass for all descending `sigmas`, which compares as many pairs as the widest needs."""
        if not len(sigmas):
            return 0.0
        reach = cut_off(self._set.total, float(sigmas[0]), SCORE_ERROR)
        share = cost_model.share_compared(self._distances, reach, LEAF / self._set.distinct)
        return cost_model.pass_seconds(points, share * self._set.distinct)
