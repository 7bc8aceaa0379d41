"""A set of alternatives that is read part by part, as what the sampled score of a bandwidth is about."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce

import numpy as np

from pipeline.arrays import FloatArray, IndexArray
from pipeline.choice.kernel.fourier import Grid, Sketch
from pipeline.choice.kernel.row_sample import Drawn, drawn_positions, first_of
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
    """The `Reference` of a set that is not in memory; every question about all its rows is a fold over its parts.

    Args:
        pool: where the folds are computed.
        features: of all sets.
        parts: of the set.
        spread: of its scaled features.
        memory_bytes: what the transforms of one part may use.
        what: is computed, for the progress bar.
    """

    def __init__(
        self, pool: Workers, features: Scaled, parts: Sequence[Rows], spread: Spread, memory_bytes: float, what: str
    ) -> None:
        self._pool, self._features, self._parts, self._what = pool, features, parts, what
        self.memory_bytes = memory_bytes
        self.total = self.distinct = spread.count
        self.lower, self.upper, self.parts = spread.lower, spread.upper, len(parts)
        groups = distinct_rows(self._at(drawn_positions(self.total)))
        self.like = groups.rows
        jobs = [(features, part, groups.rows) for part in parts]
        found = list(pool.mapped(others_of, jobs, f"{what}: neighbours"))
        own, nearest = sum(counts for counts, _ in found), reduce(np.minimum, (least for _, least in found))
        if np.isinf(nearest).any():
            raise BandwidthError(
                f"features has {self.total} rows and one distinct row; a bandwidth needs at least two distinct rows: "
                "add alternatives, or give the bandwidth as a number."
            )
        first = first_of(len(groups.rows))
        counts = np.asarray(own, dtype=np.float64)
        often = groups.counts.astype(np.intp)
        self.drawn = Drawn(groups.rows[first], counts[first], groups.rows, often, counts, nearest)

    def log_sums_of_others(self, points: FloatArray, sigmas: FloatArray, negligible: float) -> FloatArray:
        """See `Reference`."""
        jobs = [(self._features, part, points, sigmas, negligible) for part in self._parts]
        return self._pool.merged(log_sums_of_others_of, jobs, np.logaddexp, f"{self._what}: rows by themselves")

    def sketch(self, grid: Grid) -> Sketch:
        """See `Reference`."""
        jobs = [(self._features, part, grid) for part in self._parts]
        return self._pool.merged(sketch_of, jobs, Sketch.__add__, f"{self._what}: sketch")

    def _at(self, positions: IndexArray) -> FloatArray:
        """The rows at some places of the set, which are in order."""
        jobs, before = [], 0
        for part in self._parts:
            count = sum(piece.count for piece in part)
            here = positions[(positions >= before) & (positions < before + count)] - before
            jobs.append((self._features, part, here))
            before += count
        return np.concatenate(list(self._pool.mapped(rows_at, jobs, f"{self._what}: rows")))


def rows_at(job: tuple[Scaled, Rows, IndexArray]) -> FloatArray:
    """Some rows of a part."""
    features, part, places = job
    return features.read(part)[places]


def others_of(job: tuple[Scaled, Rows, FloatArray]) -> tuple[FloatArray, FloatArray]:
    """See `others_in_part`."""
    features, part, points = job
    return others_in_part(points, features.read(part))


def log_sums_of_others_of(job: tuple[Scaled, Rows, FloatArray, FloatArray, float]) -> FloatArray:
    """See `log_sums_of_others_in_part`."""
    features, part, points, sigmas, negligible = job
    return log_sums_of_others_in_part(points, features.read(part), sigmas, negligible)


def sketch_of(job: tuple[Scaled, Rows, Grid]) -> Sketch:
    """Of some rows."""
    features, part, grid = job
    return sketch_of_part(features.read(part), grid)
