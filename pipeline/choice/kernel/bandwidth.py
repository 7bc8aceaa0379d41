"""The bandwidth sigma of the kernel, selected from the alternatives."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pipeline.arrays import IndexArray
from pipeline.choice.kernel.pairwise_likelihood import PairScore
from pipeline.choice.kernel.row_sample import RowsInMemory, RowSource
from pipeline.choice.kernel.subsampled_likelihood import LIMIT, SampledScore
from pipeline.choice.kernel.unique_rows import DistinctRows, distinct_rows
from pipeline.choice.validation import matrix, positive
from pipeline.errors import ArgumentError, BandwidthError, one_of

METHODS = ("leave-one-out", "k-fold", "literal")
FOLDS = 5
_MOST_ROWS = 30_000  # comparing all pairs of 30,000 rows takes minutes


class BandwidthWarning(UserWarning):
    """Warns that a selected bandwidth is a bound of the search and not a maximum."""


@dataclass(frozen=True)
class Bandwidth:
    """A selected bandwidth.

    Attributes:
        value: sigma, in the units of the (scaled) features.
        log_likelihood: what the method maximised, at `value`; None for a fixed number.
        method: `leave-one-out`, `k-fold`, `literal` or `fixed`.
        converged: whether `value` is a maximum; false only for `literal` at its lower bound.
        rows_scored: how many rows the likelihood was evaluated on, each against all others; None for all rows.
        log_likelihood_error: standard error of `log_likelihood` from scoring a sample of the rows; None for all rows.
        value_error: standard error of `value` from the same cause; None for all rows.
    """

    value: float
    log_likelihood: float | None
    method: str
    converged: bool
    rows_scored: int | None = None
    log_likelihood_error: float | None = None
    value_error: float | None = None


def select_bandwidth(features: ArrayLike, method: str | float = "leave-one-out") -> Bandwidth:
    """The bandwidth that makes the alternatives most likely under their own kernel density estimate.

    `leave-one-out` maximises sum_i log [ (2 pi)^(-F/2) sigma^(-F) / n_i sum_j exp(-|phi_i - phi_j|^2 / 2 sigma^2) ]
    over the n_i rows j that are not identical to row i. `k-fold` scores each row by the rows of the other
    folds; distinct rows, in lexicographic order, are dealt in turn to five folds (fewer if there are fewer), so
    that identical rows share a fold. `literal` is the paper's equation as printed, sum_i log sum_j with j = i
    included and the one-dimensional normaliser, between the smallest distance of two distinct rows and the
    largest. A number is returned as it is.

    Above 5000 distinct rows, `leave-one-out` scores a sample of about 4000 rows, the same one whenever it is given the
    same set. Each is scored against all others, and the sum over all rows is estimated with its standard error
    (`SampledScore`).

    >>> round(select_bandwidth([[0.0], [1.0]]).value, 9)  # two rows: |phi_1 - phi_2| / sqrt(F)
    1.0

    Args:
        features: (N, F) scaled features of the alternatives.
        method: `leave-one-out`, `k-fold`, `literal`, or sigma itself.

    Returns:
        The bandwidth with its log likelihood.

    Raises:
        ArgumentError: an argument is out of range, or `k-fold` or `literal` is asked for with more than 30,000 rows.
        BandwidthError: fewer than two distinct rows, or no maximum was found; carries the last estimate.

    Warns:
        BandwidthWarning: `literal` ended at its lower bound; as printed the formula grows without bound there.

    Source: paper section "Similarity as Density", the argmax over sigma.
    """
    phi = matrix("features", features)
    if not isinstance(method, str):
        return Bandwidth(positive("method", method), None, "fixed", True)
    if method not in METHODS:
        raise ArgumentError(f"method is {method!r}; it is a positive number or one of {one_of(METHODS)}.")
    groups = distinct_rows(phi)
    if len(groups.rows) < 2:
        raise BandwidthError(
            f"features has {len(phi)} rows and one distinct row; a bandwidth needs at least two distinct rows: "
            "add alternatives, or give the bandwidth as a number."
        )
    if method == "leave-one-out" and len(groups.rows) > LIMIT:
        return sampled_bandwidth(RowsInMemory(groups))
    if len(groups.rows) > _MOST_ROWS:
        raise ArgumentError(
            f"features has {len(groups.rows)} distinct rows, and method {method!r} compares all pairs of at most "
            f"{_MOST_ROWS}; use 'leave-one-out', fewer rows, or give the bandwidth as a number."
        )
    if method == "literal":
        return _literal(groups)
    score = PairScore(groups, _labels(len(groups.rows), method), dimensions=phi.shape[1])
    lower, upper = score.stationary_range()
    sigma = score.maximum(lower, upper)
    if sigma is None:
        raise BandwidthError(
            f"the likelihood of the bandwidth still grows at its lower bound {lower:g}; give it as a number.",
            estimate=lower,
        )
    return Bandwidth(sigma, score.log_likelihood(sigma), method, True)


def sampled_bandwidth(rows: RowSource) -> Bandwidth:
    """The `leave-one-out` bandwidth of a large set, in memory or not, from a sample of its rows.

    Raises:
        BandwidthError: fewer than two distinct rows, or no maximum was found.
    """
    score = SampledScore(rows)
    estimate = score.maximum()
    return Bandwidth(
        estimate.sigma, estimate.log_likelihood, "leave-one-out", True,
        score.rows_scored, estimate.log_likelihood_error, estimate.sigma_error,
    )  # fmt: skip


def _labels(count: int, method: str) -> IndexArray:
    """(G,) a label for each distinct row; rows with the same label do not score each other."""
    rows = np.arange(count)
    return rows if method == "leave-one-out" else rows % min(FOLDS, count)


def _literal(groups: DistinctRows) -> Bandwidth:
    lower, upper = PairScore(groups, np.arange(len(groups.rows)), dimensions=1).distance_range()
    score = PairScore(groups, None, dimensions=1)
    sigma = score.maximum(lower, upper)
    if sigma is not None:
        return Bandwidth(sigma, score.log_likelihood(sigma), "literal", True)
    warnings.warn(
        f"the literal bandwidth is its lower bound {lower:.6g}, the smallest distance between distinct rows: "
        "the printed formula has no maximum there; use 'leave-one-out'.",
        BandwidthWarning,
        stacklevel=3,
    )
    return Bandwidth(lower, score.log_likelihood(lower), "literal", False)
