"""Choices of many people, each from a set of alternatives of their own: likelihood and estimation.

log p(chosen) = weights . phi_chosen + log_w_chosen - logsumexp over the set (weights . phi_j + log_w_j)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pipeline.arrays import FloatArray, IndexArray
from pipeline.choice.validation import matrix, vector
from pipeline.errors import ArgumentError

STEPS = 100
TOLERANCE = 1e-9  # expected gain of the log likelihood by one more step, in nats


@dataclass(frozen=True)
class ChoiceSets:
    """Choice sets one after the other.

    Attributes:
        features: (N, F) of the alternatives.
        starts: (n,) first row of each set, in increasing order from 0.
        chosen: (n,) row that was chosen.

    Raises:
        ArgumentError: shapes do not fit, a set is empty or a chosen row lies outside its set.
    """

    features: FloatArray
    starts: IndexArray
    chosen: IndexArray

    def __post_init__(self) -> None:
        matrix("features", self.features)
        ends = np.append(self.starts[1:], len(self.features))
        if len(self.starts) == 0 or self.starts[0] != 0 or not (self.starts < ends).all():
            raise ArgumentError("starts must begin with 0 and increase to less than the number of rows.")
        if self.chosen.shape != self.starts.shape or not ((self.starts <= self.chosen) & (self.chosen < ends)).all():
            raise ArgumentError("chosen needs one row for each set, from that set.")

    def log_probabilities(self, weights: ArrayLike, log_w: ArrayLike) -> FloatArray:
        """(N,) log probability of each alternative within its set.

        Args:
            weights: (F,) per unit of each feature.
            log_w: (N,) log weights that the model gives the alternatives.
        """
        utilities = self.features @ vector("weights", weights, self.features.shape[1])
        utilities = utilities + vector("log_w", log_w, len(self.features))
        sizes = np.diff(np.append(self.starts, len(self.features)))
        utilities -= np.repeat(np.maximum.reduceat(utilities, self.starts), sizes)
        log_sums = np.log(np.add.reduceat(np.exp(utilities), self.starts))
        return np.asarray(utilities - np.repeat(log_sums, sizes))

    def estimate(self, log_w: ArrayLike, counts: ArrayLike | None = None, start: ArrayLike | None = None) -> FloatArray:
        """(F,) the weights of the greatest likelihood, by Newton's method; the log likelihood is concave.

        Args:
            log_w: (N,) log weights that the model gives the alternatives.
            counts: (n,) how often each choice counts; once if not given.
            start: (F,) where to begin; zero if not given.

        Raises:
            ArgumentError: there is no greatest likelihood, as where one feature alone says what is chosen.
        """
        often = np.ones(len(self.starts)) if counts is None else vector("counts", counts, len(self.starts))
        weights = np.zeros(self.features.shape[1]) if start is None else np.array(start, dtype=np.float64)
        value, gradient, information = self._derivatives(weights, log_w, often)
        for _ in range(STEPS):
            step = np.linalg.pinv(information, hermitian=True) @ gradient
            if gradient @ step < TOLERANCE:
                return weights
            for _ in range(STEPS):
                there = self._derivatives(weights + step, log_w, often)
                if there[0] >= value:
                    break
                step = step / 2
            weights, (value, gradient, information) = weights + step, there
        raise ArgumentError(f"the choices have no greatest likelihood; the search stopped at {weights.tolist()}.")

    def _derivatives(
        self, weights: FloatArray, log_w: ArrayLike, counts: FloatArray
    ) -> tuple[float, FloatArray, FloatArray]:
        """Log likelihood, its gradient (F,) and the negative of its second derivatives (F, F)."""
        log_p = self.log_probabilities(weights, log_w)
        p = np.exp(log_p)[:, None]
        means = np.add.reduceat(p * self.features, self.starts)
        sizes = np.diff(np.append(self.starts, len(self.features)))
        apart = self.features - np.repeat(means, sizes, axis=0)
        information = (apart * (p[:, 0] * np.repeat(counts, sizes))[:, None]).T @ apart
        return float(counts @ log_p[self.chosen]), counts @ apart[self.chosen], information
