"""What people would do: predictive distributions over alternatives, from any weighted draws of omega = beta theta.

The draws may be those of `pipeline.choice.weights`, or the hypotheses of a grid with their posterior as weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.spatial import cKDTree

from pipeline.arrays import FloatArray, IndexArray
from pipeline.choice.validation import matrix, vector
from pipeline.choice.weights.draws import SortedColumns
from pipeline.errors import ArgumentError

_TERMS = 2_000_000  # exponentials held at once: 16 MB


def predictive(alternatives: ArrayLike, log_w: ArrayLike, omegas: ArrayLike, weights: ArrayLike) -> FloatArray:
    """Probability of each alternative, the weights' uncertainty included.

    p(i) = sum_s w_s exp(omega_s . phi_i + log_w_i) / sum_j exp(omega_s . phi_j + log_w_j)

    >>> predictive([[0.0], [1.0]], [0.0, 0.0], [[-1.0], [1.0]], [0.5, 0.5]).round(6)
    array([0.5, 0.5])

    Args:
        alternatives: (N, F) scaled features.
        log_w: (N,) log weights of the model.
        omegas: (S, F) draws.
        weights: (S,) of the draws; or (n, S), one posterior for each of n people or held-out demonstrations.

    Returns:
        (N,) probabilities that sum to one, or (n, N).

    Raises:
        ArgumentError: shapes do not fit, or a weight is negative.

    Source: paper, "Inference and Prediction with LESS", the prediction.
    """
    rows = matrix("alternatives", alternatives)
    log_weights = vector("log_w", log_w, length=len(rows))
    points = matrix("omegas", omegas, columns=rows.shape[1])
    several = np.atleast_2d(np.asarray(weights, dtype=np.float64))
    if several.ndim != 2 or several.shape[1] != len(points) or not np.all(several >= 0):
        raise ArgumentError(f"weights must be {len(points)} numbers that are not negative, or rows of them.")
    several = several / several.sum(axis=1, keepdims=True)
    centred = rows - rows.mean(axis=0)
    found = np.zeros((len(several), len(rows)))
    step = max(_TERMS // len(rows), 1)
    for start in range(0, len(points), step):
        block = slice(start, start + step)
        terms = np.einsum("sf,jf->sj", points[block], centred) + log_weights
        np.exp(terms - terms.max(axis=1, keepdims=True), out=terms)
        found += np.einsum("ns,sj->nj", several[:, block] / terms.sum(axis=1), terms)
    return found if np.ndim(weights) == 2 else found[0]


@dataclass(frozen=True, eq=False)
class Interval:
    """Pointwise central interval and median, each of the shape of one alternative's values."""

    lower: FloatArray
    median: FloatArray
    upper: FloatArray


def predicted_interval(
    values: ArrayLike, probabilities: ArrayLike, level: float = 0.9, columns: SortedColumns | None = None
) -> Interval:
    """Where a choice will lie, each number by itself: features (N, F), or a tube of positions over time (N, T, 3).

    Args:
        values: (N, ...) of the alternatives.
        probabilities: (N,) predictive.
        level: probability within.
        columns: the values as (N, C), sorted, if they are at hand.

    Raises:
        ArgumentError: shapes do not fit, or the level is not between 0 and 1.
    """
    array = np.asarray(values, dtype=np.float64)
    if not 0 < level < 1:
        raise ArgumentError(f"level is {level}; it must be between 0 and 1.")
    known = columns or SortedColumns.of(array.reshape(len(array), -1))
    found = known.quantiles(probabilities, [(1 - level) / 2, 0.5, (1 + level) / 2])
    return Interval(*(row.reshape(array.shape[1:]) for row in found))


@dataclass(frozen=True, eq=False)
class Likely:
    """The most probable alternatives, each standing for those around it.

    Attributes:
        rows: (M,) of the set, most probable neighbourhood first.
        probability: (M,) of each with its neighbours; none is counted twice.
    """

    rows: IndexArray
    probability: FloatArray


def neighbourhoods(features: ArrayLike, radius: float) -> sparse.csr_array:
    """(N, N) of ones where two of the rows (N, F) are no farther than `radius` apart, each with itself too."""
    rows = matrix("features", features)
    if not radius >= 0:
        raise ArgumentError(f"radius is {radius}; it must be >= 0.")
    pairs = cKDTree(rows).query_pairs(radius, output_type="ndarray")
    one, other = np.concatenate([pairs, pairs[:, ::-1], np.arange(len(rows)).repeat(2).reshape(-1, 2)]).T
    near = sparse.csr_array((np.ones(len(one)), (one, other)), shape=(len(rows), len(rows)))
    near.sort_indices()
    return near


def most_probable(
    features: ArrayLike, probabilities: ArrayLike, count: int, radius: float, near: sparse.csr_array | None = None
) -> Likely:
    """Up to `count` alternatives whose neighbourhoods hold most of the predictive probability.

    One alternative's own probability depends on how densely its kind was sampled, and near-copies would fill the list;
    so each in turn is the one around which, within `radius`, most of what is left lies.

    Args:
        features: (N, F) scaled features.
        probabilities: (N,) predictive.
        count: how many.
        radius: of a neighbourhood in scaled features; 0 ranks single alternatives.
        near: their `neighbourhoods`, if at hand.

    Raises:
        ArgumentError: shapes do not fit, or a number is out of range.
    """
    rows = matrix("features", features)
    left = np.array(vector("probabilities", probabilities, length=len(rows)))
    if count < 1 or not radius >= 0:
        raise ArgumentError(f"count is {count} and radius {radius}; allowed are >= 1 and >= 0.")
    near = neighbourhoods(rows, radius) if near is None else near
    found: list[int] = []
    mass: list[float] = []
    for _ in range(min(count, len(rows))):
        around = near @ left
        best = int(around.argmax())
        if not around[best] > 0:
            break
        inside = near.indices[near.indptr[best] : near.indptr[best + 1]]
        # of the neighbourhood, the one that is most probable stands for it
        found.append(int(inside[left[inside].argmax()]))
        mass.append(float(around[best]))
        left[inside] = 0.0
    return Likely(np.array(found, dtype=np.intp), np.array(mass))


@dataclass(frozen=True, eq=False)
class PredictiveCheck:
    """Where demonstrations fall in what was predicted for them.

    Attributes:
        place: (n, F) predicted probability of a smaller value, half of an equal one included.
        p_value: (n, F) two-sided, 2 min(place, 1 - place).
    """

    place: FloatArray
    p_value: FloatArray

    def beyond(self, level: float = 0.05) -> IndexArray:
        """(F,) how many demonstrations lie beyond the level in each feature; about level x n would by chance."""
        return np.asarray((self.p_value < level).sum(axis=0))


def predictive_check(alternatives: ArrayLike, probabilities: ArrayLike, demonstrations: ArrayLike) -> PredictiveCheck:
    """The posterior predictive p values of each demonstration, feature by feature.

    Give each demonstration the prediction made without it (`leave_one_out`), or its own part in the posterior hides the
    misfit.

    Args:
        alternatives: (N, F) features.
        probabilities: (N,) predictive, or (n, N), one for each demonstration.
        demonstrations: (n, F) features.

    Raises:
        ArgumentError: shapes do not fit.
    """
    rows = matrix("alternatives", alternatives)
    chosen = matrix("demonstrations", demonstrations, columns=rows.shape[1])
    p = matrix("probabilities", np.broadcast_to(np.asarray(probabilities), (len(chosen), len(rows))))
    place = np.stack(
        [
            [p[n] @ ((rows[:, f] < value) + 0.5 * (rows[:, f] == value)) for f, value in enumerate(row)]
            for n, row in enumerate(chosen)
        ]
    )
    return PredictiveCheck(place, 2 * np.minimum(place, 1 - place))


def effective_alternatives(probabilities: Sequence[float] | FloatArray) -> float:
    """How many alternatives a prediction rests on, 1 / sum p^2."""
    p = vector("probabilities", probabilities)
    return float(p.sum() ** 2 / (p**2).sum())
