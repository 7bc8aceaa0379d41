"""The leave-one-out bandwidth of tens of thousands of rows, where the kernel is narrow and most pairs do not matter."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from pipeline.choice import select_bandwidth
from pipeline.choice.ties import distinct_rows
from pipeline.errors import BandwidthError

Array = NDArray[np.float64]

_EXACT_ROWS = 2000  # up to here `select_bandwidth` is as fast
_GRID_ROWS, _BASIN_ROWS = 500, 4000  # distinct rows, evenly spaced in lexicographic order, for the first two searches
_MOVES = 50
_BLOCK = 128
_NEGLIGIBLE = 1e-13  # what all pairs that are left out may add to a row's kernel sum, relative


def leave_one_out_bandwidth(features: Array) -> float:
    """`select_bandwidth(features, "leave-one-out").value`, without the pairs whose kernel vanishes.

    The likelihood of `select_bandwidth`, sum_i [log sum_j exp(-|phi_i - phi_j|^2 / 2 sigma^2) - F log sigma] over the
    rows j that are not identical to row i. Rows are compared only with those whose first feature is near enough to
    count; nothing else is approximated. Evenly spaced parts of the rows find the basin, all rows the maximum.

    Args:
        features: (N, F) scaled features.

    Returns:
        sigma in the units of `features`.

    Raises:
        BandwidthError: fewer than two distinct rows, or no maximum was found.
    """
    groups = distinct_rows(features)
    if len(groups.rows) <= _EXACT_ROWS:
        return select_bandwidth(features).value
    score = _Score(groups.rows, groups.counts)
    low, high = score.bounds
    grid = np.linspace(math.log(low), math.log(high), math.ceil(math.log2(high / low)) + 1)
    some = _evenly(len(groups.rows), _GRID_ROWS)
    centre = float(grid[np.argmin([score.loss(log_sigma, some) for log_sigma in grid])])
    centre = _minimum(score, _evenly(len(groups.rows), _BASIN_ROWS), centre, half_width=math.log(2), tolerance=0.01)
    return math.exp(_minimum(score, np.arange(len(groups.rows)), centre, half_width=0.2, tolerance=1e-6))


def _evenly(count: int, wanted: int) -> NDArray[np.intp]:
    return np.arange(0, count, max(count // wanted, 1))


def _minimum(score: _Score, scored: NDArray[np.intp], centre: float, half_width: float, tolerance: float) -> float:
    """The minimum of the loss near `centre`; the bracket moves along until it is inside."""
    for _ in range(_MOVES):
        bounds = (centre - half_width, centre + half_width)
        found = minimize_scalar(
            score.loss, args=(scored,), bounds=bounds, method="bounded", options={"xatol": tolerance}
        )
        centre = float(found.x)
        if min(centre - bounds[0], bounds[1] - centre) > 3 * tolerance:
            return centre
    raise BandwidthError(
        f"no maximum of the leave-one-out likelihood was found near {math.exp(centre):g}; give the bandwidth as a number.",
        estimate=math.exp(centre),
    )


class _Score:
    """Minus the mean log likelihood of distinct rows (G, F) in lexicographic order with their counts (G,)."""

    def __init__(self, rows: Array, counts: Array) -> None:
        self._rows, self._counts = rows, counts
        self._nearest: Array = np.asarray(KDTree(rows).query(rows, k=2)[0])[:, 1] ** 2
        self._log_reach = math.log(float(counts.sum()) / _NEGLIGIBLE)

    @property
    def bounds(self) -> tuple[float, float]:
        """Every maximum lies between: there F sigma^2 is a weighted mean of squared distances."""
        mean_nearest = float(np.sum(self._counts * self._nearest) / np.sum(self._counts))
        widest = float((np.ptp(self._rows, axis=0) ** 2).sum())
        return math.sqrt(0.25 * mean_nearest / self._rows.shape[1]), 2 * math.sqrt(widest)

    def loss(self, log_sigma: float, scored: NDArray[np.intp]) -> float:
        precision = 0.5 * math.exp(-2 * log_sigma)
        weights = self._counts[scored]
        log_sums = np.concatenate(
            [self._log_sums(scored[i : i + _BLOCK], precision) for i in range(0, len(scored), _BLOCK)]
        )
        mean = float(np.sum(weights * log_sums) / np.sum(weights))
        return float(self._rows.shape[1] * log_sigma - mean)

    def _log_sums(self, block: NDArray[np.intp], precision: float) -> Array:
        """Log kernel sums over other rows, at an increasing `block` of rows."""
        nearest = self._nearest[block]
        reach = math.sqrt(float(nearest.max()) + self._log_reach / precision)
        first = self._rows[:, 0]
        start = int(np.searchsorted(first, first[block[0]] - reach, side="left"))
        stop = int(np.searchsorted(first, first[block[-1]] + reach, side="right"))
        squares = cdist(self._rows[block], self._rows[start:stop], "sqeuclidean")
        squares[np.arange(len(block)), block - start] = np.inf
        # relative to the nearest row, whose kernel is then 1: no sum underflows; einsum, as BLAS depends on its threads
        sums = np.einsum("ij,j->i", np.exp(-precision * (squares - nearest[:, None])), self._counts[start:stop])
        return np.asarray(np.log(sums) - precision * nearest)
