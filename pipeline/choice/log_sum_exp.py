"""The log normaliser of every hypothesis, computed part by part over a choice set of any size."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pipeline.arrays import FloatArray
from pipeline.choice.logspace import log, peak
from pipeline.choice.validation import inverse_temperatures, matrix, vector
from pipeline.errors import ArgumentError

# Terms that are held at once: 16 MB.
BLOCK = 2_000_000


@dataclass(frozen=True, eq=False)
class LogSumExp:
    """n log sums for each of H hypotheses: peak_h + log total_nh. Parts add up; add them in a fixed order.

    Attributes:
        peak: (H,) a number near the largest term.
        total: (n, H) sums of exp(term - peak).
    """

    peak: FloatArray
    total: FloatArray

    @classmethod
    def of(cls, terms: FloatArray, ratios: FloatArray | None = None) -> LogSumExp:
        """The sums over one part, sum_j r_nj exp(term_hj), with terms (H, M) and ratios r (n, M); one if not given."""
        largest = peak(terms, axis=1)
        values = np.exp(terms - largest)
        # einsum, because sums by BLAS depend on the number of threads
        total = values.sum(axis=1)[None] if ratios is None else np.einsum("hj,nj->nh", values, ratios)
        return cls(largest[:, 0], total)

    def __add__(self, other: LogSumExp) -> LogSumExp:
        largest = np.maximum(self.peak, other.peak)
        total = self.total * np.exp(self.peak - largest) + other.total * np.exp(other.peak - largest)
        return LogSumExp(largest, total)

    @property
    def value(self) -> FloatArray:
        """(n, H) the log sums."""
        return np.asarray(log(self.total) + self.peak)


def partial_normaliser(
    alternatives: ArrayLike,
    log_w: ArrayLike,
    thetas: ArrayLike,
    betas: ArrayLike,
    origin: ArrayLike,
    joined_log_w: ArrayLike | None = None,
) -> LogSumExp:
    """What one part of the alternatives adds to the normalisers: sum_j exp(beta theta . (phi_j - origin) + log_w_j).

    >>> rows, weights = [[0.0], [1.0], [2.0]], [0.0, 0.0, 0.0]
    >>> parts = [partial_normaliser(rows[part], weights[part], [[1.0]], [1.0], [0.0])
    ...          for part in (slice(2), slice(2, 3))]
    >>> (parts[0] + parts[1]).value.round(6)  # log(1 + e + e^2)
    array([[2.407606]])

    Args:
        alternatives: (M, F) scaled features of the part.
        log_w: (M,) log weights of the part in the whole set.
        thetas: (K, F) reward weights.
        betas: (B,) inverse temperatures.
        origin: (F,) subtracted from all features, the same for all parts. A point near them keeps their digits.
        joined_log_w: (n, M) log weights of the part when each of n demonstrations has joined the whole set.

    Returns:
        n x K B partial sums (n = 1 without `joined_log_w`); their sum over all parts holds the log normalisers.

    Raises:
        ArgumentError: an argument is out of range.
    """
    features = matrix("alternatives", alternatives)
    weights = vector("log_w", log_w, length=len(features))
    joined = None if joined_log_w is None else matrix("joined_log_w", joined_log_w, columns=len(features))
    slopes, centre = _slopes(thetas, betas, features.shape[1]), vector("origin", origin, length=features.shape[1])
    step = max(BLOCK // len(slopes), 1)
    parts = []
    for start in range(0, len(features), step):
        block = slice(start, start + step)
        terms = _utilities(features[block] - centre, slopes) + weights[block]
        parts.append(LogSumExp.of(terms, None if joined is None else np.exp(joined[:, block] - weights[block])))
    return sum(parts[1:], start=parts[0])


def log_likelihood_joined(
    normaliser: LogSumExp,
    demonstrations: ArrayLike,
    own_log_w: ArrayLike,
    thetas: ArrayLike,
    betas: ArrayLike,
    origin: ArrayLike,
) -> FloatArray:
    """Log probability of demonstrations that each join the set, from the normalisers of the joined sets.

    Args:
        normaliser: the sum of `partial_normaliser` over all parts, with the weights of each joined set.
        demonstrations: (n, F) scaled features.
        own_log_w: (n,) log weight of each demonstration in the set it has joined.
        thetas: (K, F) reward weights.
        betas: (B,) inverse temperatures.
        origin: (F,) the one that `partial_normaliser` was given.

    Returns:
        (n, K, B) log likelihoods, as `log_likelihood` returns them for the whole set.

    Raises:
        ArgumentError: an argument is out of range, or the normaliser has other numbers of demonstrations or hypotheses.
    """
    features = matrix("demonstrations", demonstrations)
    slopes, centre = _slopes(thetas, betas, features.shape[1]), vector("origin", origin, length=features.shape[1])
    if normaliser.total.shape != (len(features), len(slopes)):
        raise ArgumentError(
            f"normaliser has shape {normaliser.total.shape}; one row per demonstration and one column per hypothesis, "
            f"{(len(features), len(slopes))}, are needed."
        )
    chosen = _utilities(features - centre, slopes).T + vector("own_log_w", own_log_w, length=len(features))[:, None]
    flat = chosen - np.logaddexp(normaliser.value, chosen)
    return np.asarray(flat.reshape(len(features), -1, len(np.atleast_1d(np.asarray(betas)))))


def _slopes(thetas: ArrayLike, betas: ArrayLike, columns: int) -> FloatArray:
    """(K B, F) beta theta."""
    theta, beta = matrix("thetas", thetas, columns=columns), inverse_temperatures(betas)
    return np.asarray((theta[:, None, :] * beta[:, None]).reshape(-1, columns))


def _utilities(features: FloatArray, slopes: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("hf,mf->hm", slopes, features))
