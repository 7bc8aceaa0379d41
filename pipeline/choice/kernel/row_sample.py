"""Which rows of a large set the likelihood of a bandwidth is computed on, and how they represent all rows.

The sample is taken in two phases. First 50,000 rows are drawn at random (all rows of a smaller set): the first of a
permutation, from PCG64(0), of the rows in lexicographic order. Of these are scored the 2000 most isolated, whose scores
differ most, the most repeated, and of the others, in order of their isolation, every k-th, which represents k rows. As
the rows are sorted first, the order of the set changes nothing.
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
_DRAWN = 50_000  # rows that are drawn in the first phase
_STRATUM = 2000  # of these, this many of the most isolated are scored, and about as many of the others
_START = 1000  # distinct rows whose likelihood among themselves says where the search for the bandwidth starts


@dataclass(frozen=True, eq=False)
class Drawn:
    """Rows that were drawn at random from a set.

    Attributes:
        start_rows: (C, F) distinct rows that say where the search for the bandwidth starts.
        start_counts: (C,) how often each of them occurs in the set.
        rows: (D, F) distinct rows among which those that are scored are chosen.
        draws: (D,) how often each of them was drawn.
        occurrences: (D,) how often each of them occurs in the set.
        nearest: (D,) squared distance of each to the nearest other row of the set.
    """

    start_rows: FloatArray
    start_counts: FloatArray
    rows: FloatArray
    draws: IndexArray
    occurrences: FloatArray
    nearest: FloatArray


class RowSource(Protocol):
    """The set of rows whose bandwidth is selected, in memory or not."""

    total: int  # number of rows
    distinct: int  # number of distinct rows, or an upper bound of it
    lower: FloatArray  # (F,) least values
    upper: FloatArray  # (F,) largest values
    sample: FloatArray  # (M, F) distinct rows in lexicographic order that are distributed like those of the set
    parts: int  # number of parts, each of which is transformed by itself
    memory_bytes: float  # working memory that the transform of one part may use
    drawn: Drawn

    def log_sums_of_others(self, points: FloatArray, sigmas: FloatArray, negligible: float) -> FloatArray:
        """(K, M) log kernel sums at points that are rows, over all other rows; see `Neighbours.log_sums_of_others`."""

    def sketch(self, grid: Grid) -> Sketch:
        """The sketch of all rows on a grid."""


class RowsInMemory:
    """A set that is held in memory.

    Args:
        groups: distinct rows (G, F).
    """

    parts, memory_bytes = 1, cost_model.MEMORY_BYTES

    def __init__(self, groups: DistinctRows) -> None:
        self._groups = groups
        self._neighbours = Neighbours(groups.rows, groups.counts)
        self.total, self.distinct, self.sample = len(groups.index), len(groups.rows), groups.rows
        self.lower, self.upper = groups.rows.min(axis=0), groups.rows.max(axis=0)
        generator = Generator(PCG64(_SEED))
        start = np.sort(generator.permutation(len(groups.rows))[:_START])
        drawn = generator.permutation(self.total)[:_DRAWN]
        owners = np.searchsorted(np.cumsum(groups.counts), drawn, side="right")
        candidates, draws = np.unique(owners, return_counts=True)
        rows = groups.rows[candidates]
        nearest = self._neighbours.nearest(rows, others=True)
        counts = groups.counts
        self.drawn = Drawn(groups.rows[start], counts[start], rows, draws, counts[candidates], nearest)

    def log_sums_of_others(self, points: FloatArray, sigmas: FloatArray, negligible: float) -> FloatArray:
        """(K, M) log kernel sums at points that are rows, over all other rows."""
        return self._neighbours.log_sums_of_others(points, sigmas, negligible)

    def sketch(self, grid: Grid) -> Sketch:
        """The sketch of all rows on a grid."""
        return Sketch.of(self._groups.rows, grid, self._groups.counts)


def drawn_positions(total: int) -> IndexArray:
    """Sorted positions of the 50,000 rows (at most) that are drawn from a set that is not in memory, by PCG64(0)."""
    if total <= _DRAWN:
        return np.arange(total)
    return np.sort(Generator(PCG64(_SEED)).choice(total, _DRAWN, replace=False, shuffle=False))


def start_positions(count: int) -> IndexArray:
    """Sorted positions of the rows, among `count` distinct rows that were drawn, that say where the search starts."""
    return np.sort(Generator(PCG64(_SEED)).permutation(count)[:_START])


@dataclass(frozen=True, eq=False)
class ScoredRows:
    """The S distinct rows that are scored, chosen among those that were drawn, and how many rows each represents.

    Attributes:
        total: number of rows of the set.
        drawn: number of rows that were drawn.
        points: (S, F) the scored rows.
        occurrences: (S,) how often each occurs in the set.
        draws: (S,) how often each was drawn.
        represents: (S,) how many drawn rows each represents: 1 for the first `certain` rows, about k for the others.
        certain: number of rows that are scored because they are among the most isolated or the most repeated.
        quarter: (Q,) positions of the rows that are scored first, about a quarter of all.
        quarter_weights: (Q,) weights of these rows in a mean over all rows of the set.
        mean_nearest: mean squared distance of the drawn rows to their nearest other row.
    """

    total: int
    drawn: int
    points: FloatArray
    occurrences: FloatArray
    draws: FloatArray
    represents: FloatArray
    certain: int
    quarter: IndexArray
    quarter_weights: FloatArray
    mean_nearest: float

    @classmethod
    def of(cls, drawn: Drawn, total: int) -> ScoredRows:
        """Choose the rows to score among those that were drawn from a set of `total` rows.

        Raises:
            BandwidthError: all rows are so close that the squares of their distances vanish.
        """
        draws, nearest = drawn.draws, drawn.nearest
        count = int(draws.sum())
        if not nearest.any():
            raise BandwidthError("features differ by less than 1e-160, whose squares vanish; scale the features up.")
        # the most isolated, and those drawn so often that one of them outweighs a 2000th of all draws
        certain = draws * _STRATUM > count
        certain[np.argsort(-nearest, kind="stable")[:_STRATUM]] = True
        others = np.flatnonzero(~certain)
        others = others[np.argsort(-nearest[others], kind="stable")]
        step = max(math.ceil(len(others) / _STRATUM), 1)
        scored = np.concatenate([np.flatnonzero(certain), others[step // 2 :: step]])
        scored_draws = draws[scored].astype(np.float64)
        represents = np.ones(len(scored))
        first_other = int(certain.sum())
        if len(others):
            represents[first_other:] = draws[others].sum() / scored_draws[first_other:].sum()
        # those scored first are every fourth row, and all that outweigh many others
        heavy = scored_draws * _STRATUM > count
        quarter = np.flatnonzero(heavy | (np.arange(len(scored)) % 4 == 0))
        quarter_weights = (scored_draws * represents * np.where(heavy, 1.0, 4.0))[quarter]
        return cls(
            total, count, drawn.rows[scored], drawn.occurrences[scored], scored_draws, represents, first_other, quarter,
            quarter_weights, float(np.average(nearest, weights=draws)),
        )  # fmt: skip

    def average(self, values: FloatArray) -> float:
        """The mean over all rows of the set, estimated from the values (S,) of the scored rows."""
        return float(np.average(values, weights=self.draws * self.represents))

    def standard_error(self, values: FloatArray) -> float:
        """Standard error of that mean.

        It has two parts: from drawing rows of the set without replacement, and from scoring only every k-th of those
        that are neither isolated nor often repeated.
        """
        from_drawing = self.average((values - self.average(values)) ** 2) * (1 / self.drawn - 1 / self.total)
        others, draws = values[self.certain :], self.draws[self.certain :]
        if len(others) < 2:
            return math.sqrt(from_drawing)
        represents = float(self.represents[-1])
        share = represents * draws.sum() / float((self.draws * self.represents).sum())
        deviations = draws * (others - np.average(others, weights=draws)) / draws.mean()
        variance = float(deviations @ deviations) / (len(others) - 1)
        return math.sqrt(from_drawing + share**2 * variance / len(others) * max(1 - 1 / represents, 0.0))
