"""The leave-one-out likelihood of a bandwidth on some of the rows, each against all of the others."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.random import PCG64, Generator
from numpy.typing import ArrayLike

from pipeline.arrays import BoolArray, FloatArray, IndexArray
from pipeline.choice.kernel import cost_model
from pipeline.choice.kernel.fourier import DIMENSIONS, Grid, Sketch
from pipeline.choice.kernel.pairwise import LEAF, Neighbours, cut_off
from pipeline.choice.kernel.pairwise_likelihood import PairScore
from pipeline.choice.kernel.unique_rows import DistinctRows
from pipeline.errors import BandwidthError

LIMIT = 5000  # up to so many distinct rows, all are scored

_SEED = 0
_DRAWN = 50_000  # rows whose nearest neighbour is looked up
_STRATUM = 2000  # of them, the most isolated ones are scored all, and about as many of the others
_FIRST = 1000  # distinct rows whose own likelihood says where to start
SCORE_ERROR = 1e-3  # of a row's kernel sum, at most: a twentieth and less of the standard errors
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


@dataclass(frozen=True, eq=False)
class Drawn:
    """Rows of a set, drawn at random: those that say where to start, and those of which some are scored.

    Attributes:
        first: (C, F) distinct rows, with `first_counts` (C,) of each.
        rows: (D, F) distinct rows.
        often: (D,) how often each was drawn.
        own: (D,) how often each occurs in the set.
        nearest: (D,) squared distance to the nearest other row of the set.
    """

    first: FloatArray
    first_counts: FloatArray
    rows: FloatArray
    often: IndexArray
    own: FloatArray
    nearest: FloatArray


class Reference(Protocol):
    """The set of rows that a score is about, in memory or not."""

    total: int  # number of rows
    distinct: int  # at most so many of them differ
    lower: FloatArray  # (F,) least values
    upper: FloatArray  # (F,) largest values
    like: FloatArray  # (M, F) distinct rows in lexicographic order that lie as those of the set do
    parts: int  # that it is transformed in
    memory_bytes: float  # that the transform of a part may use
    drawn: Drawn

    def log_sums_of_others(self, points: FloatArray, sigmas: FloatArray, negligible: float) -> FloatArray:
        """(K, M) log kernel sums at rows of the set over all others, as `Neighbours` has them."""

    def sketch(self, grid: Grid) -> Sketch:
        """Of all rows."""


class Whole:
    """A set in memory.

    Args:
        groups: distinct rows (G, F).
    """

    parts, memory_bytes = 1, cost_model.MEMORY_BYTES

    def __init__(self, groups: DistinctRows) -> None:
        self._groups = groups
        self._neighbours = Neighbours(groups.rows, groups.counts)
        self.total, self.distinct, self.like = len(groups.index), len(groups.rows), groups.rows
        self.lower, self.upper = groups.rows.min(axis=0), groups.rows.max(axis=0)
        generator = Generator(PCG64(_SEED))
        first = np.sort(generator.permutation(len(groups.rows))[:_FIRST])
        drawn = generator.permutation(self.total)[:_DRAWN]
        owners = np.searchsorted(np.cumsum(groups.counts), drawn, side="right")
        candidates, often = np.unique(owners, return_counts=True)
        rows = groups.rows[candidates]
        nearest = self._neighbours.nearest(rows, others=True)
        counts = groups.counts
        self.drawn = Drawn(groups.rows[first], counts[first], rows, often, counts[candidates], nearest)

    def log_sums_of_others(self, points: FloatArray, sigmas: FloatArray, negligible: float) -> FloatArray:
        """See `Reference`."""
        return self._neighbours.log_sums_of_others(points, sigmas, negligible)

    def sketch(self, grid: Grid) -> Sketch:
        """See `Reference`."""
        return Sketch.of(self._groups.rows, grid, self._groups.counts)


def drawn_positions(total: int) -> IndexArray:
    """Which rows of a set that is not in memory are drawn, in order: 50,000 of all (or all), from PCG64(0)."""
    if total <= _DRAWN:
        return np.arange(total)
    return np.sort(Generator(PCG64(_SEED)).choice(total, _DRAWN, replace=False, shuffle=False))


def first_of(count: int) -> IndexArray:
    """Which of so many distinct rows that were drawn say where to start."""
    return np.sort(Generator(PCG64(_SEED)).permutation(count)[:_FIRST])


class SampledScore:
    """sum_i log [ sum_j exp(-d_ij^2 / 2 sigma^2) / (n_i (sigma sqrt(2 pi))^F) ], estimated from some of the rows i.

    j runs over all n_i rows that are not identical to row i. The rows i are drawn in two phases: 50,000 of all (or all),
    the first of a permutation of the rows in lexicographic order from PCG64(0); of these the 2000 most isolated, whose
    scores differ most, the most repeated, and every k-th of the others in order of their isolation, each of which stands for k. The same
    rows are drawn for every order of the set. Wide bandwidths share the sketch of the set; narrow ones, and rows too
    isolated for it, are summed over neighbours. Either way the kernel sum of a row is good to 1e-3 of itself, by a bound far
    above the error (sigma moves by less than 1e-6 of itself from a bound of 1e-6 to this one).

    Args:
        rows: the set.
    """

    def __init__(self, rows: Reference) -> None:
        self._set = rows
        self._total, self._dimensions = rows.total, len(rows.lower)
        self._distances = cost_model.some_distances(rows.like)
        self._draw(rows.drawn)
        self._sketch: Sketch | None = None
        self._narrowest = math.inf

    def _draw(self, drawn: Drawn) -> None:
        often, nearest = drawn.often, drawn.nearest
        self._drawn = int(often.sum())
        if not nearest.any():
            raise BandwidthError("features differ by less than 1e-160, whose squares vanish; scale the features up.")
        self._mean_nearest = float(np.average(nearest, weights=often))
        # all of the most isolated, and of those so often repeated that one of them outweighs a 2000th of what was drawn
        certain = often * _STRATUM > self._drawn
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
        self._points, self._own = drawn.rows[kept], drawn.own[kept]
        self._weights = self._often * self._stands_for
        # a quarter to begin with, and all that outweigh many others
        heavy = self._often * _STRATUM > self._drawn
        self._quarter = np.flatnonzero(heavy | (np.arange(len(kept)) % 4 == 0))
        self._quarter_weights = (self._weights * np.where(heavy, 1.0, 4.0))[self._quarter]

    @property
    def rows_scored(self) -> int:
        """How many rows are scored, identical ones each."""
        return int(self._often.sum())

    def maximum(self) -> Estimate:
        """The sigma of the largest score.

        A part of the set by itself has its maximum at a wider bandwidth: its likelihood falls short of that of the whole
        set, the more the narrower the kernel. All steps of sqrt(2) from there down to the least possible maximum are
        scored on a quarter of the rows, and more upwards while the score grows. The parabola through the best step and its
        neighbours says about where four bandwidths are scored on all, whose cubic has the maximum.

        Raises:
            BandwidthError: the score has no maximum between its bounds.
        """
        step = 0.5 * math.log(2)
        wider = math.log(self._wider())
        lower = 0.5 * math.log(0.5 * self._mean_nearest / self._dimensions)
        grid = [wider + step * (1 - number) for number in range(max(math.ceil((wider + step - lower) / step), 2) + 1)]
        # the maximum of smooth features narrows with the (F + 4)th root of their number
        smooth = wider - math.log(self._set.distinct / len(self._set.drawn.first)) / (self._dimensions + 4)
        self._prepare(grid, smooth + _NODES - _MARGIN)
        scores = self._quarter_means(grid)
        widest = math.log(2 * math.dist(self._set.lower, self._set.upper))
        while scores[0] == max(scores) and grid[0] < widest:
            grid.insert(0, grid[0] + step)
            scores.insert(0, *self._quarter_means(grid[:1]))
        best = min(max(int(np.argmax(scores)), 1), len(grid) - 2)
        above, here, below = scores[best - 1 : best + 2]
        bend = above - 2 * here + below
        return self._refined(grid[best] - (0.5 * step * (above - below) / bend if bend < 0 else 0.0))

    def _refined(self, log_sigma: float) -> Estimate:
        for _ in range(_MOVES):
            self._prepare([], log_sigma + _NODES - _MARGIN)
            constant, linear, square, cube = np.einsum("kn,ns->ks", _CUBIC, self._scores(log_sigma + _NODES))
            slope, bend, twist = map(self._average, (linear, square, cube))
            peaked = bend < 0 and bend**2 > 3 * slope * twist
            move = slope / (math.sqrt(bend**2 - 3 * slope * twist) - bend) if peaked else math.copysign(1.0, slope)
            if abs(move) <= _INNER:
                sigma = math.exp(log_sigma + move)
                here = constant + move * (linear + move * (square + move * cube))
                slopes = linear + move * (2 * square + 3 * move * cube)
                return Estimate(
                    sigma,
                    self._total * self._average(here),
                    self._total * self._standard_error(here),
                    sigma * self._standard_error(slopes) / -(2 * bend + 6 * move * twist),
                )
            log_sigma += max(-_FARTHEST, min(_FARTHEST, move))
        raise BandwidthError(
            f"no maximum of the bandwidth's likelihood was found near {math.exp(log_sigma):g}; "
            "give the bandwidth as a number.",
            estimate=math.exp(log_sigma),
        )

    def _wider(self) -> float:
        """The maximum of some distinct rows by themselves."""
        drawn = self._set.drawn
        some = DistinctRows(drawn.first, drawn.first_counts, np.arange(len(drawn.first)))
        score = PairScore(some, np.arange(len(some.rows)), self._dimensions)
        lower, upper = score.stationary_range()
        return score.maximum(lower, upper) or upper

    def _prepare(self, grid: list[float], nodes: FloatArray) -> None:
        """The sketch that serves those of the bandwidths for which it is predicted to save time, of the nodes all or none.

        Args:
            grid: log bandwidths to be scored on a quarter of the rows.
            nodes: descending log bandwidths to be scored on all.
        """
        log_sigmas = np.concatenate([grid, nodes])
        order = np.argsort(-log_sigmas)
        sigmas = np.exp(log_sigmas)[order]
        at = np.array([len(self._quarter)] * len(grid) + [len(self._points)] * len(nodes))[order]
        if self._dimensions > DIMENSIONS or sigmas[-1] >= self._narrowest:
            return
        count = -(-self._set.distinct // self._set.parts)
        highest, lowest = np.exp(nodes)[[0, -1]]
        best = self._neighbours_seconds(sigmas, at), math.inf
        for number, narrowest in enumerate(sigmas, start=1):
            if lowest < narrowest <= highest:
                continue
            box = self._grid(narrowest, sigmas[0])
            if cost_model.transform_bytes(box, count) > self._set.memory_bytes:
                break
            seconds = self._set.parts * cost_model.transform_seconds(box, count)
            seconds += self._neighbours_seconds(sigmas[number:], at[number:])
            served = zip(sigmas[:number], at[:number], strict=True)
            seconds += sum(cost_model.transform_seconds(box.cropped(sigma), some) for sigma, some in served)
            best = min(best, (seconds, float(narrowest)))
        if best[1] < self._narrowest:
            self._narrowest = best[1]
            self._sketch = self._set.sketch(self._grid(best[1], sigmas[0]))

    def _grid(self, narrowest: float, widest: float) -> Grid:
        lower, upper = self._set.lower.tolist(), self._set.upper.tolist()
        return Grid.covering(lower, upper, narrowest, widest, self._total, SCORE_ERROR)

    def _neighbours_seconds(self, sigmas: FloatArray, points: IndexArray) -> float:
        """All of the descending `sigmas` in one pass, which compares as many pairs as the widest needs."""
        if not len(sigmas):
            return 0.0
        reach = cut_off(self._total, float(sigmas[0]), SCORE_ERROR)
        share = cost_model.share_compared(self._distances, reach, LEAF / self._set.distinct)
        return cost_model.pass_seconds(points, share * self._set.distinct)

    def _quarter_means(self, log_sigmas: list[float]) -> list[float]:
        scores = self._scores(log_sigmas, self._quarter)
        return [float(np.average(values, weights=self._quarter_weights)) for values in scores]

    def _average(self, values: FloatArray) -> float:
        return float(np.average(values, weights=self._weights))

    def _standard_error(self, values: FloatArray) -> float:
        """Of the mean: that of drawing without replacement from all rows, and that from those not isolated."""
        drawn = self._average((values - self._average(values)) ** 2) * (1 / self._drawn - 1 / self._total)
        others, often = values[self._certain :], self._often[self._certain :]
        if len(others) < 2:
            return math.sqrt(drawn)
        stands_for = float(self._stands_for[-1])
        share = stands_for * often.sum() / float(self._weights.sum())
        deviations = often * (others - np.average(others, weights=often)) / often.mean()
        spread = float(deviations @ deviations) / (len(others) - 1)
        return math.sqrt(drawn + share**2 * spread / len(others) * max(1 - 1 / stands_for, 0.0))

    def _scores(self, log_sigmas: ArrayLike, some: IndexArray | slice = slice(None)) -> FloatArray:
        """(K, S) log likelihood of each distinct row that is scored, for descending bandwidths."""
        norms = self._dimensions * (np.asarray(log_sigmas)[:, None] + 0.5 * math.log(2 * math.pi))
        log_sums = self._log_sums(np.exp(log_sigmas), some)
        return np.asarray(log_sums - np.log(self._total - self._own[some]) - norms)

    def _log_sums(self, sigmas: FloatArray, some: IndexArray | slice) -> FloatArray:
        """(K, S) log kernel sums over the other rows."""
        points, own = self._points[some], self._own[some]
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
