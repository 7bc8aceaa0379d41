"""Bandwidth selection for a set of alternatives that is read part by part, never held in memory as a whole."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce

import numpy as np

from pipeline.arrays import FloatArray, IndexArray
from pipeline.choice.kernel.fourier import Grid, Sketch
from pipeline.choice.kernel.row_sample import Drawn, drawn_positions, start_positions
from pipeline.choice.kernel.unique_rows import distinct_rows
from pipeline.choice.scaling import Spread
from pipeline.choice.streaming import (
    log_sums_of_others_in_part,
    others_in_part,
    sketch_of_part,
)
from pipeline.errors import BandwidthError
from pipeline.formats.parquet.checked.open_table import Piece
from pipeline.formats.parquet.partitions import Scaled
from pipeline.workspace.compute.executor import Workers

Rows = Sequence[Piece]


class StreamedSet:
    """A `RowSource` that is not in memory. What concerns all rows is computed for each part and then merged.

    Args:
        pool: the workers that compute.
        features: the scaled features of all sets.
        parts: the rows of each part of the set.
        spread: the spread of the set's scaled features.
        memory_bytes: working memory that the transforms of one part may use.
        label: what the progress bar says is computed.
    """

    def __init__(
        self, pool: Workers, features: Scaled, parts: Sequence[Rows], spread: Spread, memory_bytes: float, label: str
    ) -> None:
        self._pool, self._features, self._parts, self._label = pool, features, parts, label
        self.memory_bytes = memory_bytes
        self.total = self.distinct = spread.count
        self.lower, self.upper, self.parts = spread.lower, spread.upper, len(parts)
        groups = distinct_rows(self._at(drawn_positions(self.total)))
        self.sample = groups.rows
        jobs = [(features, part, groups.rows) for part in parts]
        per_part = list(pool.mapped(others_of, jobs, f"{label}: neighbours"))
        occurrences = np.sum([counts for counts, _ in per_part], axis=0)
        nearest = reduce(np.minimum, (distances for _, distances in per_part))
        if np.isinf(nearest).any():
            raise BandwidthError(
                f"features has {self.total} rows and one distinct row; a bandwidth needs at least two distinct rows: "
                "add alternatives, or give the bandwidth as a number."
            )
        start = start_positions(len(groups.rows))
        draws = groups.counts.astype(np.intp)
        self.drawn = Drawn(groups.rows[start], occurrences[start], groups.rows, draws, occurrences, nearest)

    def log_sums_of_others(self, points: FloatArray, sigmas: FloatArray, negligible: float) -> FloatArray:
        """(K, M) log kernel sums at points that are rows, over all other rows; see `RowSource`."""
        jobs = [(self._features, part, points, sigmas, negligible) for part in self._parts]
        return self._pool.merged(log_sums_of_others_of, jobs, np.logaddexp, f"{self._label}: rows by themselves")

    def sketch(self, grid: Grid) -> Sketch:
        """The sketch of all rows on a grid."""
        jobs = [(self._features, part, grid) for part in self._parts]
        return self._pool.merged(sketch_of, jobs, Sketch.__add__, f"{self._label}: sketch")

    def _at(self, positions: IndexArray) -> FloatArray:
        """(P, F) the rows at ascending positions (P,) of the set."""
        jobs, before = [], 0
        for part in self._parts:
            count = sum(piece.count for piece in part)
            in_part = positions[(positions >= before) & (positions < before + count)] - before
            jobs.append((self._features, part, in_part))
            before += count
        return np.concatenate(list(self._pool.mapped(rows_at, jobs, f"{self._label}: rows")))


def rows_at(job: tuple[Scaled, Rows, IndexArray]) -> FloatArray:
    """(P, F) the rows of a part at positions (P,)."""
    features, part, positions = job
    return features.read(part)[positions]


def others_of(job: tuple[Scaled, Rows, FloatArray]) -> tuple[FloatArray, FloatArray]:
    """`others_in_part`, for a part that the worker reads."""
    features, part, points = job
    return others_in_part(points, features.read(part))


def log_sums_of_others_of(job: tuple[Scaled, Rows, FloatArray, FloatArray, float]) -> FloatArray:
    """`log_sums_of_others_in_part`, for a part that the worker reads."""
    features, part, points, sigmas, negligible = job
    return log_sums_of_others_in_part(points, features.read(part), sigmas, negligible)


def sketch_of(job: tuple[Scaled, Rows, Grid]) -> Sketch:
    """`sketch_of_part`, for a part that the worker reads."""
    features, part, grid = job
    return sketch_of_part(features.read(part), grid)
