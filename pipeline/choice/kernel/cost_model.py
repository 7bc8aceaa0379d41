"""Which engine sums a kernel: predicted cost and memory of each, from the set and the bandwidth and never from a clock.

Costs are linear in counts of elementary operations; their unit costs were measured once, by `benchmarks/unit_costs.py`:
- `exact`: all pairs; each pair of rows once where the sums are wanted at the rows themselves,
- `neighbours`: the share of pairs within reach, estimated from 1000 of them,
- `spectral`: w^F grid points per row, w the width of FINUFFT's kernel, and the oversampled grid's FFT; both twice.
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

MEMORY_BYTES = 2.0**31  # 2 GiB: what an engine may use beside the features
LONGEST_S = 4 * 3600.0  # `auto` refuses what would take longer

_COUNTED = 10_000  # rows that say how many lie where
_FEW_PAIRS = 4_000_000  # below, all pairs take hundredths of a second

# Seconds per operation, one thread.
_PAIR = 2e-9
_TREE = 1e-6  # per row and point: building the tree, boxes
_POINT = 8e-5  # per point by itself: looking for its leaves
_KERNEL = 1.1e-8  # per pair of a point by itself, and ...
_SQUARE = 1e-9  # ... for every bandwidth
_ROW = 6e-8  # per row: sorting, phases
_SPREAD = 2.5e-10  # per row and point of FINUFFT's kernel
_FFT = 2e-8  # per point of the oversampled grid


@dataclass(frozen=True)
class EngineChoice:
    """What sums a kernel over a set.

    Attributes:
        engine: `exact`, `neighbours` or `spectral`.
        seconds: its predicted time on one core of the machine the unit costs were measured on.
        memory_bytes: its predicted working memory, beside features and result.
    """

    engine: str
    seconds: float
    memory_bytes: float


def cheapest(rows: FloatArray, total: float, points: int | None, sigma: float) -> EngineChoice:
    """The engine for distinct `rows` in lexicographic order; `points` is None for the rows themselves.

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
    """Cost of the spectral engine: infinite where its grids cannot be counted."""
    try:
        return slabs_within(rows, total, points, sigma)[1]
    except ArgumentError:
        return EngineChoice("spectral", math.inf, math.inf)


def slabs_within(
    rows: FloatArray, total: float, points: int | None, sigma: float
) -> tuple[tuple[Slab, ...], EngineChoice]:
    """The fewest slabs that take up to 2 GiB, or the most there may be, and their cost.

    Raises:
        ArgumentError: the kernel is too narrow for any grid.
    """
    some = rows[:: max(len(rows) // _COUNTED, 1)]
    at = len(rows) if points is None else points
    count = 1
    while True:
        slabs = cut(rows, total, sigma, count)
        seconds, memory = 0.0, 0.0
        for slab in slabs:  # points are taken to lie as the rows do
            around, own = (
                math.ceil(np.mean(which) * of) for which, of in ((slab.around(some), len(rows)), (slab.own(some), at))
            )
            seconds += transform_seconds(slab.grid, around) + transform_seconds(slab.grid, own)
            memory = max(memory, transform_bytes(slab.grid, max(around, own)))
        if memory <= MEMORY_BYTES or count == MOST:
            return slabs, EngineChoice("spectral", seconds, memory)
        count *= 2


def transform_bytes(grid: Grid, points: int) -> float:
    """Working memory of a transform: the oversampled grid, coefficients before and after, phases and strengths."""
    parts = len(grid.parts(points))
    return 16.0 * (parts * grid.oversampled(points) + (1 + parts) * math.prod(grid.shape)) + 104.0 * points


def transform_seconds(grid: Grid, points: int) -> float:
    """One transform between the grid and `points`."""
    return grid.oversampled(points) * _FFT + points * spread_seconds(grid, points)


def spread_seconds(grid: Grid, points: int) -> float:
    """One point of a transform, by the width of FINUFFT's kernel."""
    return float(_ROW + _SPREAD * grid.width(points) ** len(grid.modes))


def some_distances(rows: FloatArray) -> FloatArray:
    """Distances of pairs of 1000 rows evenly spaced in order."""
    return np.asarray(pdist(rows[:: max(len(rows) // 1000, 1)]))


def share_compared(distances: FloatArray, reach: float, *tiles: float) -> float:
    """The share of pairs that lie in tiles within `reach`, each tile a given share of the rows or points."""
    # the two ends of a pair are so near to the other rows of their tiles
    extents = np.quantile(distances, np.minimum(tiles, 1.0))
    return float(np.mean(distances <= reach + extents.sum()))


def pair_seconds(pairs: float) -> float:
    """So many kernel values."""
    return pairs * _PAIR


def pass_seconds(points: IndexArray, pairs: float) -> float:
    """One pass over so many rows near each point, for several bandwidths with so many points each."""
    return float(points.max() * (_POINT + pairs * _KERNEL) + points.sum() * pairs * _SQUARE)


def _exact(count: int, points: int | None) -> EngineChoice:
    pairs = 0.5 * count * count if points is None else 2.0 * count * points
    return EngineChoice("exact", pair_seconds(pairs), 32e6)


def neighbours(rows: FloatArray, total: float, points: int | None, sigma: float) -> EngineChoice:
    """Cost of the engine that leaves out what is beyond the cut-off."""
    at = len(rows) if points is None else points
    tiles = LEAF / len(rows), LEAF / len(rows) if points is None else POINTS / points
    pairs = at * len(rows) * share_compared(some_distances(rows), cut_off(total, sigma), *tiles)
    seconds = pair_seconds(0.5 * pairs if points is None else pairs) + _TREE * (len(rows) + at)
    return EngineChoice("neighbours", seconds, 16.0 * rows.size + 64.0 * len(rows) + 32e6)
