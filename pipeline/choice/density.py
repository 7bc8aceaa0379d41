"""Kernel sums over a choice set: how crowded the features of each trajectory are."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.distance import cdist

from pipeline.choice.checks import FloatArray, matrix, positive
from pipeline.choice.logspace import log_sum_exp
from pipeline.choice.ties import distinct_rows
from pipeline.errors import ArgumentError, one_of

Engine: TypeAlias = Callable[[FloatArray, float, FloatArray | None], FloatArray]

# A tile of 256 x 256 kernel values (0.5 MB) stays in the cache.
_TILE = 256


def log_density(features: ArrayLike, bandwidth: float, at: ArrayLike | None = None, engine: str = "auto") -> FloatArray:
    """Log of the Gaussian kernel sum, log sum_j exp(-|x - phi_j|^2 / (2 sigma^2)).

    The kernel has no normaliser: at a row of `features` the sum contains s(0) = 1 and its log is never negative.
    The result does not depend on the order of the rows, bit for bit.

    >>> log_density([[0.0], [0.0], [9.0]], bandwidth=0.1).round(6)
    array([0.693147, 0.693147, 0.      ])

    Args:
        features: (N, F) scaled features phi of the choice set.
        bandwidth: sigma > 0, in the units of `features`.
        at: (M, F) points x; the rows of `features` themselves if not given.
        engine: `exact` sums every pair, blocked; `auto` chooses among the engines.

    Returns:
        (M,) log kernel sums.

    Raises:
        ArgumentError: an argument is out of range, or the engine is not available.

    Source: the denominator of the LESS model, paper section "Similarity as Density".
    """
    phi = matrix("features", features)
    sigma = positive("bandwidth", bandwidth)
    points = None if at is None else matrix("at", at, columns=phi.shape[1])
    return _engine(engine)(phi, sigma, points)


def _engine(name: str) -> Engine:
    if name == "spectral":
        raise ArgumentError("engine 'spectral' is not available in this version; use 'exact' or 'auto'.")
    if name not in _ENGINES:
        raise ArgumentError(f"engine is {name!r}; the engines are {one_of(_ENGINES)}.")
    return _ENGINES[name]


def _exact(phi: FloatArray, sigma: float, points: FloatArray | None) -> FloatArray:
    """Every pair; identical rows are summed once and counted."""
    groups = distinct_rows(phi)
    if points is None:
        return _log_sums_within(groups.rows, groups.counts, sigma)[groups.index]
    return np.concatenate(
        [
            _log_sums_at(points[start : start + _TILE], groups.rows, groups.counts, sigma)
            for start in range(0, len(points), _TILE)
        ]
    )


def _log_sums_within(rows: FloatArray, counts: FloatArray, sigma: float) -> FloatArray:
    """At the rows themselves: each pair of tiles once, the kernel being symmetric."""
    others = np.zeros(len(rows))
    for start in range(0, len(rows), _TILE):
        here = slice(start, start + _TILE)
        for other_start in range(0, start, _TILE):
            there = slice(other_start, other_start + _TILE)
            kernel = np.exp(_exponents(rows[here], rows[there], sigma))
            others[here] += np.einsum("ij,j->i", kernel, counts[there])
            others[there] += np.einsum("ij,i->j", kernel, counts[here])
        kernel = np.exp(_exponents(rows[here], rows[here], sigma))
        np.fill_diagonal(kernel, 0.0)
        others[here] += np.einsum("ij,j->i", kernel, counts[here])
    # log1p keeps neighbours whose kernel is below the rounding of the row's own.
    return np.asarray(np.log(counts) + np.log1p(others / counts))


def _log_sums_at(points: FloatArray, rows: FloatArray, counts: FloatArray, sigma: float) -> FloatArray:
    """At any points, however far: the largest term is taken out of each tile's sum."""
    log_counts = np.log(counts)
    log_sums = np.full(len(points), -np.inf)
    for start in range(0, len(rows), 16 * _TILE):
        here = slice(start, start + 16 * _TILE)
        terms = _exponents(points, rows[here], sigma) + log_counts[here]
        log_sums = np.logaddexp(log_sums, log_sum_exp(terms, axis=1))
    return log_sums


def _exponents(x: FloatArray, y: FloatArray, sigma: float) -> FloatArray:
    """-|x_i - y_j|^2 / (2 sigma^2); differences first, so that a common offset costs no digits."""
    with np.errstate(over="ignore"):  # beyond the largest double the exponent is -inf, the kernel 0
        return np.asarray(cdist(x, y, "sqeuclidean") * (-0.5 / sigma**2))


_ENGINES: dict[str, Engine] = {"auto": _exact, "exact": _exact}
