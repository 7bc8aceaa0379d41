"""Kernel sums over a choice set: how crowded the features of each trajectory are."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from pipeline.arrays import FloatArray
from pipeline.choice.kernel import cost_model
from pipeline.choice.kernel.cost_model import ENGINES, EngineChoice
from pipeline.choice.kernel.domain_split import sums_in_slabs
from pipeline.choice.kernel.fourier import DIMENSIONS
from pipeline.choice.kernel.pairwise import Neighbours, log_sums_at, log_sums_within
from pipeline.choice.kernel.unique_rows import DistinctRows, distinct_rows
from pipeline.choice.validation import matrix, positive
from pipeline.errors import ArgumentError, one_of

Engine: TypeAlias = Callable[[DistinctRows, float, FloatArray | None], FloatArray]

# If the relative error of a spectral kernel sum may be larger than this, it is summed over neighbours instead.
RELATIVE_ERROR = 1e-6


def log_density(features: ArrayLike, bandwidth: float, at: ArrayLike | None = None, engine: str = "auto") -> FloatArray:
    """Log of the Gaussian kernel sum, log sum_j exp(-|x - phi_j|^2 / (2 sigma^2)).

    The kernel has no normaliser: at a row of `features` the sum contains s(0) = 1 and its log is never negative.
    The order of the rows changes no bit of the result.

    >>> log_density([[0.0], [0.0], [9.0]], bandwidth=0.1).round(6)
    array([0.693147, 0.693147, 0.      ])

    Args:
        features: (N, F) scaled features phi of the choice set.
        bandwidth: sigma > 0, in the units of `features`.
        at: (M, F) points x; the rows of `features` themselves if not given.
        engine: `exact` sums every pair. `neighbours` leaves out pairs beyond a cut-off (error below 1e-8).
            `spectral` uses nonuniform FFTs, for one to three features (error below 1e-6; `fourier.py` derives the
            bound); points outside the set's box and sums too small for that bound are summed over neighbours.
            `auto` uses the engine that `choose_engine` returns.

    Returns:
        (M,) log kernel sums.

    Raises:
        ArgumentError: an argument is out of range, or the engine named cannot compute these sums.

    Source: the denominator of the LESS model, paper section "Similarity as Density".
    """
    if engine not in ("auto", *ENGINES):
        raise ArgumentError(f"engine is {engine!r}; the engines are {one_of(('auto', *ENGINES))}.")
    groups, sigma, points = _arguments(features, bandwidth, at)
    if engine == "auto":
        engine = _choice(groups, sigma, points).engine
    log_sums = _ENGINES[engine](groups, sigma, points)
    return log_sums[groups.index] if points is None else log_sums


def choose_engine(features: ArrayLike, bandwidth: float, at: ArrayLike | None = None) -> EngineChoice:
    """The engine that `log_density` uses by default, with its predicted cost: the same for the same arguments.

    >>> choose_engine([[0.0], [1.0]], bandwidth=0.1).engine
    'exact'

    Args:
        features: (N, F) scaled features of the choice set.
        bandwidth: sigma > 0.
        at: (M, F) points; the rows of `features` themselves if not given.

    Returns:
        The cheapest engine within 2 GiB of working memory; `exact` below four million pairs.

    Raises:
        ArgumentError: an argument is out of range, or every engine would take more than four hours.
    """
    return _choice(*_arguments(features, bandwidth, at))


def _arguments(
    features: ArrayLike, bandwidth: float, at: ArrayLike | None
) -> tuple[DistinctRows, float, FloatArray | None]:
    phi = matrix("features", features)
    sigma = positive("bandwidth", bandwidth)
    return distinct_rows(phi), sigma, None if at is None else matrix("at", at, columns=phi.shape[1])


def _choice(groups: DistinctRows, sigma: float, points: FloatArray | None) -> EngineChoice:
    return cost_model.cheapest(groups.rows, len(groups.index), None if points is None else len(points), sigma)


def _exact(groups: DistinctRows, sigma: float, points: FloatArray | None) -> FloatArray:
    if points is None:
        return log_sums_within(groups.rows, groups.counts, sigma)
    return log_sums_at(points, groups.rows, groups.counts, sigma)


def _neighbours(groups: DistinctRows, sigma: float, points: FloatArray | None) -> FloatArray:
    neighbours = Neighbours(groups.rows, groups.counts)
    return neighbours.log_sums_within(sigma) if points is None else neighbours.log_sums_at(points, sigma)


def _spectral(groups: DistinctRows, sigma: float, points: FloatArray | None) -> FloatArray:
    total, dimensions = float(len(groups.index)), groups.rows.shape[1]
    if dimensions > DIMENSIONS:
        raise ArgumentError(
            f"engine 'spectral' takes up to {DIMENSIONS} features where there are {dimensions}; "
            "use 'neighbours' or 'auto'."
        )
    slabs, cost = cost_model.slabs_within(groups.rows, total, None if points is None else len(points), sigma)
    if cost.memory_bytes > cost_model.MEMORY_BYTES:
        raise ArgumentError(
            f"engine 'spectral' needs {cost.memory_bytes / 2**30:.1f} GiB for the {len(slabs)} parts of its grid where "
            f"{cost_model.MEMORY_BYTES / 2**30:g} GiB are allowed; use a wider bandwidth, 'neighbours' or 'auto'."
        )
    targets = groups.rows if points is None else points
    lower_bound = groups.counts if points is None else 0.0  # identical rows alone add up to their number
    inside = np.all((targets >= groups.rows.min(axis=0)) & (targets <= groups.rows.max(axis=0)), axis=1)
    sums = np.zeros(len(targets))
    sums[inside], error = sums_in_slabs(slabs, groups.rows, groups.counts, targets[inside], sigma)
    sums = np.maximum(sums, lower_bound)
    inaccurate = sums * RELATIVE_ERROR < error
    log_sums = np.log(np.where(inaccurate, 1.0, sums))
    if inaccurate.any():
        log_sums[inaccurate] = Neighbours(groups.rows, groups.counts).log_sums_at(targets[inaccurate], sigma)
    return np.asarray(log_sums)


_ENGINES: dict[str, Engine] = {"exact": _exact, "neighbours": _neighbours, "spectral": _spectral}
