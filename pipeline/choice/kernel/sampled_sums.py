"""Kernel sums of some rows of a large set over all others, at many bandwidths, in the way that is predicted to be faster.

Wide bandwidths share one sketch of the set. Narrow ones, and rows too isolated for a sketch, are summed over neighbours.
Either way the sum of a row is good to 1e-3 of itself, by a bound far above the error: a selected bandwidth moves by less
than 1e-6 of itself from a bound of 1e-6 to this one.
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
from pipeline.choice.kernel.row_sample import Reference, ScoredRows

SCORE_ERROR = 1e-3  # of a row's kernel sum, at most: a twentieth and less of the standard errors


@dataclass(frozen=True)
class Plan:
    """A sketch that is predicted to save time: its grid, and the narrowest bandwidth that it serves."""

    grid: Grid
    narrowest: float


class SampledSums:
    """The sums of the rows that are scored; `prepare` says which bandwidths are to come.

    Args:
        rows: the set.
        scored: its rows of which the sums are wanted.
    """

    def __init__(self, rows: Reference, scored: ScoredRows) -> None:
        self._set, self._scored = rows, scored
        self._distances = cost_model.some_distances(rows.like)
        self._sketch: Sketch | None = None
        self._narrowest = math.inf

    def prepare(self, grid: list[float], nodes: FloatArray) -> None:
        """Make the sketch of `plan`, if there is one."""
        plan = self.plan(grid, nodes)
        if plan is not None:
            self._narrowest, self._sketch = plan.narrowest, self._set.sketch(plan.grid)

    def plan(self, grid: list[float], nodes: FloatArray) -> Plan | None:
        """The sketch for those bandwidths for which it is predicted to save time; of the nodes it serves all or none.

        Args:
            grid: log bandwidths to be scored on a quarter of the rows.
            nodes: descending log bandwidths to be scored on all.

        Returns:
            None where no sketch would save time, or the one at hand reaches as far down.
        """
        log_sigmas = np.concatenate([grid, nodes])
        order = np.argsort(-log_sigmas)
        sigmas = np.exp(log_sigmas)[order]
        counts = [len(self._scored.quarter)] * len(grid) + [len(self._scored.points)] * len(nodes)
        at = np.array(counts)[order]
        if len(self._set.lower) > DIMENSIONS or sigmas[-1] >= self._narrowest:
            return None
        highest, lowest = np.exp(nodes)[[0, -1]]
        best = self._neighbours_seconds(sigmas, at), math.inf
        for number, narrowest in enumerate(sigmas, start=1):
            if lowest < narrowest <= highest:
                continue
            seconds = self._sketch_seconds(sigmas, at, number)
            if seconds is None:
                break
            best = min(best, (seconds, float(narrowest)))
        return Plan(self._grid(best[1], sigmas[0]), best[1]) if best[1] < self._narrowest else None

    def log_sums(self, sigmas: FloatArray, some: IndexArray | slice) -> FloatArray:
        """(K, S) log kernel sums of some of the scored rows over all other rows of the set, for descending sigmas."""
        points, own = self._scored.points[some], self._scored.own[some]
        log_sums = np.empty((len(sigmas), len(points)))
        wide = int(np.sum(sigmas >= self._narrowest))
        if wide < len(sigmas):
            log_sums[wide:] = self._set.log_sums_of_others(points, sigmas[wide:], SCORE_ERROR)
        if wide:
            log_sums[:wide], wrong = self._by_sketch(sigmas[:wide], points, own)
            if wrong.any():
                others = self._set.log_sums_of_others(points[wrong], sigmas[:wide], SCORE_ERROR)
                log_sums[:wide, wrong] = others
        return log_sums

    def _by_sketch(self, sigmas: FloatArray, points: FloatArray, own: FloatArray) -> tuple[FloatArray, BoolArray]:
        """(K, S) log sums and (S,) whether any of them is not good enough."""
        sketch = self._sketch
        assert sketch is not None
        log_sums, wrong = np.empty((len(sigmas), len(points))), np.zeros(len(points), dtype=bool)
        both = 2 * cost_model.transform_bytes(sketch.grid, len(points)) <= self._set.memory_bytes
        with ThreadPoolExecutor(2 if both else 1) as pool:
            found = list(pool.map(lambda sigma: sketch.sums(points, sigma), sigmas))
        for number, (sums, error) in enumerate(found):
            sums -= own
            small = sums * SCORE_ERROR < error
            log_sums[number] = np.log(np.where(small, 1.0, sums))
            wrong |= small
        return log_sums, wrong

    def _grid(self, narrowest: float, widest: float) -> Grid:
        lower, upper = self._set.lower.tolist(), self._set.upper.tolist()
        return Grid.covering(lower, upper, narrowest, widest, self._set.total, SCORE_ERROR)

    def _sketch_seconds(self, sigmas: FloatArray, at: IndexArray, number: int) -> float | None:
        """Of a sketch that serves the first `number` of the descending sigmas; None if it needs too much memory.

        Args:
            sigmas: (K,) all bandwidths that are wanted.
            at: (K,) at how many rows each.
            number: how many the sketch serves; neighbours serve the others.
        """
        count = -(-self._set.distinct // self._set.parts)
        box = self._grid(sigmas[number - 1], sigmas[0])
        if cost_model.transform_bytes(box, count) > self._set.memory_bytes:
            return None
        seconds = self._set.parts * cost_model.transform_seconds(box, count)
        seconds += self._neighbours_seconds(sigmas[number:], at[number:])
        served = zip(sigmas[:number], at[:number], strict=True)
        return seconds + sum(cost_model.transform_seconds(box.cropped(sigma), some) for sigma, some in served)

    def _neighbours_seconds(self, sigmas: FloatArray, points: IndexArray) -> float:
        """All of the descending `sigmas` in one pass, which compares as many pairs as the widest needs."""
        if not len(sigmas):
            return 0.0
        reach = cut_off(self._set.total, float(sigmas[0]), SCORE_ERROR)
        share = cost_model.share_compared(self._distances, reach, LEAF / self._set.distinct)
        return cost_model.pass_seconds(points, share * self._set.distinct)
