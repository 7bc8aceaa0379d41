"""Which engine sums a kernel: time and memory of each, predicted from the set and the bandwidth, never from a clock.

A cost is a count of elementary operations times what one of them takes, measured once by `benchmarks/unit_costs.py`:
- `exact` computes all pairs; each pair of rows once if the sums are wanted at the rows themselves,
- `neighbours` computes the pairs within reach, whose share is estimated from the pairs of 1000 rows,
- `spectral` spreads each row over w^F grid points, w the width of FINUFFT's kernel, and takes the FFT of the
  oversampled grid; both happen twice.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import pdist

from pipeline.arrays import FloatArray, IndexArray
from pipeline.choice.kernel.domain_split import MOST, Slab, cut
from pipeline.choice.kernel.fourier import DIMENSIONS, Grid
from pipeline.choice.kernel.pairwise import LEAF, POINTS, cut_off
from pipeline.errors import ArgumentError

ENGINES = ("exact", "neighbours", "spectral")

MEMORY_BYTES = 2.0**31  # 2 GiB: what an engine may use besides the features
LONGEST_S = 4 * 3600.0  # `auto` refuses what would take longer

_COUNTED = 10_000  # sampled rows from which the number of rows in each slab is estimated
_FEW_PAIRS = 4_000_000  # up to here, computing all pairs takes hundredths of a second

# Seconds per operation, one thread.
_PAIR = 2e-9
_TREE = 1e-6  # per row and point: building the tree and its boxes
_POINT = 8e-5  # per point that is looked up by itself: finding its leaves
_KERNEL = 1.1e-8  # per pair of such a point: its distance and first kernel value
_SQUARE = 1e-9  # per such pair and bandwidth: squaring the kernel value
_ROW = 6e-8  # per row: sorting, phases
_SPREAD = 2.5e-10  # per row and point of FINUFFT's kernel
_FFT = 2e-8  # per point of the oversampled grid


@dataclass(frozen=True)
class EngineChoice:
    """An engine that sums a kernel over a set, and its predicted cost.

    Attributes:
        engine: `exact`, `neighbours` or `spectral`.
        seconds: its predicted time on one core of the machine the unit costs were measured on.
        memory_bytes: its predicted working memory, besides features and result.
    """

    engine: str
    seconds: float
    memory_bytes: float


def cheapest(rows: FloatArray, total: float, points: int | None, sigma: float) -> EngineChoice:
    """The engine that is predicted to be fastest within 2 GiB.

    Args:
        rows: (G, F) distinct rows in lexicographic order.
        total: number of rows of the set, repeated ones included.
        points: number of points at which sums are wanted, or None for the rows themselves.
        sigma: the bandwidth.

    Raises:
        ArgumentError: every engine would take more than four hours.
    """
    if len(rows) * (len(rows) if points is None else points) <= _FEW_PAIRS:
        return _exact(len(rows), points)
    choices = [_exact(len(rows), points), neighbours(rows, total, points, sigma)]
    if rows.shape[1] <= DIMENSIONS:
        choices.append(spectral(rows, total, points, sigma))
    best = min((choice for choice in choices if choice.memory_bytes <= MEMORY_BYTES), key=lambda choice: choice.seconds)
    if best.seconds > LONGEST_S:
        raise ArgumentError(
            f"features has {len(rows)} distinct rows of {rows.shape[1]} features, whose kernel sums at bandwidth "
            f"{sigma:g} would take {best.seconds / 3600:.0f} hours with the fastest engine, {best.engine!r}; use fewer "
            f"alternatives, at most {DIMENSIONS} features, another bandwidth, or name that engine to wait for it."
        )
    return best


def spectral(rows: FloatArray, total: float, points: int | None, sigma: float) -> EngineChoice:
    """Cost of the spectral engine; infinite if the bandwidth is too narrow for any grid."""
    try:
        return slabs_within(rows, total, points, sigma)[1]
    except ArgumentError:
        return EngineChoice("spectral", math.inf, math.inf)


def slabs_within(
    rows: FloatArray, total: float, points: int | None, sigma: float
) -> tuple[tuple[Slab, ...], EngineChoice]:
    """The fewest slabs that fit into 2 GiB (or 64, the most allowed, if none do), and their cost.

    Raises:
        ArgumentError: the kernel is too narrow for any grid.
    """
    sample = rows[:: max(len(rows) // _COUNTED, 1)]
    point_count = len(rows) if points is None else points
    count = 1
    while True:
        slabs = cut(rows, total, sigma, count)
        seconds, memory = 0.0, 0.0
        for slab in slabs:
            # the points are assumed to be distributed like the rows
            rows_sketched = math.ceil(np.mean(slab.contains_or_adjoins(sample)) * len(rows))
            points_inside = math.ceil(np.mean(slab.contains(sample)) * point_count)
            seconds += transform_seconds(slab.grid, rows_sketched) + transform_seconds(slab.grid, points_inside)
            memory = max(memory, transform_bytes(slab.grid, max(rows_sketched, points_inside)))
        if memory <= MEMORY_BYTES or count == MOST:
            return slabs, EngineChoice("spectral", seconds, memory)
        count *= 2


def transform_bytes(grid: Grid, points: int) -> float:
    """Bytes that a transform works in: the oversampled grid, coefficients before and after, phases and strengths."""
    parts = len(grid.parts(points))
    return 16.0 * (parts * grid.oversampled(points) + (1 + parts) * math.prod(grid.shape)) + 104.0 * points


def transform_seconds(grid: Grid, points: int) -> float:
    """Seconds that one transform between the grid and `points` points takes."""
    return grid.oversampled(points) * _FFT + points * spread_seconds(grid, points)


def spread_seconds(grid: Grid, points: int) -> float:
    """Seconds that a transform takes for each of its points, besides the FFT."""
    return float(_ROW + _SPREAD * grid.width(points) ** len(grid.modes))


def some_distances(rows: FloatArray) -> FloatArray:
    """(P,) distances of all pairs of about 1000 rows, taken at even steps of their order."""
    return np.asarray(pdist(rows[:: max(len(rows) // 1000, 1)]))


def share_compared(distances: FloatArray, reach: float, *tiles: float) -> float:
    """The share of pairs whose tiles are within `reach`; `tiles` are the shares of all rows or points in a tile."""
    # a tile with a given share of the rows extends about as far as that quantile of the distances
    extents = np.quantile(distances, np.minimum(tiles, 1.0))
    return float(np.mean(distances <= reach + extents.sum()))


def pair_seconds(pairs: float) -> float:
    """Seconds that `pairs` kernel values take."""
    return pairs * _PAIR


def pass_seconds(points: IndexArray, pairs: float) -> float:
    """Seconds of one pass over `pairs` rows near each point, with (K,) numbers of points for K bandwidths."""
    return float(points.max() * (_POINT + pairs * _KERNEL) + points.sum() * pairs * _SQUARE)


def _exact(count: int, points: int | None) -> EngineChoice:
    pairs = 0.5 * count * count if points is None else 2.0 * count * points
    return EngineChoice("exact", pair_seconds(pairs), 32e6)


def neighbours(rows: FloatArray, total: float, points: int | None, sigma: float) -> EngineChoice:
    """Cost of the engine that leaves out pairs beyond the cut-off."""
    point_count = len(rows) if points is None else points
    tiles = LEAF / len(rows), LEAF / len(rows) if points is None else POINTS / points
    pairs = point_count * len(rows) * share_compared(some_distances(rows), cut_off(total, sigma), *tiles)
    seconds = pair_seconds(0.5 * pairs if points is None else pairs) + _TREE * (len(rows) + point_count)
    return EngineChoice("neighbours", seconds, 16.0 * rows.size + 64.0 * len(rows) + 32e6)
