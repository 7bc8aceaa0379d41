"""The rows of a large set of which the likelihood of a bandwidth is computed, and how they stand for all.

Two phases. First 50,000 rows are drawn of all (or all are taken): the first of a permutation, from PCG64(0), of the rows
in lexicographic order. Scored are the 2000 most isolated of these, whose scores differ most, the most repeated, and every
k-th of the others in order of their isolation, which stands for k. So the order of the set changes nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.random import PCG64, Generator

from pipeline.arrays import FloatArray, IndexArray
from pipeline.choice.kernel import cost_model
from pipeline.choice.kernel.fourier import Grid, Sketch
from pipeline.choice.kernel.pairwise import Neighbours
from pipeline.choice.kernel.unique_rows import DistinctRows
from pipeline.errors import BandwidthError

_SEED = 0
_DRAWN = 50_000  # rows whose nearest neighbour is looked up
_STRATUM = 2000  # of them, the most isolated ones are scored all, and about as many of the others
_FIRST = 1000  # distinct rows whose own likelihood says where to start


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


@dataclass(frozen=True, eq=False)
class ScoredRows:
    """The drawn rows that are scored, S distinct ones, and how many each stands for.

    Attributes:
        total: rows of the set.
        drawn: how many of them were drawn.
        points: (S, F) the rows.
        own: (S,) how often each occurs in the set.
        often: (S,) how often each was drawn.
        stands_for: (S,) 1 for the first `certain`, which are scored whatever happens; k for every k-th of the others.
        certain: how many of them are among the most isolated or the most repeated.
        quarter: (Q,) positions of those that are scored to begin with.
        quarter_weights: (Q,) weights of these in a mean over all rows.
        mean_nearest: mean squared distance of the drawn rows to their nearest other row.
    """

    total: int
    drawn: int
    points: FloatArray
    own: FloatArray
    often: FloatArray
    stands_for: FloatArray
    certain: int
    quarter: IndexArray
    quarter_weights: FloatArray
    mean_nearest: float

    @classmethod
    def of(cls, drawn: Drawn, total: int) -> ScoredRows:
        """Choose among the rows drawn from a set of `total`.

        Raises:
            BandwidthError: all rows are so close that the squares of their distances vanish.
        """
        often, nearest = drawn.often, drawn.nearest
        count = int(often.sum())
        if not nearest.any():
            raise BandwidthError("features differ by less than 1e-160, whose squares vanish; scale the features up.")
        # all of the most isolated, and of those so often repeated that one of them outweighs a 2000th of what was drawn
        certain = often * _STRATUM > count
        certain[np.argsort(-nearest, kind="stable")[:_STRATUM]] = True
        others = np.flatnonzero(~certain)
        others = others[np.argsort(-nearest[others], kind="stable")]
        every = max(math.ceil(len(others) / _STRATUM), 1)
        kept = np.concatenate([np.flatnonzero(certain), others[every // 2 :: every]])
        kept_often = often[kept].astype(np.float64)
        stands_for = np.ones(len(kept))
        first_other = int(certain.sum())
        if len(others):
            stands_for[first_other:] = often[others].sum() / kept_often[first_other:].sum()
        # a quarter to begin with, and all that outweigh many others
        heavy = kept_often * _STRATUM > count
        quarter = np.flatnonzero(heavy | (np.arange(len(kept)) % 4 == 0))
        quarter_weights = (kept_often * stands_for * np.where(heavy, 1.0, 4.0))[quarter]
        return cls(
            total, count, drawn.rows[kept], drawn.own[kept], kept_often, stands_for, first_other, quarter,
            quarter_weights, float(np.average(nearest, weights=often)),
        )  # fmt: skip

    def average(self, values: FloatArray) -> float:
        """The mean over all rows of the set, estimated from the values (S,) of those that are scored."""
        return float(np.average(values, weights=self.often * self.stands_for))

    def standard_error(self, values: FloatArray) -> float:
        """Of that mean: that of drawing without replacement from all rows, and that from those not isolated."""
        drawn = self.average((values - self.average(values)) ** 2) * (1 / self.drawn - 1 / self.total)
        others, often = values[self.certain :], self.often[self.certain :]
        if len(others) < 2:
            return math.sqrt(drawn)
        stands_for = float(self.stands_for[-1])
        share = stands_for * often.sum() / float((self.often * self.stands_for).sum())
        deviations = often * (others - np.average(others, weights=often)) / often.mean()
        spread = float(deviations @ deviations) / (len(others) - 1)
        return math.sqrt(drawn + share**2 * spread / len(others) * max(1 - 1 / stands_for, 0.0))
